//! Attention without masks.

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::{INPUTS, InputGradients, Operation, of_three};
use rogs_kernels::lanes::{largest, sum};
use rogs_kernels::products::product;
use rogs_kernels::{pointwise, vectorised};

/// Queries whose weights are held at a time.
const QUERIES: usize = 256;

#[derive(Debug)]
struct Attention {
    tokens: usize,
    size: usize,
}

/// softmax(q k^T / sqrt(head size)) v. `[B, heads, T, head size]` each
pub fn attention(query: Tensor<4>, key: Tensor<4>, value: Tensor<4>) -> Tensor<4> {
    let [_, _, tokens, size] = query.dims();
    let shape = query.dims();
    of_three(query, key, value, shape, Attention { tokens, size })
}

impl Attention {
    /// Weights of some queries. `[queries, head size], [T, head size] -> [queries, T]`
    fn weights(&self, query: &[f32], key: &[f32], weights: &mut [f32]) {
        let &Self { tokens, size } = self;
        let count = query.len() / size;
        product(
            [count, tokens, size],
            (weights, tokens, false),
            (query, size, 1),
            (key, 1, size),
        );
        let scale = 1.0 / (size as f32).sqrt();
        vectorised(
            #[inline(always)]
            || {
                for row in weights.chunks_exact_mut(tokens) {
                    let top = largest(row) * scale;
                    for value in row.iter_mut() {
                        *value = pointwise::exp(value.mul_add(scale, -top));
                    }
                    let inverse = 1.0 / sum(row, |value| value);
                    row.iter_mut().for_each(|value| *value *= inverse);
                }
            },
        );
    }

    fn head_len(&self) -> usize {
        (self.tokens * self.size).max(1)
    }
}

impl Operation for Attention {
    fn forward(&self, [query, key, value]: [&[f32]; INPUTS]) -> Vec<f32> {
        let (&Self { tokens, size }, head) = (self, self.head_len());
        let mut out = vec![0.0f32; query.len()];
        out.par_chunks_mut(head).enumerate().for_each(|(index, out)| {
            let [query, key, value] = [query, key, value].map(|map| &map[index * head..][..head]);
            let mut weights = vec![0.0f32; QUERIES.min(tokens) * tokens];
            for (out, query) in out.chunks_mut(QUERIES * size).zip(query.chunks(QUERIES * size)) {
                let count = query.len() / size;
                let weights = &mut weights[..count * tokens];
                self.weights(query, key, weights);
                product(
                    [count, size, tokens],
                    (out, size, false),
                    (weights, tokens, 1),
                    (value, size, 1),
                );
            }
        });
        out
    }

    // P the weights: dV = P^T dO, dP = dO V^T, dS = P (dP - rows' sums of P dP) / sqrt(size), dQ = dS K, dK = dS^T Q.
    fn backward(&self, gradient: &[f32], [query, key, value]: [&[f32]; INPUTS], _: [bool; INPUTS]) -> InputGradients {
        let (&Self { tokens, size }, head) = (self, self.head_len());
        let [mut of_query, mut of_key, mut of_value] = [(); INPUTS].map(|()| vec![0.0f32; query.len()]);
        let scale = 1.0 / (size as f32).sqrt();
        of_query
            .par_chunks_mut(head)
            .zip(of_key.par_chunks_mut(head).zip(of_value.par_chunks_mut(head)))
            .enumerate()
            .for_each(|(index, (of_query, (of_key, of_value)))| {
                let [query, key, value, gradient] =
                    [query, key, value, gradient].map(|map| &map[index * head..][..head]);
                let block = QUERIES.min(tokens) * tokens;
                let [mut weights, mut slopes] = [vec![0.0f32; block], vec![0.0f32; block]];
                let blocks = query.chunks(QUERIES * size).zip(gradient.chunks(QUERIES * size));
                for (of_query, (query, gradient)) in of_query.chunks_mut(QUERIES * size).zip(blocks) {
                    let count = query.len() / size;
                    let (weights, slopes) = (&mut weights[..count * tokens], &mut slopes[..count * tokens]);
                    self.weights(query, key, weights);
                    let turned = [tokens, size, count];
                    product(
                        turned,
                        (of_value, size, true),
                        (weights, 1, tokens),
                        (gradient, size, 1),
                    );
                    product(
                        [count, tokens, size],
                        (slopes, tokens, false),
                        (gradient, size, 1),
                        (value, 1, size),
                    );
                    vectorised(
                        #[inline(always)]
                        || {
                            for (slopes, weights) in
                                slopes.chunks_exact_mut(tokens).zip(weights.chunks_exact_mut(tokens))
                            {
                                for (slope, weight) in slopes.iter_mut().zip(weights.iter()) {
                                    *slope *= weight;
                                }
                                let whole = sum(slopes, |value| value);
                                for (slope, weight) in slopes.iter_mut().zip(weights.iter()) {
                                    *slope = scale * (*slope - weight * whole);
                                }
                            }
                        },
                    );
                    product(
                        [count, size, tokens],
                        (of_query, size, false),
                        (slopes, tokens, 1),
                        (key, size, 1),
                    );
                    product(turned, (of_key, size, true), (slopes, 1, tokens), (query, size, 1));
                }
            });
        [Some(of_query), Some(of_key), Some(of_value)]
    }
}
