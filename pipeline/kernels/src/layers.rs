//! Layers over rows of tokens, a piece of [`ROWS_PER_PIECE`] rows at a time.

use rayon::prelude::*;

use crate::pointwise::{add_assign, gelu};
use crate::{Norm, PackedWeight, Precision, vectorised};

/// Rows that one piece of work handles.
pub const ROWS_PER_PIECE: usize = 256;

/// A linear layer: `y = W x + b` per row.
#[derive(Debug, Clone)]
pub struct Linear {
    weight: PackedWeight,
    /// `[out]`
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
}

impl Linear {
    /// A layer from PyTorch values: weight `[outputs, inputs]`, bias `[outputs]` or none.
    ///
    /// # Panics
    /// When the values have other sizes.
    #[must_use]
    pub fn new(weight: &[f32], bias: Option<Vec<f32>>, inputs: usize, outputs: usize) -> Self {
        let bias = bias.unwrap_or_else(|| vec![0.0; outputs]);
        assert!(
            weight.len() == inputs * outputs && bias.len() == outputs,
            "a linear layer {inputs} -> {outputs} has other weight sizes"
        );
        Self {
            weight: PackedWeight::new(weight, inputs, Precision::F32),
            bias,
            inputs,
            outputs,
        }
    }

    /// Input width.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// The layer on one piece of rows, on the calling thread. `[n, inputs]` to `[n, outputs]`
    pub fn apply(&self, x: &[f32], out: &mut [f32]) {
        self.weight.rows(
            x,
            out,
            self.outputs,
            #[inline(always)]
            |_, column, values| add_assign(values, &self.bias[column..]),
        );
    }

    /// The same, followed by [`gelu`].
    pub fn apply_gelu(&self, x: &[f32], out: &mut [f32]) {
        self.weight.rows(
            x,
            out,
            self.outputs,
            #[inline(always)]
            |_, column, values| {
                for (value, bias) in values.iter_mut().zip(&self.bias[column..]) {
                    *value = gelu(*value + bias);
                }
            },
        );
    }

    /// The layer on all rows. `[n, inputs]` to `[n, outputs]`
    pub fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; x.len() / self.inputs * self.outputs];
        let pieces = out
            .par_chunks_mut(ROWS_PER_PIECE * self.outputs)
            .zip(x.par_chunks(ROWS_PER_PIECE * self.inputs));
        pieces.for_each(|(out, x)| self.apply(x, out));
        out
    }
}

/// Added to the variance of a row.
const EPSILON: f32 = 1e-5;

/// Layer normalisation over rows, epsilon 1e-5.
#[derive(Debug, Clone)]
pub struct LayerNorm {
    /// Scale.
    pub weight: Vec<f32>,
    /// Shift.
    pub bias: Vec<f32>,
}

impl LayerNorm {
    /// Normalises rows in place, on the calling thread.
    pub fn apply(&self, x: &mut [f32]) {
        let norm = Norm {
            weight: &self.weight,
            bias: &self.bias,
            epsilon: EPSILON,
            centred: true,
        };
        vectorised(
            #[inline(always)]
            || {
                for row in x.chunks_exact_mut(norm.weight.len()) {
                    norm.apply(row);
                }
            },
        );
    }

    /// Normalised copy of all rows.
    pub fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut out = x.to_vec();
        out.par_chunks_mut(ROWS_PER_PIECE * self.weight.len())
            .for_each(|piece| self.apply(piece));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_layer_equals_the_plain_sum() {
        let weight: Vec<f32> = (0..15).map(|i| i as f32 * 0.25 - 1.0).collect();
        let bias = vec![0.5, -0.5, 0.25];
        let layer = Linear::new(&weight, Some(bias.clone()), 5, 3);
        let x: Vec<f32> = (0..600 * 5).map(|i| ((i * 7) % 13) as f32 * 0.125).collect();
        let y = layer.forward(&x);
        for row in 0..600 {
            for out in 0..3 {
                let sum: f32 = (0..5).map(|i| weight[out * 5 + i] * x[row * 5 + i]).sum::<f32>() + bias[out];
                assert_eq!(y[row * 3 + out], sum);
            }
        }
    }
}
