//! The image encoder: patch tokens of each frame on its own (`docs/spec/stage1.md` section 3).

use burn::tensor::Tensor;
use rogs_kernels::Precision;
use rogs_tensors::parameters::Scope;
use rogs_vit::{Block, ImageEncoder};

use super::config::Stage1Config;
use super::frames::normalised;
use crate::Result;

/// The image encoder over a scope of parameters (`backbone.encoder`), of RGB images in [0, 1]. Blocks are read when they
/// run.
pub struct Encoder<'a>(ImageEncoder<'a>);

impl<'a> Encoder<'a> {
    /// The encoder of a scope.
    #[must_use]
    pub fn new(scope: Scope<'a>, config: &'a Stage1Config) -> Self {
        Self(ImageEncoder::new(scope, config.encoder()))
    }

    /// The same with matrix products of other numbers.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        Self(self.0.with_precision(precision))
    }

    /// Normalised patch tokens of RGB images in [0, 1]. `[S, 3, H, W] -> [S, N, C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape, or the images are not whole patches.
    pub fn forward(&self, images: Tensor<4>) -> Result<Tensor<3>> {
        self.0.forward(normalised(images))
    }

    /// Patch projection of the normalised images. `[S, 3, H, W] -> [S, N, C]`
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn patches(&self, images: Tensor<4>) -> Result<Tensor<3>> {
        self.0.patches(normalised(images))
    }

    /// Class token, registers and position embedding around the patches. `[S, N, C] -> [S, 1 + R + N, C]`
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn tokens(&self, patches: Tensor<3>, grid: [usize; 2]) -> Result<Tensor<3>> {
        self.0.tokens(patches, grid)
    }

    /// Block `index`.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn block(&self, index: usize) -> Result<Block> {
        self.0.block(index)
    }
}
