//! Multi-view attention at low resolution: the only place where views see each other (`docs/spec/stage2.md` A.4).

use rayon::prelude::*;

use super::resnet::checked;
use crate::{Error, Result};
use rogs_kernels::pointwise::add_assign;
use rogs_kernels::{FeatureMap, LayerNorm, Linear, PackedAttention, Precision, ROWS_PER_PIECE, TileSize, Winograd};
use rogs_tensors::parameters::Parameters;

/// Side of the pixel blocks that become one token.
pub const FACTOR: usize = 4;
const CELLS: usize = FACTOR * FACTOR;

/// One multi-view attention block over `channels` channels.
#[derive(Debug, Clone)]
pub struct MultiViewAttention {
    channels: usize,
    heads: usize,
    /// Columns reordered from (channel, dy, dx) to (dy, dx, channel): folding an image into tokens is then copying.
    fold: Linear,
    fold_norm: LayerNorm,
    norm1: LayerNorm,
    qkv: Linear,
    projection: Linear,
    norm2: LayerNorm,
    expand: Linear,
    contract: Linear,
    /// Rows reordered in the same way.
    unfold: Linear,
    unfold_norm: LayerNorm,
    smooth: Winograd,
}

/// Intermediate results, for comparison with other implementations.
#[derive(Debug, Clone)]
pub struct MultiViewTrace {
    /// After folding and its normalisation. `[tokens, channels]`
    pub folded: Vec<f32>,
    /// After the transformer block. `[tokens, channels]`
    pub attended: Vec<f32>,
    /// After unfolding, its normalisation and the convolution, per view. `[height, width, channels]`
    pub smoothed: Vec<FeatureMap>,
}

impl MultiViewAttention {
    /// Reads the block below `prefix` (`encoder.update_error_attn.0`).
    ///
    /// # Errors
    /// When a parameter is missing or has another shape.
    pub fn load(parameters: &Parameters, prefix: &str, channels: usize) -> Result<Self> {
        let get = |name: &str, shape: &[usize]| checked(parameters, &format!("{prefix}.{name}"), shape);
        let norm = |name: &str, width: usize| -> Result<LayerNorm> {
            Ok(LayerNorm {
                weight: get(&format!("{name}.weight"), &[width])?,
                bias: get(&format!("{name}.bias"), &[width])?,
            })
        };
        let linear = |name: &str, outputs: usize, inputs: usize| -> Result<Linear> {
            let bias = Some(get(&format!("{name}.bias"), &[outputs])?);
            Ok(Linear::new(
                &get(&format!("{name}.weight"), &[outputs, inputs])?,
                bias,
                inputs,
                outputs,
            ))
        };
        let folded = CELLS * channels;
        let fold_weight = get("proj1.weight", &[channels, folded])?;
        let fold_weight: Vec<f32> = fold_weight
            .chunks_exact(folded)
            .flat_map(|row| cells_first(row, channels))
            .collect();
        let unfold_weight = get("proj2.weight", &[folded, channels])?;
        let rows: Vec<&[f32]> = unfold_weight.chunks_exact(channels).collect();
        let unfold_weight = cells_first(&rows, channels).concat();
        let unfold_bias = cells_first(&get("proj2.bias", &[folded])?, channels);
        let unfold_norm = norm("norm2", folded)?;
        Ok(Self {
            channels,
            heads: heads(channels)?,
            fold: Linear::new(&fold_weight, Some(get("proj1.bias", &[channels])?), folded, channels),
            fold_norm: norm("norm1", channels)?,
            norm1: norm("attn.norm1", channels)?,
            qkv: Linear::new(
                &get("attn.attn.qkv.weight", &[3 * channels, channels])?,
                None,
                channels,
                3 * channels,
            ),
            projection: linear("attn.attn.proj", channels, channels)?,
            norm2: norm("attn.norm2", channels)?,
            expand: linear("attn.mlp.fc1", 4 * channels, channels)?,
            contract: linear("attn.mlp.fc2", channels, 4 * channels)?,
            unfold: Linear::new(&unfold_weight, Some(unfold_bias), channels, folded),
            unfold_norm: LayerNorm {
                weight: cells_first(&unfold_norm.weight, channels),
                bias: cells_first(&unfold_norm.bias, channels),
            },
            smooth: Winograd::new(
                &get("conv.weight", &[channels, channels, 3, 3])?,
                &get("conv.bias", &[channels])?,
                channels,
                channels,
                TileSize::Two,
            ),
        })
    }

    /// Adds the block's output to the views in place.
    ///
    /// # Errors
    /// When the views differ in size, or their sides are not multiples of four.
    pub fn forward(&self, views: &mut [FeatureMap]) -> Result<()> {
        let (tokens, shape) = self.fold_views(views)?;
        let tokens = self.transform(tokens);
        // One view at a time: the unfolded map is as large as the view.
        let mut unfolded = FeatureMap::zeros(shape.0 * FACTOR, shape.1 * FACTOR, self.channels);
        let low = tokens.chunks_exact(shape.0 * shape.1 * self.channels);
        for (view, tokens) in views.iter_mut().zip(low) {
            self.unfold_view(tokens, shape, &mut unfolded);
            self.smooth
                .add_to(&unfolded.data, [unfolded.height, unfolded.width], &mut view.data);
        }
        Ok(())
    }

