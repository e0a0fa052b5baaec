//! Which frames a sweep compares, at which points.

use glam::DVec3;
use rogs_schemas::units::UNITS_PER_METRE;

use super::super::frames::Attention;
use super::super::frames::SourceFrames;
use super::super::geometry::NetworkCamera;
use super::CELL_PIXELS;
use rogs_kernels::sweep::FINER as SWEEP_FINER;
use rogs_kernels::{Partner, Sweep};

/// First and last depth, metres; the others lie between them at equal ratios.
const DEPTHS_M: [f64; 2] = [0.1, 4.0];

/// The place of a depth among `depths` of a sweep: its index where it is one of them; below 0 or above the last index
/// outside them.
#[must_use]
pub fn place(depth_iu: f64, depths: usize) -> f64 {
    let [near, far] = DEPTHS_M.map(|depth| depth * UNITS_PER_METRE);
    libm::log(depth_iu / near) / libm::log(far / near) * depths.saturating_sub(1) as f64
}

/// Which frames are compared at which depths. `grid`: rows and columns of the map of features.
pub(super) fn plan(frames: &SourceFrames, depths: usize, grid: [usize; 2]) -> Sweep {
    let [_, _, height, width] = frames.images.dims();
    let image = [height, width].map(|side| side as f64 / CELL_PIXELS as f64);
    let [near, far] = DEPTHS_M.map(|depth| depth * UNITS_PER_METRE);
    let depth = |index: usize| {
        let share = index as f64 / depths.saturating_sub(1).max(1) as f64;
        (near * libm::pow(far / near, share)) as f32
    };
    let cameras = &frames.cameras;
    let partners = (0..cameras.len())
        .map(|frame| {
            let others = (0..cameras.len()).filter(|&other| {
                let attends = match &frames.attention {
                    Attention::Joint => true,
                    Attention::WithinCamera(of) => of.get(frame) == of.get(other),
                };
                other != frame && attends && frames.times.get(frame) == frames.times.get(other)
            });
            others
                .map(|other| partner(&cameras[frame], other, &cameras[other], image))
                .collect()
        })
        .collect();
    Sweep {
        size: [height, width].map(|side| side.div_ceil(CELL_PIXELS)),
        grid,
        image: image.map(|side| side as f32 * SWEEP_FINER as f32),
        depths_iu: (0..depths).map(depth).collect(),
        partners,
    }
}

