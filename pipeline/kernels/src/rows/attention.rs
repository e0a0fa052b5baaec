//! Softmax self-attention over one set of tokens.

use rayon::prelude::*;

use super::dense::{add_assign, exp};
use crate::{PackedWeight, Precision, vectorised};

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
pub fn self_attention(qkv: &[f32], channels: usize, heads: usize) -> Vec<f32> {
    let tokens = qkv.len() / (3 * channels);
    let width = channels / heads;
    let scale = 1.0 / (width as f32).sqrt();
    let blocks: Vec<KeyBlock> = (0..heads * tokens.div_ceil(KEYS))
        .into_par_iter()
        .map(|block| KeyBlock::new(qkv, channels, width, block % heads, block / heads * KEYS))
        .collect();
    let mut out = vec![0.0; tokens * channels];
    // One piece is a run of queries of all heads, so that pieces own disjoint rows of the output.
    out.par_chunks_mut(QUERIES * channels).enumerate().for_each_init(
        || [const { Vec::new() }; 4],
        |[queries, scores, mixed, added], (piece, out)| {
            let rows = out.len() / channels;
            for head in 0..heads {
                queries.clear();
                for row in qkv[piece * QUERIES * 3 * channels..]
                    .chunks_exact(3 * channels)
                    .take(rows)
                {
                    queries.extend_from_slice(&row[head * width..(head + 1) * width]);
                }
                let mut running = [Running::default(); QUERIES];
                mixed.clear();
                mixed.resize(rows * width, 0.0);
                added.resize(rows * width, 0.0);
                for block in blocks.iter().skip(head).step_by(heads) {
                    let count = block.keys.outputs();
                    scores.resize(rows * count, 0.0);
                    block.keys.rows(queries, scores, count, |_, _, _| {});
                    vectorised(
                        #[inline(always)]
                        || {
                            let rows = scores.chunks_exact_mut(count).zip(mixed.chunks_exact_mut(width));
                            for ((scores, mixed), running) in rows.zip(&mut running) {
                                running.take(scores, mixed, scale);
                            }
                        },
                    );
                    block.values.rows(scores, added, width, |_, _, _| {});
                    add_assign(mixed, added);
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

/// Some keys of one head and their values, packed for products.
struct KeyBlock {
    keys: PackedWeight,
    values: PackedWeight,
}

impl KeyBlock {
    fn new(qkv: &[f32], channels: usize, width: usize, head: usize, first: usize) -> Self {
        let row = 3 * channels;
        let count = KEYS.min(qkv.len() / row - first);
        let part = |index: usize| &qkv[first * row + index * channels + head * width..];
        Self {
            keys: PackedWeight::strided(part(1), [count, width], [row, 1], Precision::F32),
            values: PackedWeight::strided(part(2), [width, count], [1, row], Precision::F32),
        }
    }
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
