//! The image encoder DINOv2: patch tokens of each frame on its own (`docs/spec/stage1.md` section 3).

use burn::tensor::Tensor;
use rogs_kernels::Precision;
use rogs_tensors::ops::{self, LayerNorm};
use rogs_tensors::parameters::{Scope, from_host};
use serde::{Deserialize, Serialize};

use crate::block::{Block, BlockKind};
use crate::patches::patch_projection;
use crate::positions::{PositionGrid, resampling_matrix};
use crate::{Error, Result};

/// No size of an image encoder is larger.
const LARGEST: usize = 1 << 16;

/// Sizes of an image encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderSizes {
    /// Token width C.
    pub width: usize,
    /// Attention heads.
    pub heads: usize,
    /// Patch side, pixels.
    pub patch: usize,
    /// Blocks.
    pub blocks: usize,
    /// Side of the square grid of learned positions.
    pub position_grid: usize,
    /// Register tokens; may be none.
    pub registers: usize,
    /// How the grid of learned positions becomes that of an image.
    pub positions: PositionGrid,
}

impl EncoderSizes {
    /// ViT-B/14 (`dinov2_vitb14`): 768 channels, 12 blocks of 12 heads; with `registers`, which the file of weights tells,
    /// `dinov2_vitb14_reg`.
    #[must_use]
    pub fn vit_b(registers: usize) -> Self {
        let positions = match registers {
            0 => PositionGrid::Offset,
            _ => PositionGrid::Antialiased,
        };
        Self {
            width: 768,
            heads: 12,
            patch: 14,
            blocks: 12,
            position_grid: 37,
            registers,
            positions,
        }
    }

    /// Checks that the sizes fit together, as those that a file says.
    ///
    /// # Errors
    /// When they do not.
    pub fn validate(&self) -> Result<()> {
        let sizes = [self.width, self.heads, self.patch, self.blocks, self.position_grid];
        let possible = |size: &usize| (1..=LARGEST).contains(size);
        if !sizes.iter().all(possible) || self.registers > LARGEST || !self.width.is_multiple_of(self.heads) {
            return Err(Error::BadConfiguration(format!(
                "an image encoder needs sizes from 1 to {LARGEST} and a width that its heads divide, not {self:?}"
            )));
        }
        Ok(())
    }

    /// Patches of an image, rows and columns.
    ///
    /// # Errors
    /// When the sides are not multiples of the patch side.
    pub fn grid(&self, height: usize, width: usize) -> Result<[usize; 2]> {
        let patch = self.patch;
        if height == 0 || width == 0 || !height.is_multiple_of(patch) || !width.is_multiple_of(patch) {
            return Err(Error::BadInput(format!(
                "images of {height}x{width} pixels are not a whole number of {patch}-pixel patches"
            )));
        }
        Ok([height / patch, width / patch])
    }
}

/// The image encoder over a scope of parameters. Blocks are read when they run.
pub struct ImageEncoder<'a> {
    scope: Scope<'a>,
    sizes: EncoderSizes,
    precision: Precision,
}

impl<'a> ImageEncoder<'a> {
    /// The encoder of a scope.
    #[must_use]
    pub fn new(scope: Scope<'a>, sizes: EncoderSizes) -> Self {
        Self {
            scope,
            sizes,
            precision: Precision::F32,
        }
    }

    /// The same with matrix products of other numbers.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    /// Patch tokens after the last norm, of images as the network wants them. `[S, 3, H, W] -> [S, N, C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape, or the images are not whole patches.
    pub fn forward(&self, images: Tensor<4>) -> Result<Tensor<3>> {
        let norm = LayerNorm::load(&self.scope.child("norm"), self.sizes.width, BlockKind::ENCODER.epsilon)?;
        let [_, _, height, width] = images.dims();
        Ok(self.patches_of(norm.forward(self.all_tokens(images)?), self.sizes.grid(height, width)?))
    }

    /// Patch tokens before the last norm. `[S, 3, H, W] -> [S, N, C]`
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn before_norm(&self, images: Tensor<4>) -> Result<Tensor<3>> {
        let [_, _, height, width] = images.dims();
        Ok(self.patches_of(self.all_tokens(images)?, self.sizes.grid(height, width)?))
    }

    /// What the last block makes of all tokens. `[S, 3, H, W] -> [S, 1 + R + N, C]`
    fn all_tokens(&self, images: Tensor<4>) -> Result<Tensor<3>> {
        let [_, _, height, width] = images.dims();
        let grid = self.sizes.grid(height, width)?;
        let mut tokens = self.tokens(self.patches(images)?, grid)?;
        for index in 0..self.sizes.blocks {
            tokens = self.block(index)?.forward(tokens, None);
        }
        Ok(tokens)
    }

    fn patches_of(&self, tokens: Tensor<3>, [rows, columns]: [usize; 2]) -> Tensor<3> {
        tokens.narrow(1, 1 + self.sizes.registers, rows * columns)
    }

    /// Patch projection of the images. `[S, 3, H, W] -> [S, N, C]`
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn patches(&self, images: Tensor<4>) -> Result<Tensor<3>> {
        let EncoderSizes { width, patch, .. } = self.sizes;
        let projection = self.scope.child("patch_embed.proj");
        let weight = projection.get("weight", [width, 3, patch, patch])?;
        Ok(patch_projection(images, weight, projection.get("bias", [width])?))
    }

    /// Class token, registers and position embedding around the patches. `[S, N, C] -> [S, 1 + R + N, C]`
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn tokens(&self, patches: Tensor<3>, grid: [usize; 2]) -> Result<Tensor<3>> {
        let [frames, _, width] = patches.dims();
        let side = self.sizes.position_grid;
        let table = self
            .scope
            .get("pos_embed", [1, 1 + side * side, width])?
            .squeeze_dim::<2>(0);
        let class_position = table.clone().narrow(0, 0, 1);
        let mut grid_positions = table.narrow(0, 1, side * side);
        if grid != [side, side] {
            let matrix = from_host(
                resampling_matrix(side, grid, self.sizes.positions),
                [grid[0] * grid[1], side * side],
                self.scope.device(),
            );
            grid_positions = ops::product(matrix, grid_positions);
        }
        let mut special = self.scope.get("cls_token", [1, 1, width])? + class_position.unsqueeze();
        if self.sizes.registers > 0 {
            let registers = self.scope.get("register_tokens", [1, self.sizes.registers, width])?;
            special = Tensor::cat(vec![special, registers], 1);
        }
        let patches = patches + grid_positions.unsqueeze();
        Ok(Tensor::cat(vec![special.repeat(&[frames, 1, 1]), patches], 1))
    }

    /// Block `index`.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn block(&self, index: usize) -> Result<Block> {
        let scope = self.scope.child(format_args!("blocks.{index}"));
        let kind = BlockKind::ENCODER.with(self.precision);
        Block::load(&scope, kind, self.sizes.width, self.sizes.heads)
    }
}
