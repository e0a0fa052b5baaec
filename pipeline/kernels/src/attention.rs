//! Blocked softmax attention.
//!
//! Scores of some query rows against all keys are one matrix product, their softmax runs in place, and a second product
//! with the values writes the output; nothing of size tokens x tokens is ever held ([`Head`]). [`PackedAttention`] runs all
//! heads of token lists whose queries, keys and values come from one projection.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::lanes;
use crate::pointwise::exp;
use crate::{Matrix, Norm, PackedWeight, Precision, vectorised};

/// Query rows of a task.
const ROWS: usize = 60;
/// Query rows that are taken together at least; a multiple is.
const FEWEST_ROWS: usize = 12;
/// Scores of the rows that are taken together: they stay in the second-level cache, beside keys and values that pass.
const SCORES: usize = 128 << 10;

/// Keys and values of one head, packed for products.
#[derive(Debug)]
pub struct Head {
    keys: PackedWeight,
    values: PackedWeight,
}

impl Head {
    /// Packs keys and values. `[T, size]` each
    #[must_use]
    pub fn new(keys: Matrix<'_>, values: Matrix<'_>, precision: Precision) -> Self {
        Self {
            keys: PackedWeight::of(keys, precision),
            values: PackedWeight::of(values.transposed(), precision),
        }
    }

    /// softmax(q k^T) v + bias for queries that are scaled, on the calling thread; rows of `output` are `stride` apart.
    /// `scores` is memory to be used again. `queries [n, size]`, `bias [size]`
    pub fn attend(&self, queries: &[f32], bias: &[f32], output: &mut [f32], stride: usize, scores: &mut Vec<f32>) {
        let (size, tokens) = (self.values.outputs(), self.keys.outputs());
        let together = (SCORES / tokens.max(1) / FEWEST_ROWS).clamp(1, ROWS / FEWEST_ROWS) * FEWEST_ROWS;
        let pieces = queries
            .chunks(together * size)
            .zip(output.chunks_mut(together * stride));
        for (queries, output) in pieces {
            scores.resize(queries.len() / size * tokens, 0.0);
            self.keys.rows(queries, scores, tokens, |_, _, _| {});
            let mut inverses = [0.0f32; ROWS];
            for (row, inverse) in scores.chunks_exact_mut(tokens).zip(&mut inverses) {
                *inverse = 1.0 / Arch::new().dispatch(Exponentials(row));
            }
            self.values.rows(
                scores,
                output,
                stride,
                // The weights of a row sum to one, so the bias of the values adds to their mean.
                #[inline(always)]
                |row, column, values| {
                    for (value, bias) in values.iter_mut().zip(&bias[column..]) {
                        *value = value.mul_add(inverses[row], *bias);
                    }
                },
            );
        }
    }

    /// softmax(q k^T) for queries that are scaled, on the calling thread. `[n, size] -> [n, T]`
    pub fn weights(&self, queries: &[f32], weights: &mut [f32]) {
        let tokens = self.keys.outputs();
        self.keys.rows(queries, weights, tokens, |_, _, _| {});
        for row in weights.chunks_exact_mut(tokens) {
            let inverse = 1.0 / Arch::new().dispatch(Exponentials(row));
            row.iter_mut().for_each(|weight| *weight *= inverse);
        }
    }
}

