//! Softmax self-attention over one set of tokens.

use rayon::prelude::*;

use super::dense::{MatrixRef, exp, matrix_product};
use crate::kernels::vectorised;

/// Query rows that one piece of work handles.
const QUERIES: usize = 128;
/// Keys that are looked at together: their scores stay in the second-level cache.
const KEYS: usize = 512;
/// Numbers that are worked on together.
const LANES: usize = 16;

/// Multi-head self-attention. `qkv` is `[n, 3 * channels]`, ordered query, key, value, each head-major; the result is
/// `[n, channels]`. Logits are scaled by `(channels / heads)^-1/2`.
///
/// Keys come in blocks: each block's weights are taken relative to the largest logit so far, and what was summed before is
/// rescaled when that grows.
pub(crate) fn self_attention(qkv: &[f32], channels: usize, heads: usize) -> Vec<f32> {
    let tokens = qkv.len() / (3 * channels);
    let width = channels / heads;
    let scale = 1.0 / (width as f32).sqrt();
    let keys = transposed_keys(qkv, channels);
    let mut out = vec![0.0; tokens * channels];
    // One piece is a run of queries of all heads, so that pieces own disjoint rows of the output.
    out.par_chunks_mut(QUERIES * channels).enumerate().for_each_init(
        || (vec![0.0; QUERIES * KEYS], vec![0.0; QUERIES * width]),
        |(scores, mixed), (piece, out)| {
            let rows = out.len() / channels;
            let mixed = &mut mixed[..rows * width];
            for head in 0..heads {
                let view = |part: usize, first: usize, rows: usize| MatrixRef {
                    data: &qkv[first * 3 * channels + part * channels + head * width..],
                    rows,
                    columns: width,
                    row_stride: 3 * channels,
                    column_stride: 1,
                };
                let mut running = [Running::default(); QUERIES];
                mixed.fill(0.0);
                for first in (0..tokens).step_by(KEYS) {
                    let count = KEYS.min(tokens - first);
                    let scores = &mut scores[..rows * count];
                    let keys = MatrixRef {
                        data: &keys[head * width * tokens + first..],
                        rows: width,
                        columns: count,
                        row_stride: tokens,
                        column_stride: 1,
                    };
                    matrix_product(view(0, piece * QUERIES, rows), keys, scores, false);
                    vectorised(
                        #[inline(always)]
                        || {
                            let rows = scores.chunks_exact_mut(count).zip(mixed.chunks_exact_mut(width));
                            for ((scores, mixed), running) in rows.zip(&mut running) {
                                running.take(scores, mixed, scale);
                            }
                        },
                    );
                    matrix_product(MatrixRef::rows(scores, rows, count), view(2, first, count), mixed, true);
                }
                let rows = out.chunks_exact_mut(channels).zip(mixed.chunks_exact(width));
                for ((out, mixed), running) in rows.zip(&running) {
                    for (out, mixed) in out[head * width..(head + 1) * width].iter_mut().zip(mixed) {
                        *out = mixed / running.sum;
                    }
                }
            }
        },
    );
    out
}

/// The keys with channels as rows, which is how the product takes them in fastest. `[channels, n]`
fn transposed_keys(qkv: &[f32], channels: usize) -> Vec<f32> {
    let tokens = qkv.len() / (3 * channels);
    let mut keys = vec![0.0; channels * tokens];
    keys.par_chunks_mut(LANES * tokens)
        .enumerate()
        .for_each(|(piece, keys)| {
            for (token, row) in qkv.chunks_exact(3 * channels).enumerate() {
                let row = &row[channels + piece * LANES..][..keys.len() / tokens];
                for (channel, &value) in row.iter().enumerate() {
                    keys[channel * tokens + token] = value;
                }
            }
        });
    keys
}

/// Largest logit of a query so far, and the sum of its weights relative to that.
#[derive(Clone, Copy)]
struct Running {
    largest: f32,
    sum: f32,
}

impl Default for Running {
    fn default() -> Self {
        Self {
            largest: f32::NEG_INFINITY,
            sum: 0.0,
        }
    }
}

impl Running {
    /// Turns the scores of a block of keys into weights, and rescales the sums before it.
    #[inline(always)]
    fn take(&mut self, scores: &mut [f32], mixed: &mut [f32], scale: f32) {
        let mut best = [f32::NEG_INFINITY; LANES];
        let (lanes, rest) = scores.as_chunks::<LANES>();
        for chunk in lanes {
            for (best, &value) in best.iter_mut().zip(chunk) {
                *best = if value > *best { value } else { *best };
            }
        }
        let best = best.iter().chain(rest).fold(f32::NEG_INFINITY, |a, &b| a.max(b));
        let largest = self.largest.max(best * scale);
        let mut sums = [0.0f32; LANES];
        let (lanes, rest) = scores.as_chunks_mut::<LANES>();
        for chunk in lanes {
            for (sum, value) in sums.iter_mut().zip(chunk) {
                *value = exp(*value * scale - largest);
                *sum += *value;
            }
        }
        let mut sum = 0.0;
        for value in rest {
            *value = exp(*value * scale - largest);
            sum += *value;
        }
        let shrink = exp(self.largest - largest);
        self.sum = self.sum * shrink + sums.iter().sum::<f32>() + sum;
        self.largest = largest;
        if shrink != 1.0 {
            mixed.iter_mut().for_each(|value| *value *= shrink);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attention_equals_the_plain_formula() {
        let (tokens, channels, heads) = (1150, 12, 3);
        let qkv: Vec<f32> = (0..tokens * 3 * channels)
            .map(|i| ((i * 37) % 101) as f32 / 40.0 - 1.25)
            .collect();
        let out = self_attention(&qkv, channels, heads);
        let at = |token: usize, part: usize, channel: usize| {
            f64::from(qkv[token * 3 * channels + part * channels + channel])
        };
        for token in [0, 127, 128, 1149] {
            for head in 0..heads {
                let range = head * 4..(head + 1) * 4;
                let logit = |other: usize| range.clone().map(|c| at(token, 0, c) * at(other, 1, c)).sum::<f64>() / 2.0;
                let total: f64 = (0..tokens).map(|other| logit(other).exp()).sum();
                for channel in range.clone() {
                    let value: f64 = (0..tokens)
                        .map(|other| logit(other).exp() * at(other, 2, channel))
                        .sum::<f64>()
                        / total;
                    assert!((f64::from(out[token * channels + channel]) - value).abs() < 1e-6);
                }
            }
        }
    }
}
