//! The plane sweep.

use std::sync::Arc;

use burn::tensor::Tensor;

use super::{INPUTS, InputGradients, Operation, of_one};
use rogs_kernels::Sweep;

#[derive(Debug)]
struct Similarity(Arc<Sweep>);

/// Similarity of features along the rays of a sweep. `[S, F, rows, columns] -> [S, G D, h, w]`
pub fn sweep(features: Tensor<4>, plan: Arc<Sweep>) -> Tensor<4> {
    let shape = plan.shape();
    of_one(features, shape, Similarity(plan))
}

impl Operation for Similarity {
    fn forward(&self, [features, ..]: [&[f32]; INPUTS]) -> Vec<f32> {
        self.0.similarity(features)
    }

    fn backward(&self, gradient: &[f32], [features, ..]: [&[f32]; INPUTS], _: [bool; INPUTS]) -> InputGradients {
        [Some(self.0.gradient(gradient, features)), None, None]
    }
}
