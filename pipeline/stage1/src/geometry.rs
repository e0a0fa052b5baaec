//! Cameras and times as the network sees them: ray maps, pose numbers, time encodings, unprojection.

use burn::tensor::{Device, Tensor};
use glam::{DQuat, DVec3};
use rogs_geometry::{Camera, Frame, Pinhole, Pose, PosedCamera, Recon, largest_component_quaternion, non_negative};
use rogs_schemas::Intrinsics;
use rogs_schemas::units::LengthUnit;

use crate::{Error, Result};
use rogs_tensors::parameters::from_host;

/// A camera as the network sees it: internal units, and intrinsics divided by the image size (pixel column j has
/// u = (j + 0.5) / W). `W` is the frame in which it stands, for source frames the reconstruction frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NetworkCamera<W: Frame = Recon> {
    /// Where it stands, internal units.
    pub world_from_camera_iu: Pose<W, Camera>,
    /// fx / W, fy / H, cx / W, cy / H.
    pub focal_centre: [f64; 4],
}

impl<W: Frame> NetworkCamera<W> {
    /// The form of a camera that networks see.
    #[must_use]
    pub fn new(camera: &PosedCamera<W>) -> Self {
        let Pinhole {
            intrinsics: Intrinsics { fx, fy, cx, cy },
            width,
            height,
        } = camera.lens;
        let (width, height) = (f64::from(width), f64::from(height));
        Self {
            world_from_camera_iu: camera.world_from_camera.in_unit(LengthUnit::Internal),
            focal_centre: [fx / width, fy / height, cx / width, cy / height],
        }
    }

    /// The same camera in a frame that stands at `world_from_frame_iu` in its present one, internal units.
    #[must_use]
    pub fn seen_from<F: Frame>(&self, world_from_frame_iu: &Pose<W, F>) -> NetworkCamera<F> {
        NetworkCamera {
            world_from_camera_iu: self.world_from_camera_iu.seen_from(world_from_frame_iu),
            focal_centre: self.focal_centre,
        }
    }

    /// Checks that every number is finite and the focal lengths positive.
    ///
    /// # Errors
    /// Says what is wrong.
    pub fn validate(&self) -> Result<()> {
        let Pose {
            rotation, translation, ..
        } = self.world_from_camera_iu;
        let finite = rotation.is_finite() && translation.is_finite();
        if !finite || self.focal_centre.iter().any(|number| !number.is_finite()) {
            return Err(Error::BadInput(
                "a camera pose or intrinsic number is not finite".into(),
            ));
        }
        if self.focal_centre[0] <= 0.0 || self.focal_centre[1] <= 0.0 {
            return Err(Error::BadInput("a focal length is not positive".into()));
        }
        Ok(())
    }

    /// Direction in the camera's world of the point at depth 1 seen at (u, v).
    pub(super) fn ray(&self, u: f64, v: f64) -> DVec3 {
        let [fx, fy, cx, cy] = self.focal_centre;
        self.world_from_camera_iu
            .direction(DVec3::new((u - cx) / fx, (v - cy) / fy, 1.0))
    }

    /// The ray through (u, v): its moment o x d, internal units, and its direction d, of length one.
    pub(super) fn plucker(&self, u: f64, v: f64) -> [f64; 6] {
        let ray = self.ray(u, v);
        let direction = ray / ray.length();
        let moment = self.world_from_camera_iu.translation.cross(direction);
        let ([mx, my, mz], [dx, dy, dz]) = (moment.to_array(), direction.to_array());
        [mx, my, mz, dx, dy, dz]
    }

    /// Ray map [o x d, d]. `[6, H, W]`
    #[must_use]
    pub fn ray_map(&self, height: usize, width: usize) -> Vec<f32> {
        let area = height * width;
        let mut map = vec![0.0f32; 6 * area];
        for row in 0..height {
            for column in 0..width {
                let (u, v) = ((column as f64 + 0.5) / width as f64, (row as f64 + 0.5) / height as f64);
                for (channel, value) in self.plucker(u, v).into_iter().enumerate() {
                    map[channel * area + row * width + column] = value as f32;
                }
            }
        }
        map
    }

    /// The nine numbers of the pose token: translation and quaternion (x, y, z, w) of the world-to-camera transform, and
    /// the vertical and horizontal fields of view.
    #[must_use]
    pub fn pose_numbers(&self) -> [f32; 9] {
        let camera_from_world_iu = self.world_from_camera_iu.inverse();
        let [tx, ty, tz] = camera_from_world_iu.translation.to_array();
        let DQuat { x, y, z, w } = non_negative(largest_component_quaternion(&camera_from_world_iu.rotation));
        let [fx, fy, ..] = self.focal_centre;
        let fov = |focal: f64| 2.0 * libm::atan(0.5 / focal);
        [tx, ty, tz, x, y, z, w, fov(fy), fov(fx)].map(|number| number as f32)
    }