/// Attention of a batch of token lists.
pub struct PackedAttention<'a> {
    /// Queries, keys, values of all heads. `[B, T, 3, heads, head size]`
    pub packed: &'a [f32],
    /// Bias of the packed projection, not yet added. `[3, heads, head size]`
    pub bias: &'a [f32],
    /// Tokens of a list.
    pub tokens: usize,
    /// Heads.
    pub heads: usize,
    /// Channels of a head.
    pub size: usize,
    /// Norms of queries and keys.
    pub norms: Option<[Norm<'a>; 2]>,
    /// Rotary cosines and signed sines, `[period, head size]` each, where the positions repeat after `period` tokens.
    pub rotary: Option<[&'a [f32]; 2]>,
    /// Numbers of the products.
    pub precision: Precision,
}

impl PackedAttention<'_> {
    /// softmax(q k^T / sqrt(size)) v. `[B, T, heads * size]`
    pub fn run(&self) -> Vec<f32> {
        let Self {
            packed,
            tokens,
            heads,
            size,
            ..
        } = *self;
        let width = heads * size;
        let mut output = vec![0.0f32; packed.len() / 3];
        output
            .par_chunks_mut(tokens * width)
            .zip(packed.par_chunks(tokens * 3 * width))
            .for_each(|(output, packed)| {
                let queries = self.prepare(packed, 0, 1.0 / (size as f32).sqrt());
                let keys = self.prepare(packed, 1, 1.0);
                let packed: Vec<Head> = (0..heads)
                    .into_par_iter()
                    .map(|head| {
                        let keys = Matrix::new(&keys[head * tokens * size..][..tokens * size], size);
                        let values = &packed[2 * width + head * size..];
                        let values = Matrix::strided(values, [tokens, size], [3 * width, 1]);
                        Head::new(keys, values, self.precision)
                    })
                    .collect();
                output
                    .par_chunks_mut(ROWS * width)
                    .enumerate()
                    .for_each_init(Vec::new, |scores, (block, output)| {
                        let rows = output.len() / width;
                        for (head, packed) in packed.iter().enumerate() {
                            let queries = &queries[(head * tokens + block * ROWS) * size..][..rows * size];
                            let bias = &self.bias[2 * width + head * size..][..size];
                            packed.attend(queries, bias, &mut output[head * size..], width, scores);
                        }
                    });
            });
        output
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
                                norms[part].apply_in_order(out);
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
        // Four at a time, none of which waits for the one before.
        let mut largest = [simd.splat_f32s(f32::NEG_INFINITY); 4];
        let (fours, last) = vectors.as_chunks::<4>();
        for vectors in fours {
            for (largest, &vector) in largest.iter_mut().zip(vectors) {
                *largest = simd.max_f32s(*largest, vector);
            }
        }
        for &vector in last {
            largest[0] = simd.max_f32s(largest[0], vector);
        }
        let largest = largest.map(|vector| simd.reduce_max_f32s(vector));
        let largest = largest.iter().chain(rest).fold(f32::NEG_INFINITY, |a, &b| a.max(b));
        // Summed in an order that does not depend on the width of vectors: the same bits on every processor.
        lanes::map_and_sum_by_halves(
            self.0,
            #[inline(always)]
            |value| exp(value - largest),
        )
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

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn sums_of_exponentials_are_the_same_for_vectors_of_any_width() {
        for count in [7usize, 16, 40, 300, 1001] {
            let scores: Vec<f32> = (0..count).map(|k| ((k * 7919) % 1009) as f32 / 250.0 - 2.0).collect();
            let (mut widest, mut one) = (scores.clone(), scores.clone());
            let sum = Arch::new().dispatch(Exponentials(&mut widest));
            assert_eq!(
                sum,
                Simd::vectorize(pulp::Scalar::new(), Exponentials(&mut one)),
                "{count} values"
            );
            assert_eq!(widest, one);
            if let Some(narrow) = pulp::x86::V3::try_new() {
                let mut eight = scores.clone();
                assert_eq!(sum, Simd::vectorize(narrow, Exponentials(&mut eight)), "{count} values");
                assert_eq!(widest, eight);
            }
        }
    }

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
            precision: Precision::F32,
        }
        .run();
        let at = |list: usize, token: usize, part: usize, head: usize, channel: usize| {
            let place = head * size + channel;
            f64::from(packed[((list * tokens + token) * 3 + part) * width + place] + bias[part * width + place])
        };
        for (list, token, head) in [(0, 0, 0), (0, 299, 1), (1, 59, 0), (1, 60, 1)] {
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
