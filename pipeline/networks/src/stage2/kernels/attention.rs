//! Softmax self-attention over one set of tokens.

use pulp::Arch;
use rayon::prelude::*;

use super::dense::{MatrixRef, exp, matrix_product};

/// Query rows that one piece of work handles: the score rows stay in the cache.
const QUERIES: usize = 64;

/// Multi-head self-attention. `qkv` is `[n, 3 * channels]`, ordered query, key, value, each head-major; the result is
/// `[n, channels]`. Logits are scaled by `(channels / heads)^-1/2`. Needs 64 rows of scores per thread.
pub(crate) fn self_attention(qkv: &[f32], channels: usize, heads: usize) -> Vec<f32> {
    let tokens = qkv.len() / (3 * channels);
    let width = channels / heads;
    let scale = 1.0 / (width as f32).sqrt();
    let mut out = vec![0.0; tokens * channels];
    // One piece is a run of queries of all heads, so that pieces own disjoint rows of the output.
    out.par_chunks_mut(QUERIES * channels).enumerate().for_each_init(
        || (Vec::new(), Vec::new()),
        |(scores, mixed), (piece, out)| {
            let rows = out.len() / channels;
            scores.resize(rows * tokens, 0.0);
            mixed.resize(rows * width, 0.0);
            for head in 0..heads {
                let view = |part: usize, first: usize, rows: usize| MatrixRef {
                    data: &qkv[first * 3 * channels + part * channels + head * width..],
                    rows,
                    columns: width,
                    row_stride: 3 * channels,
                    column_stride: 1,
                };
                let query = view(0, piece * QUERIES, rows);
                let key = view(1, 0, tokens);
                let transposed_key = MatrixRef {
                    rows: width,
                    columns: tokens,
                    row_stride: 1,
                    column_stride: 3 * channels,
                    ..key
                };
                matrix_product(query, transposed_key, scores, false);
                scores.chunks_exact_mut(tokens).for_each(|row| softmax(row, scale));
                matrix_product(MatrixRef::rows(scores, rows, tokens), view(2, 0, tokens), mixed, false);
                for (out, mixed) in out.chunks_exact_mut(channels).zip(mixed.chunks_exact(width)) {
                    out[head * width..(head + 1) * width].copy_from_slice(mixed);
                }
            }
        },
    );
    out
}

/// Softmax of `scale * row` in place.
fn softmax(row: &mut [f32], scale: f32) {
    Arch::new().dispatch(
        #[inline(always)]
        || {
            let mut best = [f32::NEG_INFINITY; 16];
            for chunk in row.chunks(16) {
                for (best, &value) in best.iter_mut().zip(chunk) {
                    *best = if value > *best { value } else { *best };
                }
            }
            let best = best.iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b));
            let mut sums = [0.0f32; 16];
            for chunk in row.chunks_mut(16) {
                for (sum, value) in sums.iter_mut().zip(chunk) {
                    *value = exp((*value - best) * scale);
                    *sum += *value;
                }
            }
            let inverse = 1.0 / sums.iter().sum::<f32>();
            for value in row.iter_mut() {
                *value *= inverse;
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attention_equals_the_plain_formula() {
        let (tokens, channels, heads) = (150, 12, 3);
        let qkv: Vec<f32> = (0..tokens * 3 * channels)
            .map(|i| ((i * 37) % 101) as f32 / 40.0 - 1.25)
            .collect();
        let out = self_attention(&qkv, channels, heads);
        let at = |token: usize, part: usize, channel: usize| {
            f64::from(qkv[token * 3 * channels + part * channels + channel])
        };
        for token in [0, 63, 64, 149] {
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
