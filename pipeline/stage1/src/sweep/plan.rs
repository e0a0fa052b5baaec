//! Which frames a sweep compares, at which depths and points.

use glam::DVec3;
use rogs_schemas::units::UNITS_PER_METRE;

use super::super::config::Stage1Config;
use super::super::frames::{Attention, SourceFrames};
use super::super::geometry::NetworkCamera;
use super::CELL_PIXELS;
use rogs_kernels::sweep::FINER as SWEEP_FINER;
use rogs_kernels::{Partner, Sweep};

/// Frames of other times are compared where the camera has moved at least this far, metres: nearer ones show the same.
const LEAST_BASELINE_M: f64 = 0.03;

/// The depths of a sweep: they lie at equal ratios.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepDepths {
    count: usize,
    /// First and last one, internal units.
    range_iu: [f64; 2],
}

impl SweepDepths {
    /// The depths of a configuration.
    #[must_use]
    pub fn of(config: &Stage1Config) -> Self {
        Self {
            count: config.sweep_depths,
            range_iu: config
                .sweep_range_mm
                .map(|depth_mm| f64::from(depth_mm) * 1e-3 * UNITS_PER_METRE),
        }
    }

    /// The place of a depth among them: its index where it is one of them; below 0 or above the last index outside them.
    #[must_use]
    pub fn place(&self, depth_iu: f64) -> f64 {
        let [near, far] = self.range_iu;
        libm::log(depth_iu / near) / libm::log(far / near) * self.last() as f64
    }

    /// The place of a depth as a share of the way from the first to the last one.
    pub(super) fn share(&self, depth_iu: f64) -> f64 {
        self.place(depth_iu) / self.last().max(1) as f64
    }

    /// All of them, internal units. `[D]`
    pub(super) fn all_iu(&self) -> Vec<f32> {
        let [near, far] = self.range_iu;
        let depth = |index: usize| {
            let share = index as f64 / self.last().max(1) as f64;
            (near * libm::pow(far / near, share)) as f32
        };
        (0..self.count).map(depth).collect()
    }

    const fn last(&self) -> usize {
        self.count.saturating_sub(1)
    }
}

/// The frames of a clip that are compared with each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Compared {
    /// Those of other cameras at the same moment.
    SameMoment,
    /// Those of other times, from other places, at most so many.
    OtherTimes(usize),
}

/// Which frames are compared at which depths. `grid`: rows and columns of the map of features.
pub(super) fn plan(frames: &SourceFrames, depths: &SweepDepths, compared: Compared, grid: [usize; 2]) -> Sweep {
    let [_, _, height, width] = frames.images.dims();
    let image = [height, width].map(|side| side as f64 / CELL_PIXELS as f64);
    let cameras = &frames.cameras;
    let partners = (0..cameras.len())
        .map(|frame| {
            let others = match compared {
                Compared::SameMoment => of_the_same_moment(frames, frame),
                Compared::OtherTimes(most) => of_other_times(frames, frame, most),
            };
            others
                .into_iter()
                .map(|other| partner(&cameras[frame], other, &cameras[other], image))
                .collect()
        })
        .collect();
    Sweep {
        size: [height, width].map(|side| side.div_ceil(CELL_PIXELS)),
        grid,
        image: image.map(|side| side as f32 * SWEEP_FINER as f32),
        depths_iu: depths.all_iu(),
        partners,
    }
}

/// The frames that a frame may attend to, itself left out.
fn attended(frames: &SourceFrames, frame: usize) -> impl Iterator<Item = usize> + '_ {
    (0..frames.cameras.len()).filter(move |&other| {
        let attends = match &frames.attention {
            Attention::Joint => true,
            Attention::WithinCamera(of) => of.get(frame) == of.get(other),
        };
        other != frame && attends
    })
}

/// The other frames of a frame's time.
fn of_the_same_moment(frames: &SourceFrames, frame: usize) -> Vec<usize> {
    attended(frames, frame)
        .filter(|&other| frames.times.get(frame) == frames.times.get(other))
        .collect()
}

