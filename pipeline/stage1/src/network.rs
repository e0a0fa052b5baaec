//! The lifting network as a whole.

use burn::tensor::Tensor;

use super::aggregator::Aggregator;
use super::config::{HeadKind, PREFIX, Stage1Config};
use super::encoded::Encoded;
use super::encoder::Encoder;
use super::frames::SourceFrames;
use super::geometry::NetworkCamera;
use super::head::{DenseHead, FkBranch, TAP_EPSILON};
use super::held::HeldGate;
use super::stem::{Stem, StemFeatures};
use super::sweep::SweptDepth;
use crate::{Error, Result};
use rogs_kernels::Precision;
use rogs_tensors::ops::standardise;
use rogs_tensors::parameters::Parameters;

/// The Stage-1 network: a configuration and the parameters it runs with.
pub struct Stage1 {
    /// Sizes.
    pub config: Stage1Config,
    /// Weights.
    pub parameters: Parameters,
    /// Numbers of the matrix products of encoder and aggregator; f32 unless set.
    pub precision: Precision,
}

impl Stage1 {
    /// A network over parameters, after checking the configuration.
    ///
    /// # Errors
    /// When the configuration is not possible.
    pub fn new(config: Stage1Config, parameters: Parameters) -> Result<Self> {
        config.validate()?;
        Ok(Self {
            config,
            parameters,
            precision: Precision::F32,
        })
    }

    /// The image encoder.
    #[must_use]
    pub fn encoder(&self) -> Encoder<'_> {
        Encoder::new(self.parameters.scope("backbone.encoder"), &self.config).with_precision(self.precision)
    }

    /// The aggregator.
    #[must_use]
    pub fn aggregator(&self) -> Aggregator<'_> {
        Aggregator::new(&self.parameters, &self.config).with_precision(self.precision)
    }

    /// One of the dense heads.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn head(&self, kind: HeadKind) -> Result<DenseHead> {
        DenseHead::load(&self.parameters.scope(PREFIX), kind, &self.config)
    }

    /// The FK-conditioning branch; `None` when the weights have none (the released ones do not).
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn fk_branch(&self) -> Result<Option<FkBranch>> {
        let scope = self.parameters.scope("fk_branch");
        if scope.has("conv1.weight") {
            FkBranch::load(&scope, self.config.fk_hidden).map(Some)
        } else {
            Ok(None)
        }
    }

    /// What says where the gripper holds something; `None` when the weights have nothing that does.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn held_gate(&self) -> Result<Option<HeldGate>> {
        let scope = self.parameters.scope("held");
        scope.has("conv1.weight").then(|| HeldGate::load(&scope)).transpose()
    }

    /// Runs the encoder and the aggregator: everything that does not depend on a query time.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape, or the frames do not fit together.
    pub fn encode(&self, frames: &SourceFrames) -> Result<Encoded> {
        let local = self.local(frames)?;
        let tokens = self.patch_tokens(frames, local.as_ref())?;
        self.encode_with(frames, tokens, local)
    }

    /// The same with patch tokens from elsewhere (the latent adapter). `tokens: [S, N, C]`
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn encode_tokens(&self, frames: &SourceFrames, tokens: Tensor<3>) -> Result<Encoded> {
        self.encode_with(frames, tokens, self.local(frames)?)
    }

    fn encode_with(&self, frames: &SourceFrames, tokens: Tensor<3>, local: Option<StemFeatures>) -> Result<Encoded> {
        let [_, _, height, width] = frames.images.dims();
        let grid = self.config.grid(height, width)?;
        let tokens = self.embed(frames, tokens)?;
        let taps = self.aggregator().forward(tokens, grid, &frames.attention)?;
        self.encoded(taps, local, [height, width])
    }

    /// What the stem says; `None` in a network without one.
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn local(&self, frames: &SourceFrames) -> Result<Option<StemFeatures>> {
        if !self.config.has_stem() {
            return Ok(None);
        }
        self.stem().features(frames).map(Some)
    }

    /// What the sweep of the stem finds; `None` in a network without one, or where no frame has company.
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn sweep(&self, frames: &SourceFrames) -> Result<Option<SweptDepth>> {
        self.stem().sweep(frames)
    }

    /// Patch tokens of the images: those of the encoder, and what the stem adds to them. `[S, N, C]`
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn patch_tokens(&self, frames: &SourceFrames, local: Option<&StemFeatures>) -> Result<Tensor<3>> {
        let [_, _, height, width] = frames.images.dims();
        let tokens = self.encoder().forward(frames.images.clone())?;
        match local {
            Some(local) => Ok(tokens + self.stem().tokens(&local.levels, self.config.grid(height, width)?)?),
            None => Ok(tokens),
        }
    }

    fn stem(&self) -> Stem<'_> {
        Stem::new(self.parameters.scope("stem"), &self.config)
    }

    /// What enters the first pair of the aggregator: patch tokens with rays, time, pose and registers.
    /// `[S, N, C] -> [S, T, C]`
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn embed(&self, frames: &SourceFrames, tokens: Tensor<3>) -> Result<Tensor<3>> {
        let SourceFrames {
            images, cameras, times, ..
        } = frames;
        let [count, _, height, width] = images.dims();
        if cameras.len() != count || times.len() != count {
            let (poses, times) = (cameras.len(), times.len());
            return Err(Error::BadInput(format!(
                "{count} source images come with {poses} cameras and {times} times"
            )));
        }
        cameras.iter().try_for_each(NetworkCamera::validate)?;
        let aggregator = self.aggregator();
        let rays = aggregator.normalise_rays(aggregator.ray_embedding(cameras, [height, width])?)?;
        aggregator.tokens(tokens + rays, cameras, times)
    }

    /// What the heads read of the outputs of the tapped pairs `[S, T, 2C]` and of the stem.
    ///
    /// # Errors
    /// When the image size is not one of whole patches.
    pub fn encoded(
        &self,
        taps: [Tensor<3>; 4],
        local: Option<StemFeatures>,
        [height, width]: [usize; 2],
    ) -> Result<Encoded> {
        let grid = self.config.grid(height, width)?;
        let first = self.config.patch_start();
        Ok(Encoded {
            taps: taps.map(|tap| standardise(tap.narrow(1, first, grid[0] * grid[1]), TAP_EPSILON)),
            local,
            grid,
            size: [height, width],
        })
    }
}
