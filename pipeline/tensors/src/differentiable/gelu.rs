//! GELU in its exact (erf) form.

use std::sync::Arc;

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::node::{HostOperation, node};
use rogs_kernels::{pointwise, vectorised};

/// Values of a task.
const TASK: usize = 1 << 15;

#[derive(Debug)]
struct Gelu;

/// x * (1 + erf(x / sqrt 2)) / 2.
pub fn gelu<const D: usize>(input: Tensor<D>) -> Tensor<D> {
    let shape = input.dims();
    node([input.into_dispatch()], shape, Arc::new(Gelu))
}

impl HostOperation<1> for Gelu {
    fn forward(&self, [input]: [&[f32]; 1]) -> Vec<f32> {
        let mut out = vec![0.0f32; input.len()];
        out.par_chunks_mut(TASK)
            .zip(input.par_chunks(TASK))
            .for_each(|(out, input)| {
                vectorised(
                    #[inline(always)]
                    || {
                        for (out, &x) in out.iter_mut().zip(input) {
                            *out = pointwise::gelu(x);
                        }
                    },
                );
            });
        out
    }

    fn backward(&self, gradient: &[f32], [input]: [&[f32]; 1], _: [bool; 1]) -> [Option<Vec<f32>>; 1] {
        let mut out = vec![0.0f32; input.len()];
        out.par_chunks_mut(TASK)
            .zip(input.par_chunks(TASK).zip(gradient.par_chunks(TASK)))
            .for_each(|(out, (input, gradient))| {
                vectorised(
                    #[inline(always)]
                    || {
                        for (out, (&x, &slope)) in out.iter_mut().zip(input.iter().zip(gradient)) {
                            *out = slope * pointwise::gelu_slope(x);
                        }
                    },
                );
            });
        [Some(out)]
    }
}