/// The frames of other times whose cameras stand elsewhere than this one, than those of its own moment and than each other:
/// a camera that stands still says no more of what stands still. The nearest in time come first.
fn of_other_times(frames: &SourceFrames, frame: usize, most: usize) -> Vec<usize> {
    let centre = |frame: usize| frames.cameras[frame].world_from_camera_iu.translation;
    let time = |frame: usize| frames.times.get(frame).copied().unwrap_or_default();
    let mut known: Vec<DVec3> = of_the_same_moment(frames, frame).into_iter().map(centre).collect();
    known.push(centre(frame));
    let mut candidates: Vec<usize> = attended(frames, frame)
        .filter(|&other| time(other) != time(frame))
        .collect();
    candidates.sort_by(|&a, &b| {
        let away = |other: usize| (time(other) - time(frame)).abs();
        away(a).total_cmp(&away(b)).then(a.cmp(&b))
    });
    let mut chosen = Vec::new();
    for other in candidates {
        let elsewhere = |from: &DVec3| from.distance(centre(other)) >= LEAST_BASELINE_M * UNITS_PER_METRE;
        if chosen.len() < most && known.iter().all(elsewhere) {
            known.push(centre(other));
            chosen.push(other);
        }
    }
    chosen
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

    fn depths(count: usize) -> SweepDepths {
        SweepDepths::of(&Stage1Config {
            sweep_depths: count,
            ..Stage1Config::compact_sweep()
        })
    }

    fn plan_of(attention: Attention) -> Sweep {
        plan(&frames(attention), &depths(5), Compared::SameMoment, GRID)
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
    fn frames_of_other_times_are_compared_where_the_camera_has_moved() {
        // A wrist camera that moves by 10 cm, 1 cm and 20 cm, and a fixed one, at four times.
        let wrist = [0.0, 0.35, 0.385, 1.085].map(|x| camera(0.0, 0.0, [x, 0.0, 0.0]));
        let frames = |attention| SourceFrames {
            images: Tensor::zeros([8, 3, 16, 32], &Device::flex()),
            cameras: wrist
                .into_iter()
                .chain([camera(0.4, 0.0, [3.0, 0.0, 0.0]); 4])
                .collect(),
            recon_from_base_iu: Pose::IDENTITY,
            times: [0.0, 0.1, 0.2, 0.3].repeat(2),
            attention,
        };
        let partners = |attention, most| -> Vec<Vec<usize>> {
            let frames = frames(attention);
            (0..8).map(|frame| of_other_times(&frames, frame, most)).collect()
        };
        let all = partners(Attention::Joint, 4);
        // Frames 1 and 2 show the same; the fixed camera says at other times what it says at this one.
        assert_eq!(all[..4], [vec![1, 3], vec![0, 3], vec![3, 0], vec![2, 0]]);
        assert_eq!(all[4..], [vec![1, 3], vec![0, 3], vec![3, 0], vec![2, 0]]);
        assert_eq!(partners(Attention::Joint, 1)[3], [2]);
        let within = partners(Attention::WithinCamera(vec![0, 0, 0, 0, 1, 1, 1, 1]), 4);
        assert_eq!(within[..4], all[..4]);
        assert!(within[4..].iter().all(Vec::is_empty));
    }

    #[test]
    fn depths_go_from_the_first_to_the_last_at_equal_ratios() {
        let all = plan_of(Attention::Joint).depths_iu;
        assert!((f64::from(all[0]) - 0.35).abs() < 1e-6 && (f64::from(all[4]) - 14.0).abs() < 1e-5);
        assert!((f64::from(all[2]) - libm::sqrt(0.35 * 14.0)).abs() < 1e-5);
        for (index, &depth) in all.iter().enumerate() {
            assert!((depths(5).place(f64::from(depth)) - index as f64).abs() < 1e-6);
            assert!((depths(5).share(f64::from(depth)) - index as f64 / 4.0).abs() < 1e-6);
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
        let plan = plan(&frames, &depths(9), Compared::SameMoment, [32, 48]);
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
