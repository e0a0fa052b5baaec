//! The plane sweep.

use std::sync::Arc;

use burn::tensor::Tensor;

use super::node::{HostOperation, node};
use rogs_kernels::Sweep;

#[derive(Debug)]
struct Similarity(Arc<Sweep>);

/// Similarity of features along the rays of a sweep. `[S, F, rows, columns] -> [S, G D, h, w]`
pub fn sweep(features: Tensor<4>, plan: Arc<Sweep>) -> Tensor<4> {
    let shape = plan.shape();
    node([features.into_dispatch()], shape, Arc::new(Similarity(plan)))
}

impl HostOperation<1> for Similarity {
    fn forward(&self, [features]: [&[f32]; 1]) -> Vec<f32> {
        self.0.similarity(features)
    }

    fn backward(&self, gradient: &[f32], [features]: [&[f32]; 1], _: [bool; 1]) -> [Option<Vec<f32>>; 1] {
        [Some(self.0.gradient(gradient, features))]
    }
}
