//! The plane sweep of `compact-sweep`: at which depth a pixel's neighbourhood looks alike in the other cameras of the
//! same moment.
//!
//! Cameras are calibrated, so that every depth of a pixel is one place in another image. Attention over all tokens would
//! have to learn this from poses and rays. The sweep compares learned features along the ray and adds what it finds to the
//! second level of the stem. The features need a loss of their own (`sweep` in `rogs-train`): through the losses of depth
//! alone they learned nothing.

use std::sync::Arc;

use burn::tensor::Tensor;
use burn::tensor::activation::log_softmax;
use rogs_schemas::units::UNITS_PER_METRE;

use super::aggregator::Attention;
use super::config::Stage1Config;
use super::geometry::Camera;
use super::network::SourceFrames;
use super::stem;
use crate::kernels::{self, Partner, SWEEP_FEATURES, Sweep, differentiable};
use crate::ops::{self, Conv};
use crate::parameters::{Scope, from_host, to_host};
use crate::{Error, Result};

/// The level of the stem that learns what the sweep finds.
pub(super) const LEVEL: usize = 1;
/// The levels whose features are compared, that one first; the coarser ones know more of the surroundings.
pub(super) const COMPARED: [usize; 3] = [LEVEL, 2, 3];
/// Side of a cell of the sweep, pixels.
pub const CELL_PIXELS: usize = stem::CELL.pow(LEVEL as u32 + 1);
/// Features that are compared.
pub(super) const FEATURES: usize = SWEEP_FEATURES;
/// Channels between the two convolutions that read the similarities.
pub(super) const HIDDEN: usize = 64;
/// First and last depth, metres; the others lie between them at equal ratios.
const DEPTHS_M: [f64; 2] = [0.1, 4.0];
/// Numbers that sum up the probabilities of a cell: the expected logarithm of the depth, and how sure it is.
const SUMMARIES: usize = 2;
/// Logits of depths are this times the similarity, a cosine.
const SHARPNESS: f64 = 16.0;
/// What a depth that no other camera sees loses in its logit.
const UNSEEN: f64 = 8.0;
/// Keeps features of length zero finite.
const EPSILON: f64 = 1e-6;

/// Channels that the convolutions after the sweep read: the level's own, similarities, shares of cameras, and what the
/// probabilities of depths amount to.
#[must_use]
pub(super) fn inputs(config: &Stage1Config) -> usize {
    config.stem_channels[LEVEL] + 2 * config.sweep_depths + SUMMARIES
}

/// The sweep over a scope of parameters (`stem.sweep`).
pub(super) struct Sweeping<'a> {
    scope: Scope<'a>,
    config: &'a Stage1Config,
}

/// What a sweep finds.
pub(super) struct Swept {
    /// Features of the level with what the other cameras say. `[S, c, h, w]`
    pub(super) features: Tensor<4>,
    /// Logarithm of the probability of each depth. `[S, D, h, w]`
    pub(super) depths: Tensor<4>,
}

impl<'a> Sweeping<'a> {
    /// The sweep of a scope.
    #[must_use]
    pub(super) fn new(scope: Scope<'a>, config: &'a Stage1Config) -> Self {
        Self { scope, config }
    }

    /// Compares the frames by the features of the compared levels; `None` without a sweep, or when no frame has another
    /// camera at its time that it may attend to. A frame that has none keeps its features. `3 x [S, c, h, w]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape, or gradients are asked for on a device that has none of this.
    pub(super) fn join(&self, levels: [&Tensor<4>; 3], frames: &SourceFrames) -> Result<Option<Swept>> {
        if self.config.sweep_depths == 0 {
            return Ok(None);
        }
        let own = levels[0];
        let [count, channels, rows, columns] = own.dims();
        let [_, _, height, width] = frames.images.dims();
        let image = [height, width].map(|side| side as f64 / CELL_PIXELS as f64);
        let plan = plan(frames, self.config.sweep_depths, [rows, columns], image);
        if plan.partners.iter().all(Vec::is_empty) {
            return Ok(None);
        }
        let (device, plan) = (own.device(), Arc::new(plan));
        let constant = |values: Vec<f32>, shape: [usize; 4]| from_host::<4>(values, shape, &device);
        let similarity = similarity(self.compared(levels)?, plan.clone())?;
        let visible = constant(plan.visible(), plan.shape());
        let unseen = visible.clone().lower_equal_elem(0.0).float();
        let depths = log_softmax(similarity.clone() * SHARPNESS - unseen * UNSEEN, 1);
        let likely = depths.clone().exp();
        let logs = plan
            .depths_iu
            .iter()
            .map(|&depth| libm::logf(depth) - libm::logf(UNITS_PER_METRE as f32));
        let expected = (likely.clone() * constant(logs.collect(), [1, plan.depths_iu.len(), 1, 1])).sum_dim(1);
        let certainty = likely.powf_scalar(2.0).sum_dim(1);
        let read = Tensor::cat(vec![own.clone(), similarity, visible, expected, certainty], 1);
        let first = self.conv("conv1", [HIDDEN, inputs(self.config)])?.forward(read);
        let second = self.conv("conv2", [channels, HIDDEN])?.forward(ops::relu(first));
        let accompanied = plan.partners.iter().map(|partners| f32::from(!partners.is_empty()));
        let said = second * constant(accompanied.collect(), [count, 1, 1, 1]);
        Ok(Some(Swept {
            features: own.clone() + said,
            depths,
        }))
    }

