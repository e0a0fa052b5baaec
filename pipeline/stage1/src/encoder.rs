//! The image encoder: patch tokens of each frame on its own (`docs/spec/stage1.md` section 3).

use burn::tensor::Tensor;

use super::block::{Block, BlockKind};
use super::config::Stage1Config;
use super::frames::normalised;
use super::positions::resampling_matrix;
use crate::Result;
use rogs_kernels::Precision;
use rogs_tensors::ops::{self, LayerNorm};
use rogs_tensors::parameters::{Scope, from_host};

/// The image encoder over a scope of parameters (`backbone.encoder`). Blocks are read when they run.
pub struct Encoder<'a> {
    scope: Scope<'a>,
    config: &'a Stage1Config,
    precision: Precision,
}

impl<'a> Encoder<'a> {
    /// The encoder of a scope.
    #[must_use]
    pub fn new(scope: Scope<'a>, config: &'a Stage1Config) -> Self {
        Self {
            scope,
            config,
            precision: Precision::F32,
        }
    }

    /// The same with matrix products of other numbers.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    /// Normalised patch tokens of RGB images in [0, 1]. `[S, 3, H, W] -> [S, N, C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape, or the images are not whole patches.
    pub fn forward(&self, images: Tensor<4>) -> Result<Tensor<3>> {
        let [frames, _, height, width] = images.dims();
        let grid = self.config.grid(height, width)?;
        let mut tokens = self.tokens(self.patches(images)?, grid)?;
        for index in 0..self.config.encoder_blocks {
            tokens = self.block(index)?.forward(tokens, None);
        }
        let norm = LayerNorm::load(&self.scope.child("norm"), self.config.width, BlockKind::ENCODER.epsilon)?;
        let patches = norm
            .forward(tokens)
            .narrow(1, 1 + self.config.registers, grid[0] * grid[1]);
        debug_assert_eq!(patches.dims()[0], frames);
        Ok(patches)
    }

    /// Patch projection of the normalised images. `[S, 3, H, W] -> [S, N, C]`
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn patches(&self, images: Tensor<4>) -> Result<Tensor<3>> {
        let normalised = normalised(images);
        let (width, patch) = (self.config.width, self.config.patch);
        let projection = self.scope.child("patch_embed.proj");
        let weight = projection.get("weight", [width, 3, patch, patch])?;
        Ok(patch_projection(normalised, weight, projection.get("bias", [width])?))
    }

    /// Class token, registers and position embedding around the patches. `[S, N, C] -> [S, 1 + R + N, C]`
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn tokens(&self, patches: Tensor<3>, grid: [usize; 2]) -> Result<Tensor<3>> {
        let [frames, _, width] = patches.dims();
        let side = self.config.position_grid;
        let table = self
            .scope
            .get("pos_embed", [1, 1 + side * side, width])?
            .squeeze_dim::<2>(0);
        let class_position = table.clone().narrow(0, 0, 1);
        let mut grid_positions = table.narrow(0, 1, side * side);
        if grid != [side, side] {
            let matrix = from_host(
                resampling_matrix(side, grid),
                [grid[0] * grid[1], side * side],
                self.scope.device(),
            );
            grid_positions = ops::product(matrix, grid_positions);
        }
        let class = self.scope.get("cls_token", [1, 1, width])? + class_position.unsqueeze();
        let registers = self.scope.get("register_tokens", [1, self.config.registers, width])?;
        let patches = patches + grid_positions.unsqueeze();
        let special = Tensor::cat(vec![class, registers], 1).repeat(&[frames, 1, 1]);
        Ok(Tensor::cat(vec![special, patches], 1))
    }

    /// Block `index`.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn block(&self, index: usize) -> Result<Block> {
        let scope = self.scope.child(format_args!("blocks.{index}"));
        let kind = BlockKind::ENCODER.with(self.precision);
        Block::load(&scope, kind, self.config.width, self.config.heads)
    }
}

/// A convolution whose stride is its kernel size, as one matrix product. `[S, c, H, W] -> [S, N, C]`
#[must_use]
pub fn patch_projection(images: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<3> {
    let [frames, channels, height, width] = images.dims();
    let [outputs, _, patch, _] = weight.dims();
    let (rows, columns) = (height / patch, width / patch);
    let cells = images
        .reshape([frames, channels, rows, patch, columns, patch])
        .permute([0, 2, 4, 1, 3, 5]);
    let cells = cells.reshape([frames, rows * columns, channels * patch * patch]);
    ops::linear(
        cells,
        weight.reshape([outputs, channels * patch * patch]),
        Some(bias),
        Precision::F32,
    )
}
