//! Cameras and times as the network sees them: ray maps, pose numbers, time encodings, unprojection.

use burn::tensor::{Device, Tensor};

use crate::{Error, Result};
use rogs_tensors::parameters::from_host;

/// A source camera in internal units: camera-to-reconstruction pose (OpenCV axes) and intrinsics divided by the image
/// size (pixel column j has u = (j + 0.5) / W).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Rotation of recon_from_camera, row-major.
    pub rotation: [f64; 9],
    /// Translation of recon_from_camera, internal units.
    pub translation_iu: [f64; 3],
    /// fx / W, fy / H, cx / W, cy / H.
    pub focal_centre: [f64; 4],
}

/// Where a frame stands in another one, internal units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FramePose {
    /// Rotation of other_from_frame, row-major.
    pub rotation: [f64; 9],
    /// Translation of other_from_frame, internal units.
    pub translation_iu: [f64; 3],
}

impl FramePose {
    /// A frame in itself.
    pub const IDENTITY: Self = Self {
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        translation_iu: [0.0; 3],
    };

    /// Where this frame stands in a third one, of which it is known where that stands: `third_from_other * other_from_frame`
    /// for the pose `other_from_third`.
    #[must_use]
    pub fn seen_from(&self, third: &Self) -> Self {
        let (a, b) = (&third.rotation, &self.rotation);
        let between: [f64; 3] = std::array::from_fn(|axis| self.translation_iu[axis] - third.translation_iu[axis]);
        Self {
            rotation: std::array::from_fn(|k| (0..3).map(|j| a[3 * j + k / 3] * b[3 * j + k % 3]).sum()),
            translation_iu: std::array::from_fn(|row| (0..3).map(|j| a[3 * j + row] * between[j]).sum()),
        }
    }
}

impl Camera {
    /// From a row-major 4x4 camera-to-reconstruction matrix in internal units.
    #[must_use]
    pub fn from_matrix(matrix: &[f64; 16], focal_centre: [f64; 4]) -> Self {
        let m = matrix;
        let rotation = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
        Self {
            rotation,
            translation_iu: [m[3], m[7], m[11]],
            focal_centre,
        }
    }

    /// Where the camera stands: recon_from_camera.
    #[must_use]
    pub fn pose(&self) -> FramePose {
        FramePose {
            rotation: self.rotation,
            translation_iu: self.translation_iu,
        }
    }

    /// The same camera in the frame that stands at a pose in its present one.
    #[must_use]
    pub fn seen_from(&self, frame: &FramePose) -> Self {
        let FramePose {
            rotation,
            translation_iu,
        } = self.pose().seen_from(frame);
        Self {
            rotation,
            translation_iu,
            ..*self
        }
    }

    /// Checks that every number is finite and the focal lengths positive.
    ///
    /// # Errors
    /// Says what is wrong.
    pub fn validate(&self) -> Result<()> {
        let numbers = self
            .rotation
            .iter()
            .chain(&self.translation_iu)
            .chain(&self.focal_centre);
        if numbers.into_iter().any(|number| !number.is_finite()) {
            return Err(Error::BadInput(
                "a camera pose or intrinsic number is not finite".into(),
            ));
        }
        if self.focal_centre[0] <= 0.0 || self.focal_centre[1] <= 0.0 {
            return Err(Error::BadInput("a focal length is not positive".into()));
        }
        Ok(())
    }

    /// Direction in the reconstruction frame of the point at depth 1 seen at (u, v).
    pub(super) fn ray(&self, u: f64, v: f64) -> [f64; 3] {
        let [fx, fy, cx, cy] = self.focal_centre;
        let local = [(u - cx) / fx, (v - cy) / fy, 1.0];
        let r = &self.rotation;
        std::array::from_fn(|row| r[3 * row] * local[0] + r[3 * row + 1] * local[1] + r[3 * row + 2] * local[2])
    }

