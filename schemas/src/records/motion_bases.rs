//! The field of Shape of Motion: for every source camera Gaussians that shared rigid motions move, and a background that
//! stands still.

use super::check::{Check, count, ensure, product};
use super::field::WeightsInfo;
use crate::ids::ClipId;
use crate::index::CameraIndex;

/// Raw parameters of one camera's Gaussians (`docs/spec/baseline-som.md` section 5): foreground first, then background.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BasisGaussians {
    /// Bases, K.
    pub bases: usize,
    /// Frames, T.
    pub frames: usize,
    /// Rotations of the bases, two columns each. `[K, T, 6]`
    pub rotations: Vec<f32>,
    /// Translations of the bases, metres. `[K, T, 3]`
    pub translations: Vec<f32>,
    /// Logits of the foreground's mixture. `[G, K]`
    pub coefficients: Vec<f32>,
    /// Canonical centres, metres. `[G + B, 3]`
    pub means: Vec<f32>,
    /// Canonical rotations (w, x, y, z), any length. `[G + B, 4]`
    pub quats: Vec<f32>,
    /// Logarithms of the standard deviations. `[G + B, 3]`
    pub scales: Vec<f32>,
    /// Logits of the opacities. `[G + B]`
    pub opacities: Vec<f32>,
    /// Logits of the colours. `[G + B, 3]`
    pub colours: Vec<f32>,
}

impl BasisGaussians {
    /// Number of Gaussians, foreground and background.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacities.len()
    }

    /// True when there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.opacities.is_empty()
    }

    /// Number of foreground Gaussians; the others do not move.
    #[must_use]
    pub fn foreground(&self) -> usize {
        self.coefficients.len().checked_div(self.bases).unwrap_or(0)
    }

    /// The arrays, in the order of the fields.
    #[must_use]
    pub fn arrays(&self) -> [&[f32]; 8] {
        [
            &self.rotations,
            &self.translations,
            &self.coefficients,
            &self.means,
            &self.quats,
            &self.scales,
            &self.opacities,
            &self.colours,
        ]
    }

    /// The arrays agree with each other.
    ///
    /// # Errors
    /// Names the first that does not.
    pub fn check(&self) -> Check {
        let n = self.len();
        let of_bases = product("bases", &[self.bases, self.frames])?;
        count("rotations", self.rotations.len(), product("bases", &[of_bases, 6])?)?;
        count(
            "translations",
            self.translations.len(),
            product("bases", &[of_bases, 3])?,
        )?;
        let foreground = self.foreground();
        count("coefficients", self.coefficients.len(), foreground.min(n) * self.bases)?;
        count("means", self.means.len(), 3 * n)?;
        count("quats", self.quats.len(), 4 * n)?;
        count("scales", self.scales.len(), 3 * n)?;
        count("colours", self.colours.len(), 3 * n)
    }
}

/// The field that `lift-som` makes of a clip: robot base frame, metres, clip frames 0 to T - 1 and nothing between them.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionBasisField {
    /// The clip this belongs to.
    pub clip_id: ClipId,
    /// Number of frames of the clip.
    pub frame_count: u32,
    /// How every camera's Gaussians came about, in words; nothing was trained beforehand.
    pub weights: WeightsInfo,
    /// Source cameras, ascending, each with what was optimised against its images alone.
    pub cameras: Vec<(CameraIndex, BasisGaussians)>,
}

impl MotionBasisField {
    /// The arrays agree with the counts.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        ensure(!self.cameras.is_empty(), || "there are no cameras".into())?;
        ensure(self.cameras.is_sorted_by(|a, b| a.0 < b.0), || {
            "the cameras do not ascend".into()
        })?;
        for (camera, gaussians) in &self.cameras {
            let here = |what: String| format!("camera {camera}: {what}");
            gaussians.check().map_err(here)?;
            count("frames", gaussians.frames, self.frame_count as usize).map_err(here)?;
        }
        Ok(())
    }
}
