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

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use rogs_schemas::Intrinsics;

    use super::*;

    const LENS: Pinhole = Pinhole {
        intrinsics: Intrinsics {
            fx: 115.0,
            fy: 113.0,
            cx: 141.0,
            cy: 76.0,
        },
        width: 280,
        height: 154,
    };

    fn eyes(offset: [f64; 3]) -> Result<Rig> {
        Rig::new(&LENS, &LENS, &Pose::from_translation(DVec3::from_array(offset)))
    }

    #[test]
    fn a_point_lies_at_the_depth_of_its_disparity() {
        let right = Pinhole {
            intrinsics: Intrinsics {
                cx: 138.5,
                ..LENS.intrinsics
            },
            ..LENS
        };
        let left_from_right = Pose::from_translation(DVec3::X * 0.12);
        let rig = Rig::new(&LENS, &right, &left_from_right).unwrap();
        let point = DVec3::new(0.2, -0.1, 1.7);
        let (seen_left, _) = LENS.project(point).unwrap();
        let (seen_right, _) = right.project(left_from_right.inverse().point(point)).unwrap();
        let disparity = seen_left.x - seen_right.x;
        assert!((rig.disparity_px(1.7) - disparity).abs() < 1e-12);
        assert!((rig.depth_m(disparity as f32) - 1.7).abs() < 1e-5);
        assert!(rig.depth_m(2.5).is_nan(), "infinity");
        assert_eq!(rig.left_from_right(), left_from_right);
    }

    #[test]
    fn a_baseline_in_millimetres_is_named() {
        let error = eyes([120.0, 0.0, 0.0]).unwrap_err().to_string();
        assert!(
            error.contains("120 m apart") && error.contains("millimetres"),
            "{error}"
        );
        for metres in [0.0, 0.001, 5e4, f64::NAN] {
            let error = eyes([metres, 0.0, 0.0]).unwrap_err().to_string();
            assert!(error.contains("no stereo camera"), "{error}");
        }
    }

    #[test]
    fn a_right_eye_on_the_left_is_named() {
        let error = eyes([-0.12, 0.0, 0.0]).unwrap_err();
        assert_eq!(error, Error::Swapped { metres: 0.12 });
        assert!(error.to_string().starts_with("left and right eyes look swapped"));
    }

    #[test]
    fn calibration_that_is_not_rectified_is_named() {
        let rows = |pose: Pose<Camera, Camera>| Rig::new(&LENS, &LENS, &pose).unwrap_err();
        let turned = Pose::new(DMat3::from_rotation_x(0.02), DVec3::X * 0.12);
        assert!(matches!(rows(turned), Error::NotRectified { rows_px, .. } if rows_px > 2.0));
        let lower = Pose::from_translation(DVec3::new(0.12, 0.01, 0.0));
        assert!(matches!(rows(lower), Error::NotRectified { .. }));
        let inwards = Pose::new(DMat3::from_rotation_y(0.02), DVec3::X * 0.12);
        assert!(matches!(rows(inwards), Error::NotRectified { columns_px, .. } if columns_px > 2.0));
        let other_lens = Pinhole {
            intrinsics: Intrinsics {
                fx: 117.0,
                ..LENS.intrinsics
            },
            ..LENS
        };
        let error = Rig::new(&LENS, &other_lens, &Pose::from_translation(DVec3::X * 0.12)).unwrap_err();
        assert!(matches!(error, Error::NotRectified { .. }), "{error}");
        // A hundredth of a degree is nothing.
        let slightly = Pose::new(DMat3::from_rotation_x(1.7e-4), DVec3::X * 0.12);
        assert!(Rig::new(&LENS, &LENS, &slightly).is_ok());
        let smaller = Pinhole { width: 270, ..LENS };
        let error = Rig::new(&LENS, &smaller, &Pose::from_translation(DVec3::X * 0.12)).unwrap_err();
        assert!(matches!(error, Error::Sizes { .. }));
    }
}
