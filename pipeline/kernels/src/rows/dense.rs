//! Dense layers over rows of tokens.

use rayon::prelude::*;

use super::ROWS_PER_PIECE;
use crate::ShapeError;
use crate::{PackedWeight, Precision, vectorised};

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
    /// A layer from values in PyTorch layout.
    pub fn new(weight: Vec<f32>, bias: Option<Vec<f32>>, inputs: usize, outputs: usize) -> Result<Self, ShapeError> {
        let bias = bias.unwrap_or_else(|| vec![0.0; outputs]);
        if weight.len() != inputs * outputs || bias.len() != outputs {
            return Err(ShapeError(format!(
                "a linear layer {inputs} -> {outputs} has other weight sizes"
            )));
        }
        Ok(Self {
            weight: PackedWeight::new(&weight, inputs, Precision::F32),
            bias,
            inputs,
            outputs,
        })
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

    /// The same, followed by [`gelu_in_place`].
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
        let width = self.weight.len();
        for row in x.chunks_exact_mut(width) {
            vectorised(
                #[inline(always)]
                || {
                    let mean = sum_of(row, |value| value) / width as f32;
                    let variance = sum_of(row, |value| (value - mean) * (value - mean)) / width as f32;
                    let inverse = 1.0 / (variance + 1e-5).sqrt();
                    for ((value, weight), bias) in row.iter_mut().zip(&self.weight).zip(&self.bias) {
                        *value = (*value - mean) * inverse * weight + bias;
                    }
                },
            );
        }
    }

    /// Normalised copy of all rows.
    pub fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut out = x.to_vec();
        out.par_chunks_mut(ROWS_PER_PIECE * self.weight.len())
            .for_each(|piece| self.apply(piece));
        out
    }
}

/// Sum over a row in sixteen interleaved lanes, which vectorises and always adds in the same order.
#[inline(always)]
fn sum_of(row: &[f32], term: impl Fn(f32) -> f32) -> f32 {
    let mut lanes = [0.0f32; 16];
    let mut chunks = row.chunks_exact(16);
    for chunk in &mut chunks {
        for (lane, &value) in lanes.iter_mut().zip(chunk) {
            *lane += term(value);
        }
    }
    let tail: f32 = chunks.remainder().iter().map(|&value| term(value)).sum();
    lanes.iter().sum::<f32>() + tail
}

/// Adds `y` to `x` element by element.
#[inline(always)]
pub fn add_assign(x: &mut [f32], y: &[f32]) {
    for (x, y) in x.iter_mut().zip(y) {
        *x += y;
    }
}

/// `max(x, 0)` in place.
pub fn relu_in_place(x: &mut [f32]) {
    for value in x {
        *value = value.max(0.0);
    }
}

/// The exact (erf) GELU in place, on the calling thread.
pub fn gelu_in_place(x: &mut [f32]) {
    vectorised(
        #[inline(always)]
        || {
            for value in x.iter_mut() {
                *value = gelu(*value);
            }
        },
    );
}

/// `x Phi(x)` with the error function of Abramowitz and Stegun 7.1.26 (absolute error below 1.5e-7).
#[inline(always)]
fn gelu(x: f32) -> f32 {
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let polynomial =
        ((((1.061_405_429 * t - 1.453_152_027) * t + 1.421_413_741) * t - 0.284_496_736) * t + 0.254_829_592) * t;
    let half_tail = 0.5 * polynomial * exp(-z * z);
    x * if x < 0.0 { half_tail } else { 1.0 - half_tail }
}

/// `e^x` to about one unit in the last place; inputs are clamped to the range of finite, normal results.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    // Adding 1.5 * 2^23 rounds to an integer and leaves it in the low mantissa bits.
    const ROUND: f32 = 12_582_912.0;
    let x = x.clamp(-87.0, 88.0);
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * 0.693_359_4) - n * -2.121_944_4e-4;
    let tail = ((((1.987_569_1e-4 * r + 1.398_199_9e-3) * r + 8.333_452e-3) * r + 4.166_579_6e-2) * r + 1.666_666_5e-1)
        * r
        + 5.000_000_1e-1;
    let scale = f32::from_bits((shifted.to_bits() << 23).wrapping_add(127 << 23));
    (tail * r * r + r + 1.0) * scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_and_gelu_follow_the_double_precision_functions() {
        for step in -8_600..8_700 {
            let x = step as f32 * 0.01;
            let exact = libm::exp(f64::from(x));
            assert!((f64::from(exp(x)) - exact).abs() <= 2e-7 * exact, "exp({x})");
            let exact = f64::from(x) * 0.5 * (1.0 + libm::erf(f64::from(x) * std::f64::consts::FRAC_1_SQRT_2));
            assert!(
                (f64::from(gelu(x)) - exact).abs() <= 5e-7 * f64::from(x).abs().max(1.0),
                "gelu({x})"
            );
        }
    }

    #[test]
    fn linear_layer_equals_the_plain_sum() {
        let weight: Vec<f32> = (0..15).map(|i| i as f32 * 0.25 - 1.0).collect();
        let bias = vec![0.5, -0.5, 0.25];
        let layer = Linear::new(weight.clone(), Some(bias.clone()), 5, 3).unwrap();
        let x: Vec<f32> = (0..600 * 5).map(|i| ((i * 7) % 13) as f32 * 0.125).collect();
        let y = layer.forward(&x);
        for row in 0..600 {
            for out in 0..3 {
                let sum: f32 = (0..5).map(|i| weight[out * 5 + i] * x[row * 5 + i]).sum::<f32>() + bias[out];
                assert_eq!(y[row * 3 + out], sum);
            }
        }
        assert!(Linear::new(vec![0.0; 4], None, 5, 3).is_err());
    }
}
