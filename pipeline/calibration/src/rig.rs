//! Where cameras of common rigs are, about: starts for those that nobody has calibrated.

use glam::{DMat3, DVec3};
use rogs_geometry::{Camera, Link, Pinhole, Pose};

/// The link that wrist cameras of DROID are rigid to.
pub const DROID_HAND: &str = "panda_link8";
/// Share of the image width that a focal length of DROID's cameras is: ZED Mini on the wrist, ZED 2 beside the robot
/// (`docs/spec/data.md` section 0).
pub const DROID_FOCAL: [f64; 2] = [772.0 / 1280.0, 533.55 / 1280.0];

/// The mean hand-eye pose of 28 rigs of DROID, camera to `panda_link8` (`docs/spec/data.md` section 0): the centre at
/// (-76.8, 31.7, 17.8) mm, the optical axis tilted by 19.3 degrees towards +x, image x along -y.
#[must_use]
pub fn droid_hand_eye() -> Pose<Link, Camera> {
    let (sine, cosine) = libm::sincos(19.3f64.to_radians());
    let (forward, right) = (DVec3::new(sine, 0.0, cosine), DVec3::NEG_Y);
    let rotation = DMat3::from_cols(right, forward.cross(right), forward);
    Pose::new(rotation, DVec3::new(-0.0768, 0.0317, 0.0178))
}

/// The same camera mounted upside down: a ZED Mini turned by half about the middle between its two eyes, 62.92 mm
/// apart, of which the left one is the camera.
#[must_use]
pub fn upside_down(link_from_camera: &Pose<Link, Camera>) -> Pose<Link, Camera> {
    let half = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
    *link_from_camera * Pose::new(half, DVec3::new(0.062_92, 0.0, 0.0))
}

/// A lens of square pixels with this horizontal field of view, degrees, its axis through the middle of the image.
#[must_use]
pub fn lens_of_view(degrees: f64, width: u32, height: u32) -> Pinhole {
    let focal = 0.5 * f64::from(width) / libm::tan(0.5 * degrees.to_radians());
    Pinhole::centred(focal, width, height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_rig_is_that_of_the_generator() {
        let (found, expected) = (droid_hand_eye(), rogs_synth::nominal_hand_eye());
        let off = found.rotation - expected.rotation;
        assert!(off.to_cols_array().iter().all(|entry| entry.abs() < 1e-12), "{found:?}");
        assert_eq!(found.translation, expected.translation);
    }

    #[test]
    fn upside_down_twice_is_as_before() {
        let (pose, turned) = (droid_hand_eye(), upside_down(&droid_hand_eye()));
        let axis = |pose: &Pose<Link, Camera>| pose.rotation.z_axis;
        assert_eq!(
            (axis(&turned), turned.rotation.x_axis),
            (axis(&pose), -pose.rotation.x_axis)
        );
        // The left eye is where the right one was.
        assert!((turned.translation.y - (pose.translation.y - 0.062_92)).abs() < 1e-12);
        let off = pose.inverse() * upside_down(&turned);
        assert!(off.translation.length() < 1e-12 && off.quaternion().to_scaled_axis().length() < 1e-7);
    }

    #[test]
    fn a_right_angle_of_view_has_half_the_width_as_focal_length() {
        let lens = lens_of_view(90.0, 320, 180);
        assert!((lens.intrinsics.fx - 160.0).abs() < 1e-9 && lens.intrinsics.cy == 90.0);
    }
}
