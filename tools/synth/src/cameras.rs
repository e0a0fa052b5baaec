//! Cameras with DROID's geometry: a ZED-Mini-like stereo pair on the flange and two ZED-2-like pairs beside the base
//! (statistics: `docs/spec/data.md` section 0).

use glam::{DMat3, DVec3};
use rogs_geometry::{Base, Camera, Pinhole, Pose};
use rogs_schemas::Intrinsics;

use crate::frame::BodyFrame;
use crate::math::{Draw, rot_rpy, rot_y, rot_z};

/// Number of cameras of an episode.
pub const CAMERAS: usize = 6;

/// Names in the order of an episode: sources, then their right eyes.
pub const CAMERA_NAMES: [&str; CAMERAS] = ["wrist", "ext1", "ext2", "wrist_right", "ext1_right", "ext2_right"];

/// Mean hand-eye translation of 28 DROID rigs: camera centre in `panda_link8`, metres.
pub const HAND_EYE_MEAN: [f64; 3] = [-0.0768, 0.0317, 0.0178];

/// Its standard deviation over the rigs, metres.
pub const HAND_EYE_STD: [f64; 3] = [0.0046, 0.0063, 0.0064];

/// Mean and deviation of the tilt of the optical axis towards +x of `panda_link8`, degrees.
pub const HAND_EYE_TILT_DEG: [f64; 2] = [19.3, 0.6];

/// Stereo baseline of the external cameras: mean and deviation, metres.
pub const ZED2_BASELINE: [f64; 2] = [0.120_04, 0.000_09];

/// Stereo baseline of the wrist camera: mean and deviation, metres.
pub const ZED_MINI_BASELINE: [f64; 2] = [0.062_92, 0.000_13];

/// How a camera is carried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mount {
    /// Camera-to-base, metres.
    Fixed(Pose<Base, Camera>),
    /// Camera-to-`panda_link8`, metres.
    Flange(Pose<BodyFrame, Camera>),
}

/// One camera of an episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EpisodeCamera {
    /// Intrinsics and image size, pixels.
    pub lens: Pinhole,
    /// The lens that is written: the same, or with calibration noise.
    pub recorded_lens: Pinhole,
    /// The pose images are rendered with.
    pub mount: Mount,
    /// The pose that is written: the same, or with calibration noise.
    pub recorded_mount: Mount,
}

impl EpisodeCamera {
    /// Camera-to-base pose when the flange is at `base_from_flange`.
    #[must_use]
    pub fn base_from_camera(&self, base_from_flange: &Pose<Base, BodyFrame>) -> Pose<Base, Camera> {
        match self.mount {
            Mount::Fixed(pose) => pose,
            Mount::Flange(pose) => *base_from_flange * pose,
        }
    }
}

/// Height and width of the images of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Resolution {
    /// Wrist images, height then width.
    pub wrist: [u32; 2],
    /// External images, height then width.
    pub external: [u32; 2],
}

impl Resolution {
    /// 154 x 280 for all cameras: the resolution of evaluation.
    pub const EVALUATION: Self = Self {
        wrist: [154, 280],
        external: [154, 280],
    };
}

/// The hand-eye pose with the mean translation, the mean tilt, and yaw -90 degrees: image x is -y of the flange.
#[must_use]
pub fn nominal_hand_eye() -> Pose<BodyFrame, Camera> {
    hand_eye(
        DVec3::from_array(HAND_EYE_MEAN),
        HAND_EYE_TILT_DEG[0].to_radians(),
        DMat3::IDENTITY,
    )
}

pub(crate) fn hand_eye(translation: DVec3, tilt: f64, extra: DMat3) -> Pose<BodyFrame, Camera> {
    Pose::new(rot_y(tilt) * rot_z(-std::f64::consts::FRAC_PI_2) * extra, translation)
}

/// The six cameras of an episode.
pub(crate) fn draw_cameras(
    draw: &mut Draw,
    resolution: Resolution,
    noise: Option<[f64; 2]>,
    table_z: f64,
) -> [EpisodeCamera; CAMERAS] {
    let std = HAND_EYE_STD.map(|s| s * draw.normal());
    let translation = DVec3::from_array(HAND_EYE_MEAN) + DVec3::from_array(std);
    let tilt = (HAND_EYE_TILT_DEG[0] + HAND_EYE_TILT_DEG[1] * draw.normal()).to_radians();
    let extra = rot_rpy(draw.normal3(0.005).to_array());
    let wrist = Mount::Flange(hand_eye(translation, tilt, extra));
    let wrist_baseline = ZED_MINI_BASELINE[0] + ZED_MINI_BASELINE[1] * draw.normal();
    let wrist_intrinsics = intrinsics(draw, resolution.wrist, [772.0, 6.0]);
    let mut left = vec![(wrist, wrist_intrinsics, resolution.wrist, wrist_baseline)];
    for side in [1.0, -1.0] {
        let pose = external_pose(draw, side, table_z);
        let baseline = ZED2_BASELINE[0] + ZED2_BASELINE[1] * draw.normal();
        let intrinsics = intrinsics(draw, resolution.external, [530.0, 4.0]);
        left.push((Mount::Fixed(pose), intrinsics, resolution.external, baseline));
    }
    // One error per stereo pair: the eyes of a pair are rigid to each other.
    let errors: Vec<Pose<Camera, Camera>> = (0..3)
        .map(|_| {
            let (shift, turn) = (draw.normal3(1.0), draw.normal3(1.0));
            let [metres, radians] = noise.unwrap_or([0.0, 0.0]);
            Pose::new(rot_rpy((turn * radians).to_array()), shift * metres)
        })
        .collect();
    std::array::from_fn(|index| {
        let (mount, intrinsics, [height, width], baseline) = left[index % 3];
        let eye = Pose::from_translation(DVec3::X * if index < 3 { 0.0 } else { baseline });
        let recorded = if noise.is_some() { errors[index % 3] * eye } else { eye };
        let lens = Pinhole {
            intrinsics,
            width,
            height,
        };
        EpisodeCamera {
            lens,
            recorded_lens: lens,
            mount: moved(mount, eye),
            recorded_mount: moved(mount, recorded),
        }
    })
}

