//! The plane sweep of `compact-sweep` and `compact-wide`: at which depth a pixel's neighbourhood looks alike in the other cameras of the
//! same moment, and what depth follows from that and from the image.
//!
//! Cameras are calibrated, so that every depth of a pixel is one place in another image. Attention over all tokens would
//! have to learn this from poses and rays. The sweep compares learned features along the ray, and a small U-shaped network
//! reads the similarities of all depths, the image and the rays. It knows nothing of the rest of Stage 1, so that it can be
//! trained alone (`sweep` and `sweep_depth` in `rogs-train`): an update costs a small part of one of the whole network.
//! What it finds is added to the second level of the stem.
//!
//! `compact-wide` also compares frames of other times from other places: what stands still gets a parallax from the path of
//! a moving camera, in a clip of one camera too. The two comparisons have channels of their own, because what moves fits
//! only one of them.

mod plan;
mod rays;

use std::sync::Arc;

use burn::tensor::Tensor;
use burn::tensor::activation::log_softmax;
use rogs_schemas::units::UNITS_PER_METRE;

use super::config::{CELL, Stage1Config};
use super::frames::{SourceFrames, normalised};
use super::pyramid::{cells, two_layers};
use crate::Result;
use plan::Compared;
use rogs_kernels::sweep::GROUPS as SWEEP_GROUPS;
use rogs_tensors::ops::{self, Conv};
use rogs_tensors::parameters::{Scope, from_host};

pub use plan::SweepDepths;

/// The level of the stem that learns what the sweep finds.
pub(super) const LEVEL: usize = 1;
/// Side of a cell of the sweep, pixels.
pub const CELL_PIXELS: usize = CELL.pow(LEVEL as u32 + 1);
/// Channels of the levels of a pyramid that sees the image alone, at a half, a quarter and an eighth of its size.
pub(super) const ENCODER_CHANNELS: [usize; 3] = [16, 32, 48];
/// Features that are compared, at half the image's size.
pub(super) const FEATURES: usize = rogs_kernels::sweep::FEATURES;
/// Channels of the levels of the network that reads the similarities, from cells on, each half as large as the one before.
pub(super) const DECODER_CHANNELS: [usize; 3] = [64, 64, 72];
/// Numbers that sum up the probabilities of a cell: the expected logarithm of the depth, and how sure it is.
const SUMMARIES: usize = 2;
/// Logits of matches are this times the cosine of the features.
const SHARPNESS: f64 = 16.0;
/// What a depth that no other camera sees loses in its logit.
const UNSEEN_PENALTY: f64 = 8.0;
/// How much of the cosine the logits of the depths have, next to what the network says.
const COSINE_WEIGHT: f64 = 8.0;
/// Similarities enter the network at this scale.
const SIMILARITY_SCALE: f64 = 2.0;
/// Keeps features of length zero finite.
const EPSILON: f64 = 1e-6;

/// Channels that the network reads of a cell: similarities, shares of cameras, the image's level, the ray.
#[must_use]
pub(super) const fn input_channels(config: &Stage1Config) -> usize {
    (SWEEP_GROUPS + 1) * config.sweep_depths + ENCODER_CHANNELS[LEVEL] + rays::NUMBERS
}

/// Channels of what is said to the stem.
pub(super) const OUTPUT_CHANNELS: usize = DECODER_CHANNELS[0] + SUMMARIES;

/// Channels of the network that reads the comparison with other times: those it makes, and those of its inputs.
pub(super) const OTHER_TIMES_CHANNELS: usize = 32;
/// Channels that are read of the comparison with other times: similarities and shares of frames.
#[must_use]
pub(super) const fn other_times_inputs(config: &Stage1Config) -> usize {
    (SWEEP_GROUPS + 1) * config.sweep_depths
}

/// What a sweep finds. `D` depths, cells of [`CELL_PIXELS`] pixels.
#[derive(Debug, Clone)]
pub struct SweptDepth {
    /// Logarithm of the probability of each depth by similarity alone. `[S, D, h, w]`
    pub matches: Tensor<4>,
    /// Logarithm of the probability of each depth. `[S, D, h, w]`
    pub depths: Tensor<4>,
    /// Expected logarithm of the depth in metres. `[S, 1, h, w]`
    pub log_depth_m: Tensor<4>,
    /// Last features of the network. `[S, c, h, w]`
    hidden: Tensor<4>,
    /// 1 for a frame that is compared with another, else 0. `[S, 1, 1, 1]`
    accompanied: Tensor<4>,
    /// Its depths.
    pub scale: SweepDepths,
}

