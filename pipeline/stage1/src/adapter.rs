//! The optional latent-token adapter: patch tokens from the latents of a video tokenizer instead of RGB
//! (`docs/spec/stage1.md` section 13, `docs/spec/latents.md`).

use burn::tensor::Tensor;

use crate::{Error, Result};
use rogs_kernels::RotaryTable;
use rogs_tensors::ops::{LayerNorm, Rotary};
use rogs_tensors::parameters::Scope;
use rogs_vit::{Block, BlockKind, patch_projection};

/// Channels of a latent.
pub const LATENT_CHANNELS: usize = 48;
/// Side of the patches that the adapter makes tokens of.
pub const PATCH: usize = 2;

/// The adapter over a scope of parameters (`adapter`).
pub struct LatentAdapter<'a> {
    scope: Scope<'a>,
    width: usize,
    heads: usize,
    blocks: usize,
}

impl<'a> LatentAdapter<'a> {
    /// The adapter of a scope; the number of blocks is as many as the scope has.
    #[must_use]
    pub fn new(scope: Scope<'a>, width: usize, heads: usize) -> Self {
        let blocks = (0..)
            .take_while(|index| scope.has(&format!("blocks.{index}.norm1.weight")))
            .count();
        Self {
            scope,
            width,
            heads,
            blocks,
        }
    }

    /// Number of blocks.
    #[must_use]
    pub fn blocks(&self) -> usize {
        self.blocks
    }

    /// Tokens in place of the image encoder's, from latents already on the grid of 2 x 2 cells per token.
    /// `[S, 48, 2h, 2w] -> [S, h * w, C]`
    ///
    /// # Errors
    /// When a tensor is missing or the latents are not whole patches.
    pub fn forward(&self, latents: Tensor<4>) -> Result<Tensor<3>> {
        let mut tokens = self.patches(latents.clone())?;
        let [_, _, height, width] = latents.dims();
        let positions: Vec<[usize; 2]> = (0..height / PATCH * (width / PATCH))
            .map(|token| [token / (width / PATCH), token % (width / PATCH)])
            .collect();
        let rotary = Rotary::new(
            RotaryTable::new(&positions, self.width / self.heads),
            self.scope.device(),
        );
        for index in 0..self.blocks {
            tokens = self.block(index)?.forward(tokens, Some(&rotary));
        }
        Ok(LayerNorm::load(&self.scope.child("ln"), self.width, BlockKind::ADAPTER.epsilon)?.forward(tokens))
    }

    /// Patch projection. `[S, 48, 2h, 2w] -> [S, h * w, C]`
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn patches(&self, latents: Tensor<4>) -> Result<Tensor<3>> {
        let [_, channels, height, width] = latents.dims();
        if channels != LATENT_CHANNELS || height % PATCH != 0 || width % PATCH != 0 {
            return Err(Error::BadInput(format!(
                "latents of {channels} channels at {height}x{width} do not make whole tokens"
            )));
        }
        let projection = self.scope.child("patch_embed.proj");
        let weight = projection.get("weight", [self.width, LATENT_CHANNELS, PATCH, PATCH])?;
        Ok(patch_projection(latents, weight, projection.get("bias", [self.width])?))
    }

    /// Block `index`.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn block(&self, index: usize) -> Result<Block> {
        Block::load(
            &self.scope.child(format_args!("blocks.{index}")),
            BlockKind::ADAPTER,
            self.width,
            self.heads,
        )
    }
}

/// Brings one camera region's latents to the grid of 2 x 2 cells per token: unchanged, each value repeated 2 x 2, or the mean
/// of 2 x 2 (`docs/spec/latents.md` section 4). `[S, 48, h, w] -> [S, 48, 2 rows, 2 columns]`
///
/// # Errors
/// When the region has another size.
pub fn to_token_cells(latents: Tensor<4>, [rows, columns]: [usize; 2]) -> Result<Tensor<4>> {
    let [frames, channels, height, width] = latents.dims();
    let target = [PATCH * rows, PATCH * columns];
    if [height, width] == target {
        Ok(latents)
    } else if [height, width] == [rows, columns] {
        let cells = latents
            .reshape([frames, channels, rows, 1, columns, 1])
            .repeat(&[1, 1, 1, PATCH, 1, PATCH]);
        Ok(cells.reshape([frames, channels, target[0], target[1]]))
    } else if [height, width] == target.map(|size| 2 * size) {
        let cells = latents.reshape([frames, channels, target[0], 2, target[1], 2]);
        Ok(cells
            .mean_dim(5)
            .mean_dim(3)
            .reshape([frames, channels, target[0], target[1]]))
    } else {
        Err(Error::BadInput(format!(
            "a camera region of {height}x{width} latents does not fit {rows}x{columns} tokens (one, four or sixteen latents per token)"
        )))
    }
}
