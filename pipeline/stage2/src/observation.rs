//! Observation encoders: what the hidden state starts from (`docs/spec/stage2.md` section B.3).

use burn::tensor::Tensor;

use super::mv_attention::MultiViewAttention;
use super::resnet::checked;
use super::updater::{NeighbourBlock, Neighbours};
use super::{ErrorEncoder, FeatureMaps, nearest_neighbours};
use crate::{Error, Result};
use rogs_kernels::pointwise::gelu_in_place;
use rogs_kernels::{Conv, FeatureMap, Linear};
use rogs_tensors::parameters::{Parameters, from_host, to_host};

/// A frozen network from source images to features per source pixel. Encoders see the images of one source time.
pub trait ObservationEncoder {
    /// Channels of the features.
    fn channels(&self) -> usize;

    /// Features of every image, at image resolution. `[cameras]` of `[height, width, channels]`
    ///
    /// # Errors
    /// When the images do not fit the encoder.
    fn encode(&self, images: &[FeatureMap]) -> Result<Vec<FeatureMap>>;
}

/// The default encoder: the feature maps of the error encoder, which are computed anyway.
impl ObservationEncoder for ErrorEncoder {
    fn channels(&self) -> usize {
        self.features()
    }

    fn encode(&self, images: &[FeatureMap]) -> Result<Vec<FeatureMap>> {
        let full = |image: &FeatureMap| Ok(self.feature_maps(image)?.concatenated(image.height, image.width));
        images.iter().map(full).collect()
    }
}

/// Observation features of some pixels of an image from its cached maps, averaged over each group of pixels (the block
/// of a token), without the full-resolution map. `[groups, channels]`
#[must_use]
pub fn gather_features(maps: &FeatureMaps, height: usize, width: usize, block: usize) -> Vec<f32> {
    let channels = maps.channels();
    let full = maps.concatenated(height, width);
    if block == 1 {
        return full.data;
    }
    let (rows, columns) = (height / block, width / block);
    let mut out = vec![0.0; rows * columns * channels];
    let share = 1.0 / (block * block) as f32;
    for (token, out) in out.chunks_exact_mut(channels).enumerate() {
        for cell in 0..block * block {
            let (row, column) = (
                token / columns * block + cell / block,
                token % columns * block + cell % block,
            );
            let pixel = &full.data[(row * width + column) * channels..][..channels];
            out.iter_mut().zip(pixel).for_each(|(out, value)| *out += share * value);
        }
    }
    out
}

/// The part of ReSplat's initial network behind its depth network (`docs/spec/stage2.md` section A.7), another
/// observation encoder: convolutional regressor, projection, and neighbour attention in alternation with multi-view
/// attention.
pub struct ObservationTrunkTail {
    regressor: [Conv; 2],
    projection: Linear,
    blocks: Vec<(NeighbourBlock, MultiViewAttention)>,
    state: Linear,
    width: usize,
    neighbours: usize,
}

/// Sizes of the trunk's tail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrunkTailConfig {
    /// Channels of the concatenated input.
    pub inputs: usize,
    /// Channels of the input that the projection sees again.
    pub repeated: usize,
    /// Width of the trunk.
    pub width: usize,
    /// Width of queries, keys and values in the neighbour attention.
    pub attention: usize,
    /// Pairs of blocks.
    pub blocks: usize,
    /// Neighbours of a token, itself included.
    pub neighbours: usize,
    /// Width of the hidden state.
    pub state: usize,
}

/// What the trunk's tail computes, step by step.
#[derive(Debug, Clone)]
pub struct TrunkTailOutput {
    /// Output of the regressor per view. `[height, width, channels]`
    pub regressed: Vec<FeatureMap>,
    /// Projected tokens. `[tokens, width]`
    pub projected: Vec<f32>,
    /// Output of the alternating blocks. `[tokens, width]`
    pub attended: Vec<f32>,
    /// The features: projected plus attended. `[tokens, width]`
    pub features: Vec<f32>,
    /// The hidden state projected from them. `[tokens, state]`
    pub state: Vec<f32>,
}