impl SweptDepth {
    /// The same for some frames.
    #[must_use]
    pub(super) fn frames_at(&self, start: usize, count: usize) -> Self {
        let narrow = |map: &Tensor<4>| map.clone().narrow(0, start, count);
        Self {
            matches: narrow(&self.matches),
            depths: narrow(&self.depths),
            log_depth_m: narrow(&self.log_depth_m),
            hidden: narrow(&self.hidden),
            accompanied: narrow(&self.accompanied),
            scale: self.scale,
        }
    }
}

/// The sweep over a scope of parameters (`stem.sweep`).
pub(super) struct Sweeping<'a> {
    scope: Scope<'a>,
    config: &'a Stage1Config,
}

impl<'a> Sweeping<'a> {
    /// The sweep of a scope.
    #[must_use]
    pub(super) fn new(scope: Scope<'a>, config: &'a Stage1Config) -> Self {
        Self { scope, config }
    }

    /// Compares the frames; `None` without a sweep, or when no frame has another one to be compared with.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub(super) fn find(&self, frames: &SourceFrames) -> Result<Option<SweptDepth>> {
        if self.config.sweep_depths == 0 {
            return Ok(None);
        }
        let scale = SweepDepths::of(self.config);
        let seen = self.encode(normalised(frames.images.clone()))?;
        let [_, _, grid_rows, grid_columns] = seen[0].dims();
        let plan = |compared| Arc::new(plan::plan(frames, &scale, compared, [grid_rows, grid_columns]));
        let now = plan(Compared::SameMoment);
        let others = plan(Compared::OtherTimes(self.config.sweep_other_times));
        let partners = now.partners.iter().zip(&others.partners);
        let accompanied: Vec<f32> = partners
            .map(|(now, others)| f32::from(!now.is_empty() || !others.is_empty()))
            .collect();
        if accompanied.iter().all(|&company| company == 0.0) {
            return Ok(None);
        }
        let (device, shape) = (seen[0].device(), now.shape_of_visible());
        let [count, depths, rows, columns] = shape;
        let constant = |values: Vec<f32>, shape: [usize; 4]| from_host::<4>(values, shape, &device);

        let compared = self.compared(&seen)?;
        let similarity = ops::similarity(compared.clone(), now.clone())?;
        let cosine = similarity
            .clone()
            .reshape([count, SWEEP_GROUPS, depths, rows * columns])
            .sum_dim(1)
            .reshape(shape);
        let visible = constant(now.visible(), shape);
        let unseen = visible.clone().lower_equal_elem(0.0).float();
        let matches = log_softmax(cosine.clone() * SHARPNESS - unseen * UNSEEN_PENALTY, 1);