    /// The features that are compared, of length one. `3 x [S, c, h, w] -> [S, F, h, w]`
    fn compared(&self, levels: [&Tensor<4>; 3]) -> Result<Tensor<4>> {
        let [_, _, rows, columns] = levels[0].dims();
        let mut sum: Option<Tensor<4>> = None;
        for (index, level) in levels.into_iter().enumerate() {
            let conv = self.conv(&format!("features.{index}"), [FEATURES, level.dims()[1]])?;
            let map = conv.forward(level.clone());
            sum = Some(match sum {
                Some(sum) => sum + ops::resize(map, [rows, columns]),
                None => map,
            });
        }
        let Some(map) = sum else {
            return Err(Error::BadConfiguration("a sweep that compares no level".into()));
        };
        // Less what all of an image has in common: brightness, and what is the same for every feature.
        let map = map.clone() - map.mean_dims(&[2, 3]);
        let length = (map.clone().powf_scalar(2.0).sum_dim(1) + EPSILON).sqrt();
        Ok(map / length)
    }

    fn conv(&self, name: &str, shape: [usize; 2]) -> Result<Conv> {
        Conv::load(&self.scope.child(name), shape, 3, 1)
    }
}

fn similarity(features: Tensor<4>, plan: Arc<Sweep>) -> Result<Tensor<4>> {
    if differentiable::usable(&features) {
        return Ok(differentiable::sweep(features, plan));
    }
    if features.is_autodiff() {
        return Err(Error::BadInput(
            "gradients of the plane sweep are computed on the CPU only".into(),
        ));
    }
    let shape = plan.shape();
    if kernels::usable(&features) {
        let values = move |features: &[f32], _: &[f32]| plan.similarity(features);
        return Ok(kernels::read(features.clone(), features, shape, values));
    }
    let device = features.device();
    Ok(from_host(plan.similarity(&to_host(features)?), shape, &device))
}

/// The place of a depth among `depths` of a sweep: its index where it is one of them; below 0 or above the last index
/// outside them.
#[must_use]
pub fn place(depth_iu: f64, depths: usize) -> f64 {
    let [near, far] = DEPTHS_M.map(|depth| depth * UNITS_PER_METRE);
    libm::log(depth_iu / near) / libm::log(far / near) * depths.saturating_sub(1) as f64
}

/// Which frames are compared at which depths. `image`: rows and columns of the image in cells.
fn plan(frames: &SourceFrames, depths: usize, size: [usize; 2], image: [f64; 2]) -> Sweep {
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
        size,
        image: image.map(|side| side as f32),
        depths_iu: (0..depths).map(depth).collect(),
        partners,
    }
}

