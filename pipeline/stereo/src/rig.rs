//! The geometry of a rectified pair (`docs/spec/references.md` section 1).

use glam::{DVec2, DVec3};
use rogs_geometry::{Camera, Pinhole, Pose};

use crate::error::{Error, Result};

/// Baselines that a stereo camera can have, metres.
const BASELINES_M: [f64; 2] = [0.005, 2.0];
/// Largest difference of rows and of columns at infinity that still counts as rectified, pixels.
const RECTIFIED_PX: f64 = 0.5;
/// Depth at which rows are compared besides infinity, metres.
const NEAR_CHECK_M: f64 = 0.5;

/// A rectified pair: parallel eyes of one focal length on one horizontal baseline. A point at camera-z depth `z` of either
/// eye has the disparity `x_left - x_right = focal_px * baseline_m / z + shift_px`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rig {
    /// Horizontal focal length, pixels.
    pub focal_px: f64,
    /// Distance of the eyes, metres.
    pub baseline_m: f64,
    /// Disparity of points at infinity: the difference of the principal points, pixels.
    pub shift_px: f64,
}

impl Rig {
    /// The geometry of two cameras, of which `left_from_right` is the pose of the right in the left one.
    ///
    /// # Errors
    /// When the eyes differ in size, stand at an impossible distance or in the wrong order, or are not rectified.
    pub fn new(left: &Pinhole, right: &Pinhole, left_from_right: &Pose<Camera, Camera>) -> Result<Self> {
        let size = |lens: &Pinhole| [lens.width as usize, lens.height as usize];
        if size(left) != size(right) {
            return Err(Error::Sizes {
                left: size(left),
                right: size(right),
            });
        }
        let offset = left_from_right.translation;
        let metres = offset.length();
        if !(BASELINES_M[0]..=BASELINES_M[1]).contains(&metres) {
            let hint = if metres > 1000.0 * BASELINES_M[0] && metres <= 1000.0 * BASELINES_M[1] {
                ": is the baseline given in millimetres? Expected metres"
            } else {
                ": no stereo camera is built so"
            };
            return Err(Error::Baseline { metres, hint });
        }
        if -offset.x > 0.5 * metres {
            return Err(Error::Swapped { metres: -offset.x });
        }
        let right_from_left = left_from_right.inverse();
        let (mut rows_px, mut columns_px) = (0.0f64, 0.0f64);
        let shift_px = left.intrinsics.cx - right.intrinsics.cx;
        let (width, height) = (f64::from(left.width), f64::from(left.height));
        for pixel in [
            [0.0, 0.0],
            [width, 0.0],
            [0.0, height],
            [width, height],
            [0.5 * width, 0.5 * height],
        ] {
            let seen = DVec2::from_array(pixel);
            let ray = left.unproject(seen, 1.0);
            let far = right.project(right_from_left.direction(ray));
            let near = right.project(right_from_left.point(ray * NEAR_CHECK_M));
            let difference = |other: Option<(DVec2, f64)>, of: fn(DVec2) -> f64| {
                other.map_or(f64::INFINITY, |(other, _)| of(seen) - of(other))
            };
            for other in [far, near] {
                rows_px = rows_px.max(difference(other, |place| place.y).abs());
            }
            columns_px = columns_px.max((difference(far, |place| place.x) - shift_px).abs());
        }
        if rows_px > RECTIFIED_PX || columns_px > RECTIFIED_PX {
            return Err(Error::NotRectified { rows_px, columns_px });
        }
        Ok(Self {
            focal_px: left.intrinsics.fx,
            baseline_m: offset.x,
            shift_px,
        })
    }

    /// Camera-z depth of a disparity, metres; NaN behind infinity.
    #[must_use]
    pub fn depth_m(&self, disparity_px: f32) -> f32 {
        let beyond = f64::from(disparity_px) - self.shift_px;
        if beyond > 0.0 {
            (self.focal_px * self.baseline_m / beyond) as f32
        } else {
            f32::NAN
        }
    }

    /// Disparity of a camera-z depth, metres.
    #[must_use]
    pub fn disparity_px(&self, depth_m: f64) -> f64 {
        self.focal_px * self.baseline_m / depth_m + self.shift_px
    }

    /// Pose of the right eye in the left one.
    #[must_use]
    pub fn left_from_right(&self) -> Pose<Camera, Camera> {
        Pose::from_translation(DVec3::X * self.baseline_m)
    }
}