    /// The ray through (u, v): its moment o x d, internal units, and its direction d, of length one.
    pub(super) fn plucker(&self, u: f64, v: f64) -> [f64; 6] {
        let (o, ray) = (self.translation_iu, self.ray(u, v));
        let norm = (ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]).sqrt();
        let d = ray.map(|value| value / norm);
        [
            o[1] * d[2] - o[2] * d[1],
            o[2] * d[0] - o[0] * d[2],
            o[0] * d[1] - o[1] * d[0],
            d[0],
            d[1],
            d[2],
        ]
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
        let r = &self.rotation;
        // Inverse of a rigid transform: transposed rotation.
        let m: [[f64; 3]; 3] = std::array::from_fn(|row| std::array::from_fn(|column| r[3 * column + row]));
        let t: [f64; 3] = std::array::from_fn(|row| -(0..3).map(|k| m[row][k] * self.translation_iu[k]).sum::<f64>());
        let q = quaternion(&m);
        let [fx, fy, ..] = self.focal_centre;
        let fov = |focal: f64| 2.0 * libm::atan(0.5 / focal);
        [t[0], t[1], t[2], q[0], q[1], q[2], q[3], fov(fy), fov(fx)].map(|number| number as f32)
    }

    /// A direction of the reconstruction frame along the camera's axes.
    pub(super) fn turned(&self, direction: [f64; 3]) -> [f64; 3] {
        let r = &self.rotation;
        std::array::from_fn(|axis| (0..3).map(|k| r[3 * k + axis] * direction[k]).sum())
    }

    /// Where a point of the reconstruction frame (internal units) is seen, (u, v), and its depth. A point at depth 0 has no
    /// finite place; one behind the camera has a negative depth.
    #[must_use]
    pub fn project(&self, point_iu: [f64; 3]) -> ([f64; 2], f64) {
        let [x, y, depth] = self.turned(std::array::from_fn(|k| point_iu[k] - self.translation_iu[k]));
        let [fx, fy, cx, cy] = self.focal_centre;
        ([fx * x / depth + cx, fy * y / depth + cy], depth)
    }

    /// The point of the reconstruction frame seen at (u, v) at a depth, internal units.
    #[must_use]
    pub fn point(&self, u: f64, v: f64, depth_iu: f64) -> [f64; 3] {
        let ray = self.ray(u, v);
        std::array::from_fn(|axis| ray[axis] * depth_iu + self.translation_iu[axis])
    }

    /// Points of a depth map in the reconstruction frame, internal units. `[H, W] -> [H, W, 3]`
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

/// Unit quaternion (x, y, z, w) of a rotation with w >= 0, by the largest of the four candidates, first on ties
/// (`docs/spec/stage1.md` section 4).
fn quaternion(m: &[[f64; 3]; 3]) -> [f64; 4] {
    let (a, b, c) = (m[0][0], m[1][1], m[2][2]);
    let square = [1.0 + a + b + c, 1.0 + a - b - c, 1.0 - a + b - c, 1.0 - a - b + c];
    let size = square.map(|value| value.max(0.0).sqrt());
    let mut best = 0;
    for candidate in 1..4 {
        if size[candidate] > size[best] {
            best = candidate;
        }
    }
    let (difference_x, difference_y, difference_z) = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]);
    let (sum_xy, sum_xz, sum_yz) = (m[1][0] + m[0][1], m[0][2] + m[2][0], m[1][2] + m[2][1]);
    let own = size[best] * size[best];
    let raw = match best {
        0 => [difference_x, difference_y, difference_z, own],
        1 => [own, sum_xy, sum_xz, difference_x],
        2 => [sum_xy, own, sum_yz, difference_y],
        _ => [sum_xz, sum_yz, own, difference_z],
    };
    let scale = if raw[3] < 0.0 { -0.5 } else { 0.5 } / size[best];
    raw.map(|value| value * scale)
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
pub fn ray_maps(cameras: &[Camera], [height, width]: [usize; 2], device: &Device) -> Tensor<4> {
    let maps = cameras.iter().flat_map(|camera| camera.ray_map(height, width));
    from_host(maps.collect(), [cameras.len(), 6, height, width], device)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_seen_from_another_has_it_as_origin() {
        let first = Camera {
            rotation: [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            translation_iu: [1.0, 2.0, 3.0],
            focal_centre: [1.0, 1.0, 0.5, 0.5],
        };
        assert_eq!(first.seen_from(&first.pose()).pose(), FramePose::IDENTITY);
        let moved = Camera {
            translation_iu: [1.0, 3.0, 3.0],
            ..first
        };
        // One unit along y of the reconstruction frame is one along x of the first camera.
        let seen = moved.seen_from(&first.pose());
        assert_eq!(seen.translation_iu, [1.0, 0.0, 0.0]);
        assert_eq!(seen.rotation, FramePose::IDENTITY.rotation);
    }
}