        let rays = rays::rays(frames, &scale, [rows, columns]);
        let rays = constant(rays, [count, rays::NUMBERS, rows, columns]);
        let [_, image, _] = seen;
        let beside = if others.partners.iter().all(Vec::is_empty) {
            None
        } else {
            let visible = constant(others.visible(), shape);
            let similarity = ops::similarity(compared, others)?;
            Some(self.of_other_times(similarity, visible)?)
        };
        let inputs = Tensor::cat(vec![similarity * SIMILARITY_SCALE, visible, image, rays], 1);
        let hidden = self.decode(inputs, beside)?;
        let logits =
            Conv::load(&self.scope.child("depths"), [depths, DECODER_CHANNELS[0]], 1, 1)?.forward(hidden.clone());
        let likely = log_softmax(logits + cosine * COSINE_WEIGHT, 1);
        let logs = now
            .depths_iu
            .iter()
            .map(|&depth| libm::logf(depth) - libm::logf(UNITS_PER_METRE as f32));
        let logs = constant(logs.collect(), [1, depths, 1, 1]);
        Ok(Some(SweptDepth {
            matches,
            log_depth_m: (likely.clone().exp() * logs).sum_dim(1),
            depths: likely,
            hidden,
            accompanied: constant(accompanied, [count, 1, 1, 1]),
            scale,
        }))
    }

    /// What the comparison with other times adds to the first level of the network that reads similarities; zero at first.
    fn of_other_times(&self, similarity: Tensor<4>, visible: Tensor<4>) -> Result<Tensor<4>> {
        let scope = self.scope.child("others");
        let map = Tensor::cat(vec![similarity * SIMILARITY_SCALE, visible], 1);
        let map = two_layers(&scope, map, OTHER_TIMES_CHANNELS)?;
        Ok(Conv::load(&scope.child("join"), [DECODER_CHANNELS[0], OTHER_TIMES_CHANNELS], 1, 1)?.forward(map))
    }

    /// Features of a level of the stem with what was found; a frame without company keeps its own. `[S, c, h, w]`
    ///
    /// # Errors
    /// As [`Self::find`].
    pub(super) fn join(&self, own: Tensor<4>, found: &SweptDepth) -> Result<Tensor<4>> {
        let certainty = found.depths.clone().exp().powf_scalar(2.0).sum_dim(1);
        let said = Tensor::cat(vec![found.hidden.clone(), found.log_depth_m.clone(), certainty], 1);
        let said = Conv::load(&self.scope.child("join"), [own.dims()[1], OUTPUT_CHANNELS], 3, 1)?.forward(said);
        Ok(own + said * found.accompanied.clone())
    }

    /// What the images show. `[S, 3, H, W] -> 3 x [S, c, h, w]`
    fn encode(&self, images: Tensor<4>) -> Result<[Tensor<4>; 3]> {
        let level = |level: usize, map: Tensor<4>| {
            let scope = self.scope.child(format_args!("levels.{level}"));
            two_layers(&scope, cells(map), ENCODER_CHANNELS[level])
        };
        let first = level(0, images)?;
        let second = level(1, first.clone())?;
        Ok([first, second.clone(), level(2, second)?])
    }

    /// The features that are compared, of length one: coarser levels know more of the surroundings, the first one where
    /// things are. `3 x [S, c, h, w] -> [S, F, rows, columns]`
    fn compared(&self, seen: &[Tensor<4>; 3]) -> Result<Tensor<4>> {
        let map = |level: usize| -> Result<Tensor<4>> {
            let scope = self.scope.child(format_args!("features.{level}"));
            Ok(Conv::load(&scope, [FEATURES, ENCODER_CHANNELS[level]], 3, 1)?.forward(seen[level].clone()))
        };
        let map = map(0)? + resized_like(map(1)? + resized_like(map(2)?, &seen[1]), &seen[0]);
        // Less what all of an image has in common: brightness, and what is the same for every feature.
        let [count, features, rows, columns] = map.dims();
        let means = ops::row_means(map.clone().reshape([count * features, rows * columns]));
        let map = map - means.reshape([count, features, 1, 1]);
        let length = (map.clone().powf_scalar(2.0).sum_dim(1) + EPSILON).sqrt();
        Ok(map / length)
    }

    /// Down to a quarter of the cells' resolution and up again; `beside` is added on the first level.
    /// `[S, c, h, w] -> [S, DECODER_CHANNELS[0], h, w]`
    fn decode(&self, map: Tensor<4>, beside: Option<Tensor<4>>) -> Result<Tensor<4>> {
        let layers = |name: &str, level: usize, map: Tensor<4>| {
            two_layers(
                &self.scope.child(format_args!("{name}.{level}")),
                map,
                DECODER_CHANNELS[level],
            )
        };
        let down = |level: usize, map: &Tensor<4>| {
            let [_, _, rows, columns] = map.dims();
            let half = [rows.div_ceil(2), columns.div_ceil(2)];
            layers("down", level, ops::resize(map.clone(), half))
        };
        let up = |level: usize, map: Tensor<4>, beside: Tensor<4>| {
            layers("up", level, Tensor::cat(vec![resized_like(map, &beside), beside], 1))
        };
        let first = layers("down", 0, map)?;
        let first = match beside {
            Some(beside) => first + beside,
            None => first,
        };
        let second = down(1, &first)?;
        let third = down(2, &second)?;
        up(0, up(1, third, second)?, first)
    }
}

fn resized_like(map: Tensor<4>, like: &Tensor<4>) -> Tensor<4> {
    let [_, _, rows, columns] = like.dims();
    ops::resize(map, [rows, columns])
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::super::frames::Attention;
    use super::plan::tests::frames;
    use super::*;
    use crate::seeded;
    use rogs_tensors::parameters::to_host;

    /// What is said to a stem whose features are zero: noise through seeded layers, the last one not zero.
    fn said(attention: Attention) -> Option<Vec<f32>> {
        let device = Device::flex();
        let config = Stage1Config::compact_sweep();
        let mut network = seeded::network(&config, 3, &device).unwrap();
        let name = "stem.sweep.join.weight";
        let shape = network.parameters.shape(name).unwrap().to_vec();
        let count = shape.iter().product();
        network.parameters.insert(name, &shape, vec![0.01; count]).unwrap();
        let mut frames = frames(attention);
        let shape = frames.images.dims();
        let noise = |k: usize| ((k * 7919 + 13) % 1009) as f32 / 1009.0;
        frames.images = from_host((0..shape.iter().product()).map(noise).collect(), shape, &device);
        let sweeping = Sweeping::new(network.parameters.scope("stem.sweep"), &config);
        let found = sweeping.find(&frames).unwrap()?;
        let [views, _, rows, columns] = found.depths.dims();
        let own = Tensor::zeros([views, config.stem_channels[LEVEL], rows, columns], &device);
        Some(to_host(sweeping.join(own, &found).unwrap()).unwrap())
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
}
