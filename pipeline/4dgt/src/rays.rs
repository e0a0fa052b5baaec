//! Rays of pixels, and what the network sees of a pixel (`docs/spec/baseline-4dgt.md` section 3).

use rogs_geometry::{Camera, Frame, Pinhole, Pose, pixel_centre};

use crate::config::{INPUTS, PATCH};

/// The frame in which the network sees the cameras of a stream: [`crate::mean_frame`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mean {}

impl Frame for Mean {
    const NAME: &'static str = "mean camera";
}

/// A frame's camera as the network takes it.
#[derive(Debug, Clone, Copy)]
pub struct RayCamera {
    /// Focal lengths and principal point at the size of the network's images, pixels.
    pub lens: Pinhole,
    /// Its pose, metres.
    pub mean_from_camera: Pose<Mean, Camera>,
}

/// Rays of all pixels of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Rays {
    /// Their common origin, metres.
    pub origin: [f32; 3],
    /// Directions of camera depth 1, so that `origin + depth * direction` lies at that depth. `[H, W, 3]`
    pub direction: Vec<f32>,
}

impl Rays {
    /// The rays of a camera's pixels.
    #[must_use]
    pub fn new(camera: &RayCamera) -> Self {
        let RayCamera { lens, mean_from_camera } = camera;
        let (height, width) = (lens.height, lens.width);
        let mut direction = Vec::with_capacity(height as usize * width as usize * 3);
        for row in 0..height {
            for column in 0..width {
                let own = lens.unproject(pixel_centre(column, row), 1.0);
                direction.extend(mean_from_camera.direction(own).as_vec3().to_array());
            }
        }
        Self {
            origin: mean_from_camera.translation.as_vec3().to_array(),
            direction,
        }
    }

    /// Plücker coordinates as the released weights expect them: directions are divided by their norm along the image's
    /// width, component by component, and not by their length; the moment comes first. `[6, H, W]`
    #[must_use]
    pub fn plucker(&self, width: usize) -> Vec<f32> {
        let area = self.direction.len() / 3;
        let mut planes = vec![0.0f32; 6 * area];
        let (moments, normals) = planes.split_at_mut(3 * area);
        for component in 0..3 {
            let plane = &mut normals[component * area..][..area];
            for (row, directions) in plane
                .chunks_exact_mut(width)
                .zip(self.direction.chunks_exact(3 * width))
            {
                let own = || directions.iter().skip(component).step_by(3);
                let norm = own().map(|value| value * value).sum::<f32>().sqrt() + 1e-8;
                row.iter_mut().zip(own()).for_each(|(out, value)| *out = value / norm);
            }
        }
        let [x, y, z] = self.origin;
        for pixel in 0..area {
            let n: [f32; 3] = std::array::from_fn(|component| normals[component * area + pixel]);
            moments[pixel] = y * n[2] - z * n[1];
            moments[area + pixel] = z * n[0] - x * n[2];
            moments[2 * area + pixel] = x * n[1] - y * n[0];
        }
        planes
    }
}

/// What the network sees of an image's patches: colours in -1 to 1, the time in seconds and Plücker coordinates, patch by
/// patch. `image [3, H, W]` in 0 to 1; `[N, INPUTS * PATCH^2]`, within a patch by channel, row and column
#[must_use]
pub fn patch_numbers(image: &[f32], time_s: f32, plucker: &[f32], [height, width]: [usize; 2]) -> Vec<f32> {
    let area = height * width;
    let value = |channel: usize, pixel: usize| match channel {
        0..3 => image[channel * area + pixel] * 2.0 - 1.0,
        3 => time_s,
        _ => plucker[(channel - 4) * area + pixel],
    };
    let mut numbers = Vec::with_capacity(INPUTS * area);
    for row in 0..height / PATCH {
        for column in 0..width / PATCH {
            for channel in 0..INPUTS {
                for y in 0..PATCH {
                    let first = (row * PATCH + y) * width + column * PATCH;
                    numbers.extend((first..first + PATCH).map(|pixel| value(channel, pixel)));
                }
            }
        }
    }
    numbers
}