/// How the cells of one camera are seen in another. With K of cells to rays of depth 1 and the pose (R, t) of each camera,
/// the point `R ray depth + t` lies at `K' R'^T (R K^-1 (x, y, 1) depth + t - t')`.
fn partner(from: &Camera, frame: usize, to: &Camera, [rows, columns]: [f64; 2]) -> Partner {
    let [fx, fy, cx, cy] = from.focal_centre;
    // A cell's centre is half a cell from its corner.
    let direction = |x: f64, y: f64| [((x + 0.5) / columns - cx) / fx, ((y + 0.5) / rows - cy) / fy, 1.0];
    let there = |point: [f64; 3]| {
        let r = &to.rotation;
        let local: [f64; 3] = std::array::from_fn(|axis| (0..3).map(|k| r[3 * k + axis] * point[k]).sum());
        let [fx, fy, cx, cy] = to.focal_centre;
        [
            fx * columns * local[0] + (cx * columns - 0.5) * local[2],
            fy * rows * local[1] + (cy * rows - 0.5) * local[2],
            local[2],
        ]
    };
    let turned = |v: [f64; 3]| {
        let r = &from.rotation;
        there(std::array::from_fn(|row| (0..3).map(|k| r[3 * row + k] * v[k]).sum()))
    };
    // The map is linear in (x, y, 1): its columns are differences of its values.
    let origin = direction(0.0, 0.0);
    let less = |a: [f64; 3]| std::array::from_fn(|axis| a[axis] - origin[axis]);
    let images = [
        turned(less(direction(1.0, 0.0))),
        turned(less(direction(0.0, 1.0))),
        turned(origin),
    ];
    let between = std::array::from_fn(|axis| from.translation_iu[axis] - to.translation_iu[axis]);
    Partner {
        frame,
        turn: std::array::from_fn(|k| images[k % 3][k / 3] as f32),
        shift: there(between).map(|number| number as f32),
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::stage1::seeded;

    const SIZE: [usize; 2] = [8, 12];

    /// A camera that stands somewhere, turned about two axes.
    fn camera(yaw: f64, pitch: f64, translation_iu: [f64; 3]) -> Camera {
        let (sy, cy, sp, cp) = (libm::sin(yaw), libm::cos(yaw), libm::sin(pitch), libm::cos(pitch));
        Camera {
            rotation: [cy, sy * sp, sy * cp, 0.0, cp, -sp, -sy, cy * sp, cy * cp],
            translation_iu,
            focal_centre: [0.6, 1.1, 0.48, 0.53],
        }
    }

    fn frames(attention: Attention) -> SourceFrames {
        let cameras = vec![
            camera(0.0, 0.0, [0.0; 3]),
            camera(0.3, -0.1, [-1.0, 0.2, 0.1]),
            camera(-0.4, 0.2, [1.5, -0.3, 0.4]),
            camera(0.1, 0.0, [0.3, 0.0, 0.0]),
        ];
        SourceFrames {
            images: Tensor::zeros([4, 3, SIZE[0] * 4, SIZE[1] * 4 - 2], &Device::flex()),
            cameras,
            times: vec![0.0, 0.0, 0.0, 0.5],
            attention,
        }
    }

    fn plan_of(attention: Attention) -> Sweep {
        plan(&frames(attention), 5, SIZE, [8.0, 11.5])
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

    /// Against points made by `Camera::unproject` and seen by `Camera::project`.
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
                let expected = [u * image[1] - 0.5, v * image[0] - 0.5];
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
            times: vec![0.0; 2],
            images: Tensor::zeros([2, 3, 64, 96], &Device::flex()),
            attention: Attention::Joint,
        };
        let size = [16, 24];
        let plan = plan(&frames, 9, size, [16.0, 24.0]);
        let right = 4;
        let depth = plan.depths_iu[right];
        let texture = |x: f64, y: f64| -> Vec<f32> {
            let wave = |k: usize| libm::sin(x * (1.0 + k as f64 * 0.2) + y * (k as f64 - 7.0) * 0.3 + k as f64);
            let values: Vec<f64> = (0..FEATURES).map(wave).collect();
            let length = libm::sqrt(values.iter().map(|value| value * value).sum());
            values.iter().map(|value| (value / length) as f32).collect()
        };
        let mut features = vec![0.0f32; 2 * FEATURES * 16 * 24];
        for (frame, camera) in frames.cameras.iter().enumerate() {
            let points = camera.unproject(&[depth; 16 * 24], 16, 24);
            for (pixel, point) in points.chunks_exact(3).enumerate() {
                for (channel, value) in texture(f64::from(point[0]), f64::from(point[1]))
                    .into_iter()
                    .enumerate()
                {
                    features[(frame * FEATURES + channel) * 16 * 24 + pixel] = value;
                }
            }
        }
        let (similarity, visible) = (plan.similarity(&features), plan.visible());
        let at = |values: &[f32], depth: usize, pixel: usize| values[depth * 16 * 24 + pixel];
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

    /// Noise through seeded layers, the last one not zero.
    fn said(attention: Attention) -> Option<Vec<f32>> {
        let device = Device::flex();
        let config = Stage1Config::compact_sweep();
        let mut network = seeded::network(&config, 3, &device).unwrap();
        let name = "stem.sweep.conv2.weight";
        let shape = network.parameters.shape(name).unwrap().to_vec();
        let count = shape.iter().product();
        network.parameters.insert(name, &shape, vec![0.01; count]).unwrap();
        let noise = |k: usize| ((k * 7919 + 13) % 1009) as f32 / 1009.0;
        let levels = COMPARED.map(|level| {
            let shape = [
                4,
                config.stem_channels[level],
                SIZE[0] >> (level - 1),
                SIZE[1] >> (level - 1),
            ];
            from_host::<4>((0..shape.iter().product()).map(noise).collect(), shape, &device)
        });
        let sweeping = Sweeping::new(network.parameters.scope("stem.sweep"), &config);
        let found = sweeping.join(levels.each_ref(), &frames(attention)).unwrap();
        found.map(|found| to_host(found.features - levels[0].clone()).unwrap())
    }

    #[test]
    fn frames_without_company_keep_their_features() {
        let accompanied = said(Attention::Joint).unwrap();
        let frames: Vec<&[f32]> = accompanied.chunks_exact(accompanied.len() / 4).collect();
        for frame in &frames[..3] {
            assert!(frame.iter().any(|value| value.abs() > 1e-3));
        }
        assert!(frames[3].iter().all(|&value| value == 0.0));
        assert_eq!(said(Attention::WithinCamera(vec![0, 1, 2, 0])), None);
    }

    #[test]
    fn gradients_equal_differences() {
        let plan = plan_of(Attention::Joint);
        let noise = |k: usize| ((k * 7919 + 13) % 1009) as f32 / 504.5 - 1.0;
        let features: Vec<f32> = (0..4 * FEATURES * SIZE[0] * SIZE[1]).map(noise).collect();
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
        assert!(largest > 0.5);
    }
}