    /// A direction of the camera's world along the camera's axes.
    pub(super) fn turned(&self, direction: DVec3) -> DVec3 {
        self.world_from_camera_iu.rotation.transpose_mul_vec3(direction)
    }

    /// Where a point of the camera's world (internal units) is seen, (u, v), and its depth. A point at depth 0 has no finite
    /// place; one behind the camera has a negative depth.
    #[must_use]
    pub fn project(&self, point_iu: [f64; 3]) -> ([f64; 2], f64) {
        let between = DVec3::from_array(point_iu) - self.world_from_camera_iu.translation;
        let [x, y, depth] = self.turned(between).to_array();
        let [fx, fy, cx, cy] = self.focal_centre;
        ([fx * x / depth + cx, fy * y / depth + cy], depth)
    }

    /// The point of the camera's world seen at (u, v) at a depth, internal units.
    #[must_use]
    pub fn point(&self, u: f64, v: f64, depth_iu: f64) -> [f64; 3] {
        (self.ray(u, v) * depth_iu + self.world_from_camera_iu.translation).to_array()
    }

    /// Points of a depth map in the camera's world, internal units. `[H, W] -> [H, W, 3]`
    #[must_use]
    pub fn unproject(&self, depth_iu: &[f32], height: usize, width: usize) -> Vec<f32> {
        let mut points = Vec::with_capacity(depth_iu.len() * 3);
        for row in 0..height {
            for column in 0..width {
                let (u, v) = ((column as f64 + 0.5) / width as f64, (row as f64 + 0.5) / height as f64);
                let point = self.point(u, v, f64::from(depth_iu[row * width + column]));
                points.extend(point.map(|value| value as f32));
            }
        }
        points
    }
}

/// Time encoding: sines then cosines of 2^k t, k = 0 .. frequencies - 1, in f32.
#[must_use]
pub fn encode_time(time: f32, frequencies: usize) -> Vec<f32> {
    let angle = |power: usize| time * libm::exp2f(power as f32);
    let sines = (0..frequencies).map(|power| libm::sinf(angle(power)));
    let cosines = (0..frequencies).map(|power| libm::cosf(angle(power)));
    sines.chain(cosines).collect()
}

/// Ray maps of cameras on a device. `[S, 6, H, W]`
#[must_use]
pub fn ray_maps(cameras: &[NetworkCamera], [height, width]: [usize; 2], device: &Device) -> Tensor<4> {
    let maps = cameras.iter().flat_map(|camera| camera.ray_map(height, width));
    from_host(maps.collect(), [cameras.len(), 6, height, width], device)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_seen_from_another_has_it_as_origin() {
        let turned = glam::DMat3::from_cols(DVec3::Y, -DVec3::X, DVec3::Z);
        let first: NetworkCamera = NetworkCamera {
            world_from_camera_iu: Pose::new(turned, DVec3::new(1.0, 2.0, 3.0)),
            focal_centre: [1.0, 1.0, 0.5, 0.5],
        };
        let origin: NetworkCamera<Camera> = first.seen_from(&first.world_from_camera_iu);
        assert_eq!(origin.world_from_camera_iu, Pose::IDENTITY);
        let mut moved = first;
        moved.world_from_camera_iu.translation.y += 1.0;
        // One unit along y of the reconstruction frame is one along x of the first camera.
        let seen = moved.seen_from(&first.world_from_camera_iu).world_from_camera_iu;
        assert_eq!(seen.translation, DVec3::X);
        assert_eq!(seen.rotation, glam::DMat3::IDENTITY);
    }

    #[test]
    fn the_network_sees_metres_as_internal_units_and_pixels_as_shares() {
        let lens = Pinhole {
            intrinsics: Intrinsics {
                fx: 30.0,
                fy: 20.0,
                cx: 25.0,
                cy: 10.0,
            },
            width: 50,
            height: 20,
        };
        let recon_from_camera: Pose<Recon, Camera> = Pose::from_xyz_euler([1.0, -2.0, 0.5], [0.3, 0.1, -1.0]);
        let camera = NetworkCamera::new(&PosedCamera::new(lens, recon_from_camera));
        assert_eq!(camera.focal_centre, [0.6, 1.0, 0.5, 0.5]);
        let point_m = recon_from_camera.point(DVec3::new(0.1, -0.2, 2.0));
        let ([u, v], depth_iu) = camera.project((point_m * LengthUnit::Internal.per_metre()).to_array());
        assert!((depth_iu - 2.0 * LengthUnit::Internal.per_metre()).abs() < 1e-12);
        assert!((u - (0.1 / 2.0 * 0.6 + 0.5)).abs() < 1e-12 && (v - (-0.2 / 2.0 + 0.5)).abs() < 1e-12);
    }
}
