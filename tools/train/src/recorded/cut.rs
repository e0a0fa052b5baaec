//! Where the robot of a room is said to stand, and what of its frames becomes a view.

use glam::{DMat3, DVec3};
use image::RgbImage;
use image::imageops::FilterType;
use rogs_geometry::{Base, Camera, Frame, Pinhole, Pose, PosedCamera, Recon};
use rogs_schemas::Intrinsics;
use rogs_schemas::units::LengthUnit;
use rogs_splat::RasterCamera;

use super::picture::reference_depth;
use crate::builder::DEPTH_RANGE_M;
use crate::sample::Target;

/// The world of a recording, whose y axis points up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum World {}

impl Frame for World {
    const NAME: &'static str = "world";
}

/// Where the robot is said to stand, and what is cut out of the frames.
pub(super) struct Setup {
    pub(super) scale: f64,
    pub(super) base_distance_m: f64,
    pub(super) base_height_m: f64,
    /// From the way the first camera looks to the x axis of the base, radians.
    pub(super) turn: f64,
    /// Share of the frame that is kept.
    pub(super) cut: f64,
    /// Where the cut lies in what is left over, shares.
    pub(super) shift: [f64; 2],
    /// Factor on levels.
    pub(super) gain: f32,
}

/// The base in the world of the recording.
pub(super) struct Standing {
    base_from_world: DMat3,
    /// Metres of the room.
    origin: DVec3,
    scale: f64,
}

impl Standing {
    /// Behind a camera, as far as the setup says; `None` where the camera looks straight up or down.
    pub(super) fn behind(reference: &Pose<World, Camera>, floor_y_m: f64, setup: &Setup) -> Option<Self> {
        let forward = reference.direction(DVec3::Z);
        let ahead = DVec3::new(forward.x, 0.0, forward.z).normalize_or_zero();
        if ahead == DVec3::ZERO {
            return None;
        }
        let z = DVec3::Y;
        let aside = z.cross(ahead);
        let (s, c) = (libm::sin(setup.turn), libm::cos(setup.turn));
        let x = ahead * c + aside * s;
        let place = reference.translation - ahead * (setup.base_distance_m / setup.scale);
        Some(Self {
            base_from_world: DMat3::from_cols(x, z.cross(x), z).transpose(),
            origin: DVec3::new(place.x, floor_y_m + setup.base_height_m / setup.scale, place.z),
            scale: setup.scale,
        })
    }

    /// A camera in the base frame, metres of the clip.
    pub(super) fn place(&self, world_from_camera: &Pose<World, Camera>) -> Pose<Base, Camera> {
        Pose::new(
            self.base_from_world * world_from_camera.rotation,
            self.base_from_world * (world_from_camera.translation - self.origin) * self.scale,
        )
    }
}

/// A frame at the size of a clip.
pub(super) struct Cut {
    pub(super) camera: PosedCamera<Recon>,
    pub(super) rgb: Vec<u8>,
    pub(super) depth_iu: Vec<f32>,
    pub(super) valid: Vec<f32>,
}

impl Cut {
    /// Cuts a window of the clip's aspect out of a frame and brings it to the clip's size: colours averaged, depth of the
    /// nearest pixel.
    pub(super) fn of(
        picture: &RgbImage,
        depth_m: &[f32],
        camera: PosedCamera<Recon>,
        [height, width]: [u32; 2],
        setup: &Setup,
    ) -> Self {
        let (from_width, from_height) = picture.dimensions();
        let (fw, fh) = (f64::from(from_width), f64::from(from_height));
        let (w, h) = (f64::from(width), f64::from(height));
        let fit = (fw / w).min(fh / h) * setup.cut;
        let window = [((fw.min(w * fit)) as u32).max(1), ((fh.min(h * fit)) as u32).max(1)];
        let left = (f64::from(from_width - window[0]) * setup.shift[0]) as u32;
        let top = (f64::from(from_height - window[1]) * setup.shift[1]) as u32;
        let (sx, sy) = (w / f64::from(window[0]), h / f64::from(window[1]));
        let k = camera.lens.intrinsics;
        let lens = Pinhole {
            intrinsics: Intrinsics {
                fx: k.fx * sx,
                fy: k.fy * sy,
                cx: (k.cx - f64::from(left)) * sx,
                cy: (k.cy - f64::from(top)) * sy,
            },
            width,
            height,
        };
        let cut = image::imageops::crop_imm(picture, left, top, window[0], window[1]).to_image();
        let resized = image::imageops::resize(&cut, width, height, FilterType::Triangle);
        let brighter = |&value: &u8| (f32::from(value) * setup.gain + 0.5).min(255.0) as u8;
        let depth: Vec<f32> = (0..height * width)
            .map(|pixel| {
                let (row, column) = (pixel / width, pixel % width);
                let x = left + (((f64::from(column) + 0.5) / sx) as u32).min(window[0] - 1);
                let y = top + (((f64::from(row) + 0.5) / sy) as u32).min(window[1] - 1);
                depth_m[(y * from_width + x) as usize] * setup.scale as f32
            })
            .collect();
        let (depth_iu, valid) = reference_depth(&depth, DEPTH_RANGE_M);
        Self {
            camera: PosedCamera::new(lens, camera.world_from_camera),
            rgb: resized.as_raw().iter().map(brighter).collect(),
            depth_iu,
            valid,
        }
    }

    pub(super) fn target(self, right: bool) -> Target {
        Target {
            right,
            camera: RasterCamera::new(&self.camera, LengthUnit::Internal),
            rgb: self.rgb.iter().map(|&value| f32::from(value) / 255.0).collect(),
            support: vec![0.0; self.depth_iu.len()],
            depth_iu: self.depth_iu,
            valid: self.valid,
        }
    }
}