    /// The block with its intermediate results; `views` are left as they are.
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn trace(&self, views: &[FeatureMap]) -> Result<MultiViewTrace> {
        let (folded, shape) = self.fold_views(views)?;
        let attended = self.transform(folded.clone());
        let low = attended.chunks_exact(shape.0 * shape.1 * self.channels);
        let smoothed = low
            .map(|tokens| {
                let mut unfolded = FeatureMap::zeros(shape.0 * FACTOR, shape.1 * FACTOR, self.channels);
                self.unfold_view(tokens, shape, &mut unfolded);
                let mut smoothed = FeatureMap::zeros(unfolded.height, unfolded.width, self.channels);
                self.smooth
                    .add_to(&unfolded.data, [unfolded.height, unfolded.width], &mut smoothed.data);
                smoothed
            })
            .collect();
        Ok(MultiViewTrace {
            folded,
            attended,
            smoothed,
        })
    }

    /// Tokens of all views, in the order (view, row, column), projected and normalised; and rows and columns of a view.
    fn fold_views(&self, views: &[FeatureMap]) -> Result<(Vec<f32>, (usize, usize))> {
        let c = self.channels;
        let Some(first) = views.first() else {
            return Err(Error::BadInput("multi-view attention needs at least one view".into()));
        };
        let (height, width) = (first.height, first.width);
        let same = views
            .iter()
            .all(|v| (v.height, v.width, v.channels) == (height, width, c) && v.data.len() == height * width * c);
        if !same || !height.is_multiple_of(FACTOR) || !width.is_multiple_of(FACTOR) || height * width == 0 {
            return Err(Error::BadInput(format!(
                "multi-view attention needs views of one size, sides multiples of {FACTOR}: {height} x {width}"
            )));
        }
        let (rows, columns) = (height / FACTOR, width / FACTOR);
        let mut tokens = vec![0.0; views.len() * rows * columns * c];
        // One row of tokens is a piece.
        tokens
            .par_chunks_mut(columns * c)
            .enumerate()
            .for_each_init(Vec::new, |block, (piece, out)| {
                let (view, row) = (&views[piece / rows], piece % rows);
                block.clear();
                for column in 0..columns {
                    for dy in 0..FACTOR {
                        let start = ((row * FACTOR + dy) * width + column * FACTOR) * c;
                        block.extend_from_slice(&view.data[start..start + FACTOR * c]);
                    }
                }
                self.fold.apply(block, out);
                self.fold_norm.apply(out);
            });
        Ok((tokens, (rows, columns)))
    }

    /// The pre-norm transformer block over all tokens.
    fn transform(&self, mut tokens: Vec<f32>) -> Vec<f32> {
        let c = self.channels;
        let qkv = self.qkv.forward(&self.norm1.forward(&tokens));
        let mixed = PackedAttention {
            packed: &qkv,
            bias: &vec![0.0; 3 * c],
            tokens: tokens.len() / c,
            heads: self.heads,
            size: c / self.heads,
            norms: None,
            rotary: None,
            precision: Precision::F32,
        }
        .run();
        add_assign(&mut tokens, &self.projection.forward(&mixed));
        tokens.par_chunks_mut(ROWS_PER_PIECE * c).for_each(|piece| {
            let mut normalised = piece.to_vec();
            self.norm2.apply(&mut normalised);
            let mut hidden = vec![0.0; 4 * piece.len()];
            self.expand.apply_gelu(&normalised, &mut hidden);
            self.contract.apply(&hidden, &mut normalised);
            add_assign(piece, &normalised);
        });
        tokens
    }

    /// Tokens of one view back to its pixels, all of which are overwritten.
    fn unfold_view(&self, tokens: &[f32], (_, columns): (usize, usize), out: &mut FeatureMap) {
        let c = self.channels;
        let width = columns * FACTOR;
        let pieces = out
            .data
            .par_chunks_mut(FACTOR * width * c)
            .zip(tokens.par_chunks(columns * c));
        pieces.for_each_init(Vec::new, |block, (out, tokens)| {
            block.resize(columns * CELLS * c, 0.0);
            self.unfold.apply(tokens, block);
            self.unfold_norm.apply(block);
            for (column, cell) in block.chunks_exact(CELLS * c).enumerate() {
                for (dy, line) in cell.chunks_exact(FACTOR * c).enumerate() {
                    out[(dy * width + column * FACTOR) * c..][..FACTOR * c].copy_from_slice(line);
                }
            }
        });
    }
}

/// Reorders a row of `channels * 16` items from (channel, dy, dx) to (dy, dx, channel).
fn cells_first<T: Copy>(row: &[T], channels: usize) -> Vec<T> {
    (0..CELLS)
        .flat_map(|cell| (0..channels).map(move |channel| row[channel * CELLS + cell]))
        .collect()
}

/// Heads of a width: 4, or 2 for multiples of 16 that are not multiples of 32; the exceptions 48 and 3 have one.
fn heads(channels: usize) -> Result<usize> {
    match channels {
        48 | 3 => Ok(1),
        _ if channels.is_multiple_of(32) => Ok(4),
        _ if channels.is_multiple_of(16) => Ok(2),
        _ => Err(Error::BadConfiguration(format!(
            "multi-view attention needs a multiple of 16 channels: {channels}"
        ))),
    }
}