/// How the cells of one camera are seen on the grid of another. With K of cells (or of the grid) to rays of depth 1 and the
/// pose (R, t) of each camera, the point `R ray depth + t` lies at `K' R'^T (R K^-1 (x, y, 1) depth + t - t')`.
/// `image`: rows and columns of the image in cells.
fn partner(from: &NetworkCamera, frame: usize, to: &NetworkCamera, [rows, columns]: [f64; 2]) -> Partner {
    // Centres are half a cell, or half a place of the grid, from their corner.
    let ray = |x: f64, y: f64| from.ray((x + 0.5) / columns, (y + 0.5) / rows);
    let there = |point: DVec3| {
        let [fx, fy, cx, cy] = to.focal_centre;
        let (local, finer) = (to.turned(point), SWEEP_FINER as f64);
        [
            fx * columns * finer * local.x + (cx * columns * finer - 0.5) * local.z,
            fy * rows * finer * local.y + (cy * rows * finer - 0.5) * local.z,
            local.z,
        ]
    };
    // The map is linear in (x, y, 1): its columns are differences of its values.
    let origin = ray(0.0, 0.0);
    let images = [
        there(ray(1.0, 0.0) - origin),
        there(ray(0.0, 1.0) - origin),
        there(origin),
    ];
    let between_iu = from.world_from_camera_iu.translation - to.world_from_camera_iu.translation;
    Partner {
        frame,
        turn: std::array::from_fn(|k| images[k % 3][k / 3] as f32),
        shift: there(between_iu).map(|number| number as f32),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use burn::tensor::{Device, Tensor};
    use glam::DMat3;
    use rogs_geometry::Pose;

    use super::*;
    use rogs_kernels::sweep::FEATURES as SWEEP_FEATURES;

    const SIZE: [usize; 2] = [8, 12];
    const GRID: [usize; 2] = [16, 23];

    /// A camera that stands somewhere, turned about two axes.
    fn camera(yaw: f64, pitch: f64, translation_iu: [f64; 3]) -> NetworkCamera {
        let (sy, cy, sp, cp) = (libm::sin(yaw), libm::cos(yaw), libm::sin(pitch), libm::cos(pitch));
        let rotation = DMat3::from_cols_array(&[cy, 0.0, -sy, sy * sp, cp, cy * sp, sy * cp, -sp, cy * cp]);
        NetworkCamera {
            world_from_camera_iu: Pose::new(rotation, DVec3::from_array(translation_iu)),
            focal_centre: [0.6, 1.1, 0.48, 0.53],
        }
    }

    pub(in super::super) fn frames(attention: Attention) -> SourceFrames {
        let cameras = vec![
            camera(0.0, 0.0, [0.0; 3]),
            camera(0.3, -0.1, [-1.0, 0.2, 0.1]),
            camera(-0.4, 0.2, [1.5, -0.3, 0.4]),
            camera(0.1, 0.0, [0.3, 0.0, 0.0]),
        ];
        SourceFrames {
            images: Tensor::zeros([4, 3, SIZE[0] * 4, SIZE[1] * 4 - 2], &Device::flex()),
            cameras,
            recon_from_base_iu: Pose::IDENTITY,
            times: vec![0.0, 0.0, 0.0, 0.5],
            attention,
        }
    }

    fn plan_of(attention: Attention) -> Sweep {
        plan(&frames(attention), 5, GRID)
    }

    #[test]
    fn frames_are_compared_with_others_of_their_time_that_they_may_attend_to() {
        let partners = |attention| -> Vec<Vec<usize>> {
            let of = |partners: &Vec<Partner>| partners.iter().map(|partner| partner.frame).collect();
            plan_of(attention).partners.iter().map(of).collect()
        };
        assert_eq!(partners(Attention::Joint), [vec![1, 2], vec![0, 2], vec![0, 1], vec![]]);
        assert_eq!(partners(Attention::WithinCamera(vec![0, 1, 2, 0])), [[0usize; 0]; 4]);
    }

    #[test]
    fn depths_go_from_the_first_to_the_last_at_equal_ratios() {
        let depths = plan_of(Attention::Joint).depths_iu;
        assert!((f64::from(depths[0]) - 0.35).abs() < 1e-6 && (f64::from(depths[4]) - 14.0).abs() < 1e-5);
        assert!((f64::from(depths[2]) - libm::sqrt(0.35 * 14.0)).abs() < 1e-5);
        for (index, &depth) in depths.iter().enumerate() {
            assert!((place(f64::from(depth), 5) - index as f64).abs() < 1e-6);
        }
    }

    /// Against points made by `NetworkCamera::unproject` and seen by `NetworkCamera::project`.
    #[test]
    fn a_point_lies_where_the_other_camera_sees_it() {
        let frames = frames(Attention::Joint);
        let image = [8.0, 11.5];
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let (a, b) = (&frames.cameras[from], &frames.cameras[to]);
            let partner = partner(a, to, b, image);
            for (x, y, depth) in [(0.0, 0.0, 0.7), (3.0, 5.0, 2.0), (10.0, 7.0, 9.0)] {
                let (height, width) = (24, 69);
                let points = a.unproject(&vec![depth; height * width], height, width);
                // Rows of a third of a cell have its centre in the middle one, columns of a sixth between two.
                let (row, column) = (3 * y as usize + 1, 6 * x as usize + 2);
                let point: [f64; 3] = std::array::from_fn(|axis| {
                    let at = |column: usize| f64::from(points[3 * (row * width + column) + axis]);
                    0.5 * (at(column) + at(column + 1))
                });
                let ([u, v], _) = b.project(point);
                // On a grid twice as fine as the cells.
                let expected = [2.0 * u * image[1] - 0.5, 2.0 * v * image[0] - 0.5];
                let q: [f64; 3] = std::array::from_fn(|k| {
                    let turn = |n: usize| f64::from(partner.turn[3 * k + n]);
                    (turn(0) * x + turn(1) * y + turn(2)) * f64::from(depth) + f64::from(partner.shift[k])
                });
                for (found, expected) in [q[0] / q[2], q[1] / q[2]].into_iter().zip(expected) {
                    assert!(
                        (found - expected).abs() < 1e-4 * (1.0 + expected.abs()),
                        "{found} {expected}"
                    );
                }
            }
        }
    }

    /// Features that are a smooth function of the point in space are most alike where the point really is.
    #[test]
    fn a_textured_plane_is_found_at_its_depth() {
        let frames = SourceFrames {
            cameras: vec![camera(0.0, 0.0, [0.0; 3]), camera(0.0, 0.0, [0.6, 0.0, 0.0])],
            recon_from_base_iu: Pose::IDENTITY,
            times: vec![0.0; 2],
            images: Tensor::zeros([2, 3, 64, 96], &Device::flex()),
            attention: Attention::Joint,
        };
        let plan = plan(&frames, 9, [32, 48]);
        assert_eq!(plan.size, [16, 24]);
        let right = 4;
        let depth = plan.depths_iu[right];
        let texture = |x: f64, y: f64| -> Vec<f32> {
            let wave = |k: usize| libm::sin(x * (1.0 + k as f64 * 0.2) + y * (k as f64 - 7.0) * 0.3 + k as f64);
            let values: Vec<f64> = (0..SWEEP_FEATURES).map(wave).collect();
            let length = libm::sqrt(values.iter().map(|value| value * value).sum());
            values.iter().map(|value| (value / length) as f32).collect()
        };
        let mut features = vec![0.0f32; 2 * SWEEP_FEATURES * 32 * 48];
        for (frame, camera) in frames.cameras.iter().enumerate() {
            let points = camera.unproject(&[depth; 32 * 48], 32, 48);
            for (pixel, point) in points.chunks_exact(3).enumerate() {
                for (channel, value) in texture(f64::from(point[0]), f64::from(point[1]))
                    .into_iter()
                    .enumerate()
                {
                    features[(frame * SWEEP_FEATURES + channel) * 32 * 48 + pixel] = value;
                }
            }
        }
        let (similarity, visible) = (plan.similarity(&features), plan.visible());
        let at = |values: &[f32], depth: usize, pixel: usize| values[depth * 16 * 24 + pixel];
        // Half of the features are in the first group.
        let similarity: Vec<f32> = (0..9 * 16 * 24)
            .map(|k| similarity[k] + similarity[9 * 16 * 24 + k])
            .collect();
        for pixel in [8 * 24 + 12, 3 * 24 + 15] {
            let best = (0..9).max_by(|&a, &b| at(&similarity, a, pixel).total_cmp(&at(&similarity, b, pixel)));
            assert_eq!(best, Some(right));
            assert!(at(&similarity, right, pixel) > 0.95);
            assert_eq!(at(&visible, right, pixel), 1.0);
            // Very near points of the middle are outside the other image.
            assert_eq!(at(&visible, 0, pixel), 0.0);
            assert_eq!(at(&similarity, 0, pixel), 0.0);
        }
    }

    #[test]
    fn gradients_equal_differences() {
        let plan = plan_of(Attention::Joint);
        let noise = |k: usize| ((k * 7919 + 13) % 1009) as f32 / 504.5 - 1.0;
        let features: Vec<f32> = (0..4 * SWEEP_FEATURES * GRID[0] * GRID[1]).map(noise).collect();
        let slopes: Vec<f32> = (0..plan.shape().iter().product()).map(|k| noise(k + 5)).collect();
        let gradient = plan.gradient(&slopes, &features);
        let value = |features: &[f32]| -> f64 {
            let similarity = plan.similarity(features);
            similarity
                .iter()
                .zip(&slopes)
                .map(|(&a, &b)| f64::from(a) * f64::from(b))
                .sum()
        };
        let mut largest = 0.0f32;
        for entry in (0..features.len()).step_by(97) {
            let shifted = |by: f32| {
                let mut features = features.clone();
                features[entry] += by;
                value(&features)
            };
            // The sum is of second order in the features, so that central differences are exact.
            let difference = (shifted(0.5) - shifted(-0.5)) as f32;
            assert!(
                (gradient[entry] - difference).abs() < 1e-3,
                "{} {difference}",
                gradient[entry]
            );
            largest = largest.max(difference.abs());
        }
        assert!(largest > 0.1);
    }
}
