//! Layer normalisation over the last dimension.

use std::sync::Arc;

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::node::{HostOperation, node};
use rogs_kernels::lanes::sum;
use rogs_kernels::{Norm, moments, vectorised};

/// Rows of a task.
const TASK_ROWS: usize = 64;

#[derive(Debug)]
struct LayerNorm {
    size: usize,
    epsilon: f32,
}

/// (x - mean) / sqrt(variance + epsilon) * weight + bias. `[..., size]`, `weight [size]`, `bias [size]`
pub fn layer_norm<const D: usize>(input: Tensor<D>, weight: Tensor<1>, bias: Tensor<1>, epsilon: f64) -> Tensor<D> {
    let (shape, size) = (input.dims(), input.dims()[D - 1]);
    let epsilon = epsilon as f32;
    let inputs = [input.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()];
    node(inputs, shape, Arc::new(LayerNorm { size, epsilon }))
}

impl HostOperation<3> for LayerNorm {
    fn forward(&self, [input, weight, bias]: [&[f32]; 3]) -> Vec<f32> {
        let size = self.size.max(1);
        let norm = Norm {
            weight,
            bias,
            epsilon: self.epsilon,
            centred: true,
        };
        let mut out = vec![0.0f32; input.len()];
        out.par_chunks_mut(TASK_ROWS * size)
            .zip(input.par_chunks(TASK_ROWS * size))
            .for_each(|(out, input)| {
                vectorised(
                    #[inline(always)]
                    || {
                        out.copy_from_slice(input);
                        for row in out.chunks_exact_mut(size) {
                            norm.apply(row);
                        }
                    },
                );
            });
        out
    }

    // With y the normalised row and h = gradient * weight: scale * (h - mean(h) - y * mean(h y)).
    fn backward(&self, gradient: &[f32], [input, weight, _]: [&[f32]; 3], wanted: [bool; 3]) -> [Option<Vec<f32>>; 3] {
        let size = self.size.max(1);
        let mut of_input = vec![0.0f32; input.len()];
        let partial: Vec<[Vec<f32>; 2]> = of_input
            .par_chunks_mut(TASK_ROWS * size)
            .zip(
                input
                    .par_chunks(TASK_ROWS * size)
                    .zip(gradient.par_chunks(TASK_ROWS * size)),
            )
            .map(|(out, (input, gradient))| {
                let [mut of_weight, mut of_bias] = [vec![0.0f32; size], vec![0.0f32; size]];
                let mut scaled = vec![0.0f32; size];
                vectorised(
                    #[inline(always)]
                    || {
                        let rows = input.chunks_exact(size).zip(gradient.chunks_exact(size));
                        for (out, (row, gradient)) in out.chunks_exact_mut(size).zip(rows) {
                            let (mean, scale) = moments(row, self.epsilon);
                            for k in 0..size {
                                let unit = (row[k] - mean) * scale;
                                of_weight[k] += gradient[k] * unit;
                                of_bias[k] += gradient[k];
                                scaled[k] = gradient[k] * weight[k];
                                out[k] = scaled[k] * unit;
                            }
                            let shift = sum(&scaled, |value| value) / size as f32;
                            let slope = sum(out, |value| value) / size as f32;
                            for k in 0..size {
                                let unit = (row[k] - mean) * scale;
                                out[k] = scale * (scaled[k] - shift - unit * slope);
                            }
                        }
                    },
                );
                [of_weight, of_bias]
            })
            .collect();
        let total = |part: usize| {
            let mut sum = vec![0.0f32; size];
            for sums in &partial {
                sum.iter_mut().zip(&sums[part]).for_each(|(sum, value)| *sum += value);
            }
            sum
        };
        [Some(of_input), wanted[1].then(|| total(0)), wanted[2].then(|| total(1))]
    }
}
