//! The field of 4DGT: Gaussians that move along polynomials of time and fade in and out.

use super::check::{Check, area, count, ensure, product};
use super::clip::SourceView;
use super::field::WeightsInfo;
use crate::ids::ClipId;

/// Velocities of a Gaussian: degrees 1 to 4, three axes each.
pub const VELOCITIES: usize = 12;
/// Angular velocities of a Gaussian: degrees 1 and 2, three axes each.
pub const ANGULAR: usize = 6;

/// Activated parameters of Gaussians, one row each (`docs/spec/baseline-4dgt.md` section 8).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Polynomials {
    /// Centres at their own times, metres. `[N, 3]`
    pub centre_m: Vec<f32>,
    /// Own times, seconds since the first clip frame. `[N]`
    pub time_s: Vec<f32>,
    /// Temporal variances, square seconds. `[N]`
    pub variance_s2: Vec<f32>,
    /// Velocities of degree 1 to 4. `[N, 4, 3]`
    pub velocity: Vec<f32>,
    /// Angular velocities of degree 1 and 2, increments in the Gaussian's own frame. `[N, 2, 3]`
    pub angular: Vec<f32>,
    /// Rotations at their own times (w, x, y, z). `[N, 4]`
    pub rotation: Vec<f32>,
    /// Standard deviations, metres. `[N, 3]`
    pub scale_m: Vec<f32>,
    /// Opacities at their own times. `[N]`
    pub opacity: Vec<f32>,
    /// Colours. `[N, 3]`
    pub rgb: Vec<f32>,
}

impl Polynomials {
    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True when there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Adds the Gaussians of another field of the same frame.
    pub fn append(&mut self, other: Self) {
        self.centre_m.extend(other.centre_m);
        self.time_s.extend(other.time_s);
        self.variance_s2.extend(other.variance_s2);
        self.velocity.extend(other.velocity);
        self.angular.extend(other.angular);
        self.rotation.extend(other.rotation);
        self.scale_m.extend(other.scale_m);
        self.opacity.extend(other.opacity);
        self.rgb.extend(other.rgb);
    }

    /// Checks the lengths of all arrays.
    ///
    /// # Errors
    /// Names the first that is wrong.
    pub fn check(&self) -> Check {
        let n = self.len();
        count("`centre_m`", self.centre_m.len(), 3 * n)?;
        count("`variance_s2`", self.variance_s2.len(), n)?;
        count("`velocity`", self.velocity.len(), VELOCITIES * n)?;
        count("`angular`", self.angular.len(), ANGULAR * n)?;
        count("`rotation`", self.rotation.len(), 4 * n)?;
        count("`scale_m`", self.scale_m.len(), 3 * n)?;
        count("`opacity`", self.opacity.len(), n)?;
        count("`rgb`", self.rgb.len(), 3 * n)
    }
}

/// The field that `lift-4dgt` makes of a clip: robot base frame, metres. `N = S * H * W`; Gaussian `n` is pixel
/// `(row, column)` of view `s` of the network's images, `n = (s * H + row) * W + column`, and keeps that identity.
#[derive(Debug, Clone, PartialEq)]
pub struct PolynomialField {
    /// The clip this belongs to.
    pub clip_id: ClipId,
    /// Height of the images that the network saw, pixels.
    pub height: u32,
    /// Width of the images that the network saw, pixels.
    pub width: u32,
    /// What it saw, camera-major. `[S]`
    pub views: Vec<SourceView>,
    /// What the weights of the network and of its image encoder were.
    pub weights: Vec<WeightsInfo>,
    /// The Gaussians of all views.
    pub gaussians: Polynomials,
}

impl PolynomialField {
    /// The arrays agree with the counts.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        let total = product("Gaussians", &[area(self.height, self.width)?, self.views.len()])?;
        count("times", self.gaussians.len(), total)?;
        ensure(!self.views.is_empty(), || "there are no views".into())?;
        self.gaussians.check()
    }
}
