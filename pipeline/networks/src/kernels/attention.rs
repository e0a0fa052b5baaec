//! Blocked softmax attention on packed queries, keys and values.
//!
//! Scores of 128 query rows against all keys are one matrix product, their softmax runs in place, and a second product
//! with the values writes the output; nothing of size tokens x tokens is ever held.

use gemm::Parallelism;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::pointwise::exp;
use super::vectorised;

/// Query rows of a task.
const ROWS: usize = 128;

/// Affine map and epsilon of the norm of queries or keys. `[head size]` each
pub(crate) struct HeadNorm<'a> {
    pub(crate) weight: &'a [f32],
    pub(crate) bias: &'a [f32],
    pub(crate) epsilon: f32,
}

/// Attention of a batch of token lists.
pub(crate) struct PackedAttention<'a> {
    /// Queries, keys, values of all heads. `[B, T, 3, heads, head size]`
    pub(crate) packed: &'a [f32],
    /// Bias of the packed projection, not yet added. `[3, heads, head size]`
    pub(crate) bias: &'a [f32],
    /// Tokens of a list.
    pub(crate) tokens: usize,
    /// Heads.
    pub(crate) heads: usize,
    /// Channels of a head.
    pub(crate) size: usize,
    /// Norms of queries and keys.
    pub(crate) norms: Option<[HeadNorm<'a>; 2]>,
    /// Rotary cosines and signed sines, `[period, head size]` each, where the positions repeat after `period` tokens.
    pub(crate) rotary: Option<[&'a [f32]; 2]>,
}

impl PackedAttention<'_> {
    /// softmax(q k^T / sqrt(size)) v. `[B, T, heads * size]`
    pub(crate) fn run(&self) -> Vec<f32> {
        let Self {
            packed,
            tokens,
            heads,
            size,
            ..
        } = *self;
        let width = heads * size;
        let lists = packed.len() / (3 * width * tokens).max(1);
        let mut output = vec![0.0f32; lists * tokens * width];
        for (list, output) in output.chunks_exact_mut(tokens * width).enumerate() {
            let packed = &packed[list * tokens * 3 * width..][..tokens * 3 * width];
            let queries = self.prepare(packed, 0, 1.0 / (size as f32).sqrt());
            let keys = self.prepare(packed, 1, 1.0);
            output
                .par_chunks_mut(ROWS * width)
                .enumerate()
                .for_each_init(Vec::new, |scores, (block, output)| {
                    let rows = output.len() / width;
                    scores.resize(ROWS * tokens, 0.0);
                    for head in 0..heads {
                        let first = (head * tokens + block * ROWS) * size;
                        let queries = &queries[first..first + rows * size];
                        let keys = &keys[head * tokens * size..][..tokens * size];
                        let values = &packed[2 * width + head * size..];
                        self.block(
                            queries,
                            keys,
                            values,
                            scores,
                            &mut output[head * size..],
                            rows,
                            &self.bias[2 * width + head * size..],
                        );
                    }
                });
        }
        output
    }

    /// One head of one block of query rows. `values` and `output` begin at the head's first channel.
    fn block(
        &self,
        queries: &[f32],
        keys: &[f32],
        values: &[f32],
        scores: &mut [f32],
        output: &mut [f32],
        rows: usize,
        bias: &[f32],
    ) {
        let Self {
            tokens, heads, size, ..
        } = *self;
        let width = heads * size;
        // scores [rows, tokens] = queries [rows, size] keys^T
        product(
            [rows, tokens, size],
            scores,
            tokens,
            (queries, size, 1),
            (keys, 1, size),
        );
        let mut sums = [0.0f32; ROWS];
        for (row, sum) in scores.chunks_exact_mut(tokens).zip(&mut sums[..rows]) {
            *sum = Arch::new().dispatch(Exponentials(row));
        }
        // output [rows, size] = scores values, rows apart by the width of all heads
        product(
            [rows, size, tokens],
            output,
            width,
            (scores, tokens, 1),
            (values, 3 * width, 1),
        );
        for (row, sum) in output.chunks_mut(width).zip(&sums[..rows]) {
            // The weights of a row sum to one, so the bias of the values adds to their mean.
            row[..size]
                .iter_mut()
                .zip(bias)
                .for_each(|(value, bias)| *value = *value / sum + bias);
        }
    }

    /// Normalised, rotated and scaled queries (part 0) or keys (part 1). `[heads, T, size]`
    fn prepare(&self, packed: &[f32], part: usize, scale: f32) -> Vec<f32> {
        let Self {
            tokens, heads, size, ..
        } = *self;
        let width = heads * size;
        let mut result = vec![0.0f32; heads * tokens * size];
        result
            .par_chunks_mut(tokens * size)
            .enumerate()
            .for_each(|(head, result)| {
                vectorised(
                    #[inline(always)]
                    || {
                        for (token, out) in result.chunks_exact_mut(size).enumerate() {
                            let first = part * width + head * size;
                            let values = packed[token * 3 * width + first..].iter().zip(&self.bias[first..]);
                            out.iter_mut()
                                .zip(values)
                                .for_each(|(out, (value, bias))| *out = value + bias);
                            if let Some(norms) = &self.norms {
                                normalise(out, &norms[part]);
                            }
                            if let Some([cosine, sine]) = self.rotary {
                                let place = (token * size) % cosine.len();
                                rotate(out, &cosine[place..place + size], &sine[place..place + size]);
                            }
                            out.iter_mut().for_each(|value| *value *= scale);
                        }
                    },
                );
            });
        result
    }
}