pub(crate) fn moved(mount: Mount, by: Pose<Camera, Camera>) -> Mount {
    match mount {
        Mount::Fixed(pose) => Mount::Fixed(pose * by),
        Mount::Flange(pose) => Mount::Flange(pose * by),
    }
}

/// Rectified ZED intrinsics at 1280 x 720 with integer pixel centres, brought to another resolution and to centres at +0.5.
fn intrinsics(draw: &mut Draw, [height, width]: [u32; 2], [fx, std]: [f64; 2]) -> Intrinsics {
    let (sx, sy) = (f64::from(width) / 1280.0, f64::from(height) / 720.0);
    let f = fx + std * draw.normal();
    Intrinsics {
        fx: f * sx,
        fy: f * sy,
        cx: (644.0 + 8.0 * draw.normal() + 0.5) * sx,
        cy: (360.0 + 5.0 * draw.normal() + 0.5) * sy,
    }
}

/// A pose beside the base that looks at the workspace.
fn external_pose(draw: &mut Draw, side: f64, table_z: f64) -> Pose<Base, Camera> {
    let eye = DVec3::new(
        draw.range(-0.05, 0.42),
        side * draw.range(0.42, 0.88),
        table_z.max(-0.05) + draw.range(0.30, 0.62),
    );
    let target = DVec3::new(
        draw.range(0.40, 0.55),
        draw.range(-0.10, 0.10),
        table_z + draw.range(0.0, 0.16),
    );
    looking_at(eye, target, 0.03 * draw.normal())
}

/// A camera that looks from a place to another, turned about its axis by `roll`, radians.
pub(crate) fn looking_at(eye: DVec3, target: DVec3, roll: f64) -> Pose<Base, Camera> {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let look = DMat3::from_cols(right, forward.cross(right), forward);
    Pose::new(look * rot_z(roll), eye)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nominal_hand_eye_looks_as_the_rigs_do() {
        let pose = nominal_hand_eye();
        let axis = pose.rotation.z_axis;
        assert!((axis - DVec3::new(0.330, 0.0, 0.944)).length() < 1e-3);
        assert!((pose.rotation.x_axis + DVec3::Y).length() < 1e-12);
        assert_eq!(pose.translation.to_array(), HAND_EYE_MEAN);
    }

    #[test]
    fn right_eyes_stand_a_baseline_to_the_right() {
        let cameras = draw_cameras(&mut Draw::new(5, 0), Resolution::EVALUATION, Some([0.003, 0.004]), 0.0);
        for index in 0..3 {
            let baseline = if index == 0 {
                ZED_MINI_BASELINE[0]
            } else {
                ZED2_BASELINE[0]
            };
            let pose = Pose::from_translation(DVec3::new(0.3, 0.1, 0.4));
            let left = cameras[index].base_from_camera(&pose);
            let right = cameras[index + 3].base_from_camera(&pose);
            let offset = left.inverse() * right;
            assert!((offset.translation - DVec3::X * baseline).length() < 4e-4);
            assert!((offset.rotation.x_axis - DVec3::X).length() < 1e-12);
            assert_eq!(cameras[index].lens, cameras[index + 3].lens);
            assert_ne!(cameras[index].mount, cameras[index].recorded_mount);
        }
    }

    #[test]
    fn external_cameras_look_down_at_the_table_from_both_sides() {
        // The wrist's images are larger, as those of recordings are.
        let resolution = Resolution {
            wrist: [352, 640],
            external: [176, 320],
        };
        for seed in 0..20 {
            let cameras = draw_cameras(&mut Draw::new(seed, 0), resolution, None, 0.0);
            for (index, side) in [(1, 1.0), (2, -1.0)] {
                let Mount::Fixed(pose) = cameras[index].mount else {
                    panic!("a fixed camera")
                };
                assert!(pose.translation.y * side > 0.4);
                assert!(pose.rotation.z_axis.z < 0.0 && pose.rotation.y_axis.z < -0.5);
                assert!((pose.rotation.determinant() - 1.0).abs() < 1e-9);
                assert_eq!(cameras[index].mount, cameras[index].recorded_mount);
            }
        }
    }
}
