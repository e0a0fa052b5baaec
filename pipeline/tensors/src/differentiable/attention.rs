//! Attention without masks.

use std::sync::Arc;

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::node::{HostOperation, node};
use rogs_kernels::lanes::sum;
use rogs_kernels::{Head, Matrix, PackedWeight, Precision, vectorised};

/// Queries whose weights the backward pass holds at a time.
const QUERIES: usize = 240;

#[derive(Debug)]
struct Attention {
    tokens: usize,
    size: usize,
}

/// softmax(q k^T / sqrt(head size)) v. `[B, heads, T, head size]` each
pub fn attention(query: Tensor<4>, key: Tensor<4>, value: Tensor<4>) -> Tensor<4> {
    let [_, _, tokens, size] = query.dims();
    let shape = query.dims();
    let inputs = [query.into_dispatch(), key.into_dispatch(), value.into_dispatch()];
    node(inputs, shape, Arc::new(Attention { tokens, size }))
}

impl Attention {
    fn scale(&self) -> f32 {
        1.0 / (self.size as f32).sqrt()
    }

    /// Queries as the kernel takes them.
    fn scaled(&self, query: &[f32]) -> Vec<f32> {
        query.iter().map(|value| value * self.scale()).collect()
    }

    fn head_len(&self) -> usize {
        (self.tokens * self.size).max(1)
    }

    /// Gradients of the three inputs of one head. `[T, head size]` each
    // P the weights, S the scores: dV = P^T dO, dP = dO V^T, dS = P (dP - rows' sums of P dP), dQ = dS K / sqrt(size),
    // dK = dS^T Q / sqrt(size).
    fn head_backward(&self, [query, key, value, gradient]: [&[f32]; 4], gradients: [&mut [f32]; 3]) {
        let (&Self { tokens, size }, scale) = (self, self.scale());
        let [of_query, of_key, of_value] = gradients;
        let pack = |matrix| PackedWeight::of(matrix, Precision::F32);
        let [key, value] = [key, value].map(|values| Matrix::new(values, size));
        let (head, values, keys) = (
            Head::new(key, value, Precision::F32),
            pack(value),
            pack(key.transposed()),
        );
        let query = self.scaled(query);
        let block = QUERIES.min(tokens) * tokens;
        let [mut weights, mut slopes] = [vec![0.0f32; block], vec![0.0f32; block]];
        let blocks = query.chunks(QUERIES * size).zip(gradient.chunks(QUERIES * size));
        for (of_query, (query, gradient)) in of_query.chunks_mut(QUERIES * size).zip(blocks) {
            let count = query.len() / size;
            let (weights, slopes) = (&mut weights[..count * tokens], &mut slopes[..count * tokens]);
            head.weights(query, weights);
            pack(Matrix::new(gradient, size).transposed())
                .add_rows(Matrix::new(weights, tokens).transposed(), of_value);
            values.rows(gradient, slopes, tokens, |_, _, _| {});
            vectorised(
                #[inline(always)]
                || {
                    for (slopes, weights) in slopes.chunks_exact_mut(tokens).zip(weights.chunks_exact(tokens)) {
                        for (slope, weight) in slopes.iter_mut().zip(weights) {
                            *slope *= weight;
                        }
                        let whole = sum(slopes, |value| value);
                        for (slope, weight) in slopes.iter_mut().zip(weights) {
                            *slope -= weight * whole;
                        }
                    }
                },
            );
            keys.rows(
                slopes,
                of_query,
                size,
                #[inline(always)]
                |_, _, values| values.iter_mut().for_each(|value| *value *= scale),
            );
            pack(Matrix::new(query, size).transposed()).add_rows(Matrix::new(slopes, tokens).transposed(), of_key);
        }
    }
}

impl HostOperation<3> for Attention {
    fn forward(&self, [query, key, value]: [&[f32]; 3]) -> Vec<f32> {
        let (size, head) = (self.size, self.head_len());
        let (mut out, bias) = (vec![0.0f32; query.len()], vec![0.0f32; size]);
        out.par_chunks_mut(head)
            .enumerate()
            .for_each_init(Vec::new, |scores, (index, out)| {
                let [query, key, value] = [query, key, value].map(|map| &map[index * head..][..head]);
                let [key, value] = [key, value].map(|values| Matrix::new(values, size));
                let packed = Head::new(key, value, Precision::F32);
                packed.attend(&self.scaled(query), &bias, out, size, scores);
            });
        out
    }

    fn backward(&self, gradient: &[f32], [query, key, value]: [&[f32]; 3], _: [bool; 3]) -> [Option<Vec<f32>>; 3] {
        let head = self.head_len();
        let [mut of_query, mut of_key, mut of_value] = [(); 3].map(|()| vec![0.0f32; query.len()]);
        of_query
            .par_chunks_mut(head)
            .zip(of_key.par_chunks_mut(head).zip(of_value.par_chunks_mut(head)))
            .enumerate()
            .for_each(|(index, (of_query, (of_key, of_value)))| {
                let inputs = [query, key, value, gradient].map(|map| &map[index * head..][..head]);
                self.head_backward(inputs, [of_query, of_key, of_value]);
            });
        [Some(of_query), Some(of_key), Some(of_value)]
    }
}