/// Replaces the scores of a row by e^(score - largest) and returns their sum.
struct Exponentials<'a>(&'a mut [f32]);

impl WithSimd for Exponentials<'_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let (vectors, rest) = S::as_simd_f32s(self.0);
        let mut largest = simd.splat_f32s(f32::NEG_INFINITY);
        for &vector in vectors {
            largest = simd.max_f32s(largest, vector);
        }
        let largest = rest.iter().fold(simd.reduce_max_f32s(largest), |a, &b| a.max(b));
        for value in self.0.iter_mut() {
            *value = exp(*value - largest);
        }
        let (vectors, rest) = S::as_simd_f32s(self.0);
        let mut sum = simd.splat_f32s(0.0);
        for &vector in vectors {
            sum = simd.add_f32s(sum, vector);
        }
        rest.iter().fold(simd.reduce_sum_f32s(sum), |a, &b| a + b)
    }
}

#[inline(always)]
fn normalise(values: &mut [f32], norm: &HeadNorm<'_>) {
    let count = values.len() as f32;
    let mean = values.iter().sum::<f32>() / count;
    let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f32>() / count;
    let inverse = 1.0 / (variance + norm.epsilon).sqrt();
    for ((value, weight), bias) in values.iter_mut().zip(norm.weight).zip(norm.bias) {
        *value = ((*value - mean) * inverse).mul_add(*weight, *bias);
    }
}

/// The rotary embedding; sines of the first quarter of each half carry the minus sign.
#[inline(always)]
fn rotate(values: &mut [f32], cosine: &[f32], sine: &[f32]) {
    let quarter = values.len() / 4;
    let halves = values
        .chunks_exact_mut(2 * quarter)
        .zip(cosine.chunks_exact(2 * quarter))
        .zip(sine.chunks_exact(2 * quarter));
    for ((values, cosine), sine) in halves {
        let (first, second) = values.split_at_mut(quarter);
        for index in 0..quarter {
            let (a, b) = (first[index], second[index]);
            first[index] = a.mul_add(cosine[index], b * sine[index]);
            second[index] = b.mul_add(cosine[quarter + index], a * sine[quarter + index]);
        }
    }
}

/// out [m, n] = lhs [m, k] rhs [k, n]; operands come with their row and column strides, `out` with its row stride.
// The gemm crate takes pointers. Every index it forms is checked against the slices first.
#[allow(unsafe_code)]
pub(super) fn product(
    [m, n, k]: [usize; 3],
    out: &mut [f32],
    out_stride: usize,
    (lhs, lhs_rows, lhs_columns): (&[f32], usize, usize),
    (rhs, rhs_rows, rhs_columns): (&[f32], usize, usize),
) {
    if m == 0 || n == 0 || k == 0 {
        return;
    }
    assert!((m - 1) * out_stride + n <= out.len());
    assert!((m - 1) * lhs_rows + (k - 1) * lhs_columns < lhs.len());
    assert!((k - 1) * rhs_rows + (n - 1) * rhs_columns < rhs.len());
    // SAFETY: the largest offset of each operand is inside its slice (asserted above), `out` is borrowed exclusively, and
    // without `read_dst` its old values are not read.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.as_mut_ptr(),
            1,
            out_stride as isize,
            false,
            lhs.as_ptr(),
            lhs_columns as isize,
            lhs_rows as isize,
            rhs.as_ptr(),
            rhs_columns as isize,
            rhs_rows as isize,
            0.0f32,
            1.0f32,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equals_the_definition_over_several_blocks() {
        let (lists, tokens, heads, size) = (2, 300, 2, 8);
        let width = heads * size;
        let packed: Vec<f32> = (0..lists * tokens * 3 * width)
            .map(|k| ((k * 7919) % 1009) as f32 / 250.0 - 2.0)
            .collect();
        let bias: Vec<f32> = (0..3 * width).map(|k| (k % 7) as f32 / 7.0 - 0.5).collect();
        let found = PackedAttention {
            packed: &packed,
            bias: &bias,
            tokens,
            heads,
            size,
            norms: None,
            rotary: None,
        }
        .run();
        let at = |list: usize, token: usize, part: usize, head: usize, channel: usize| {
            let place = head * size + channel;
            f64::from(packed[((list * tokens + token) * 3 + part) * width + place] + bias[part * width + place])
        };
        for (list, token, head) in [(0, 0, 0), (0, 299, 1), (1, 127, 0), (1, 128, 1)] {
            let score = |key: usize| {
                (0..size)
                    .map(|c| at(list, token, 0, head, c) * at(list, key, 1, head, c))
                    .sum::<f64>()
                    / (size as f64).sqrt()
            };
            let weights: Vec<f64> = (0..tokens).map(|key| score(key).exp()).collect();
            let total: f64 = weights.iter().sum();
            for channel in 0..size {
                let expected = (0..tokens)
                    .map(|key| weights[key] * at(list, key, 2, head, channel))
                    .sum::<f64>()
                    / total;
                let value = f64::from(found[(list * tokens + token) * width + head * size + channel]);
                assert!((value - expected).abs() < 1e-5, "{value} {expected}");
            }
        }
    }
}
