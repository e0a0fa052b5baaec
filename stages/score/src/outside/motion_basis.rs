//! Gaussians moved by shared rigid motions: the fields of Shape of Motion (`docs/spec/baseline-som.md` section 5).

use rogs_arrays::{ANY, Array, ArrayFile};
use rogs_optimise::bases::{move_gaussians, shares};
use rogs_optimise::{MotionBases, OptimiseError};
use rogs_schemas::records::motion_bases::BasisGaussians;
use rogs_splat::{Colour, Gaussians};

use crate::outside::OutsideError;

/// Reads a checkpoint's tensors by their names in Shape of Motion (`fg.params.means`, `motion_bases.params.rots`, ...), with or
/// without `model.` before them. The background may be missing.
///
/// # Errors
/// When a tensor is missing or has the wrong shape.
pub fn read_basis_gaussians(file: &ArrayFile) -> Result<BasisGaussians, OutsideError> {
    let find = |name: &str| file.find(&[name, &format!("model.{name}")]);
    let need = |name: &str| file.need(&[name, &format!("model.{name}")]);
    let both = |part: &str| -> Result<Vec<f32>, OutsideError> {
        let mut values = need(&format!("fg.params.{part}"))?.into_floats();
        let background = find(&format!("bg.params.{part}"))?;
        values.extend(background.map(Array::into_floats).unwrap_or_default());
        Ok(values)
    };
    let rotations = need("motion_bases.params.rots")?;
    rotations.expect_shape(file.path(), &[&[ANY, ANY, 6]])?;
    Ok(BasisGaussians {
        bases: rotations.shape[0],
        frames: rotations.shape[1],
        rotations: rotations.into_floats(),
        translations: need("motion_bases.params.transls")?.into_floats(),
        coefficients: need("fg.params.motion_coefs")?.into_floats(),
        means: both("means")?,
        quats: both("quats")?,
        scales: both("scales")?,
        opacities: both("opacities")?,
        colours: both("colors")?,
    })
}

/// A field that can be asked for frames.
#[derive(Debug, Clone, PartialEq)]
pub struct BasisField {
    parts: BasisGaussians,
    bases: MotionBases,
    /// Shares of the bases. `[G, K]`
    shares: Vec<f32>,
}

impl BasisField {
    /// Checks the arrays and computes the mixture weights.
    ///
    /// # Errors
    /// When the arrays contradict each other, in words.
    pub fn new(mut parts: BasisGaussians) -> Result<Self, String> {
        parts.check()?;
        let bases = MotionBases {
            frames: parts.frames,
            rotations: std::mem::take(&mut parts.rotations),
            translations: std::mem::take(&mut parts.translations),
        };
        let shares = shares(&parts.coefficients, parts.bases);
        Ok(Self { parts, bases, shares })
    }

    /// Number of Gaussians, foreground and background.
    #[must_use]
    pub fn len(&self) -> usize {
        self.parts.len()
    }

    /// True when there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// Number of foreground Gaussians; the others do not move.
    #[must_use]
    pub fn foreground(&self) -> usize {
        self.parts.foreground()
    }

    /// All Gaussians at a frame, metres; foreground first.
    ///
    /// # Errors
    /// When the field has no such frame.
    pub fn at(&self, frame: usize) -> Result<Gaussians, OutsideError> {
        let (parts, moving) = (&self.parts, self.foreground());
        let frames = parts.frames;
        if frame >= frames {
            return Err(OutsideError::NoFrame { frame, frames });
        }
        let (means, still) = parts.means.split_at(3 * moving);
        let (quats, unturned) = parts.quats.split_at(4 * moving);
        let moved = self.bases.at(frame);
        let moved = moved.and_then(|bases| move_gaussians(&bases, &self.shares, means, quats));
        let moved = moved.map_err(contradiction)?;
        let mut out = Gaussians::empty();
        out.means = moved.means;
        out.means.extend(still);
        out.quats = moved.quats;
        out.quats.extend(unturned);
        out.quats.chunks_exact_mut(4).for_each(normalise);
        out.scales = parts.scales.iter().map(|&value| libm::expf(value)).collect();
        out.opacities = parts.opacities.iter().map(|&value| sigmoid(value)).collect();
        out.colour = Colour::Rgb(parts.colours.iter().map(|&value| sigmoid(value)).collect());
        Ok(out)
    }

    /// Displacement of every Gaussian between two frames, metres. `[N, 3]`
    ///
    /// # Errors
    /// When the field has no such frame.
    pub fn displacement_m(&self, from: usize, to: usize) -> Result<Vec<f32>, OutsideError> {
        let (from, to) = (self.at(from)?, self.at(to)?);
        Ok(to.means.iter().zip(&from.means).map(|(to, from)| to - from).collect())
    }
}

/// What the check of the arrays has ruled out.
fn contradiction(error: OptimiseError) -> OutsideError {
    OutsideError::Contradiction(error.to_string())
}

fn normalise(quat: &mut [f32]) {
    let length = quat.iter().map(|value| value * value).sum::<f32>().sqrt().max(1e-12);
    quat.iter_mut().for_each(|value| *value /= length);
}

fn sigmoid(value: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-value))
}