impl ObservationTrunkTail {
    /// Reads `encoder.gaussian_regressor`, `encoder.proj`, `encoder.pt` and `encoder.update_proj`.
    ///
    /// # Errors
    /// When a parameter is missing or has another shape.
    pub fn load(parameters: &Parameters, config: TrunkTailConfig) -> Result<Self> {
        let get = |name: &str, shape: &[usize]| checked(parameters, &format!("encoder.{name}"), shape);
        let TrunkTailConfig {
            inputs, width, state, ..
        } = config;
        let conv = |index: usize, inputs: usize| -> Result<Conv> {
            let weight = get(&format!("gaussian_regressor.{index}.weight"), &[width, inputs, 3, 3])?;
            Ok(Conv::new(
                &weight,
                Some(get(&format!("gaussian_regressor.{index}.bias"), &[width])?),
                inputs,
                width,
                3,
                1,
            ))
        };
        let joined = width + config.repeated;
        let projection = get("proj.weight", &[width, joined])?;
        let update = get("update_proj.weight", &[state, width, 1, 1])?;
        let block = |index: usize| -> Result<(NeighbourBlock, MultiViewAttention)> {
            let near = NeighbourBlock::load(
                &parameters.scope(&format!("encoder.pt.blocks.{index}")),
                width,
                config.attention,
            )?;
            Ok((
                near,
                MultiViewAttention::load(parameters, &format!("encoder.pt.mv_blocks.{index}"), width)?,
            ))
        };
        Ok(Self {
            regressor: [conv(0, inputs)?, conv(2, width)?],
            projection: Linear::new(&projection, Some(get("proj.bias", &[width])?), joined, width),
            blocks: (0..config.blocks).map(block).collect::<Result<_>>()?,
            state: Linear::new(&update, Some(get("update_proj.bias", &[state])?), width, state),
            width,
            neighbours: config.neighbours,
        })
    }

    /// Runs the tail. `joined` are the views' concatenated inputs, of which the projection sees the first channels
    /// again; `points` are the unprojected positions of the tokens (view, row, column), internal units.
    ///
    /// # Errors
    /// When views and points disagree, or a device fails.
    pub fn forward(
        &self,
        joined: &[FeatureMap],
        points: &[[f32; 3]],
        parameters: &Parameters,
    ) -> Result<TrunkTailOutput> {
        let regress = |view: &FeatureMap| {
            let mut inner = self.regressor[0].forward(view);
            gelu_in_place(&mut inner.data);
            self.regressor[1].forward(&inner)
        };
        let regressed: Vec<FeatureMap> = joined.iter().map(regress).collect();
        let Some((height, width)) = joined.first().map(|view| (view.height, view.width)) else {
            return Err(Error::BadInput(
                "the observation encoder needs at least one view".into(),
            ));
        };
        let repeated = self.projection_inputs() - self.width;
        let rows = |view: usize| {
            let pixels = regressed[view].data.chunks_exact(self.width);
            pixels
                .zip(joined[view].data.chunks_exact(joined[view].channels))
                .flat_map(move |(a, b)| a.iter().chain(&b[..repeated]))
        };
        let input: Vec<f32> = (0..joined.len()).flat_map(rows).copied().collect();
        let projected = self.projection.forward(&input);
        let tokens = projected.len() / self.width;
        if points.len() != tokens {
            return Err(Error::BadInput(format!(
                "the observation encoder got {} points for {tokens} tokens",
                points.len()
            )));
        }
        let count = self.neighbours.min(tokens);
        let neighbours = Neighbours::new(&nearest_neighbours(points, count), count, parameters.device());
        let mut attended = projected.clone();
        for (near, across) in &self.blocks {
            let tensor: Tensor<2> = from_host(attended, [tokens, self.width], parameters.device());
            let near = to_host(near.forward(tensor, &neighbours))?;
            let as_view = |data: &[f32]| FeatureMap {
                height,
                width,
                channels: self.width,
                data: data.to_vec(),
            };
            let mut views: Vec<FeatureMap> = near.chunks_exact(height * width * self.width).map(as_view).collect();
            across.forward(&mut views)?;
            attended = views.into_iter().flat_map(|view| view.data).collect();
        }
        let features: Vec<f32> = projected.iter().zip(&attended).map(|(a, b)| a + b).collect();
        let state = self.state.forward(&features);
        Ok(TrunkTailOutput {
            regressed,
            projected,
            attended,
            features,
            state,
        })
    }

    fn projection_inputs(&self) -> usize {
        self.projection.inputs()
    }
}
