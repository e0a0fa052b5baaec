//! The rotary embedding: x * cos + swap(x) * sin, where `swap` exchanges the two quarters of each half of a head.

use std::sync::Arc;

use burn::tensor::Tensor;

use super::node::{HostOperation, node};
use rogs_kernels::RotaryTable;

#[derive(Debug)]
struct Rotate(Arc<RotaryTable>);

/// Rotates queries or keys; the table repeats after its last position. `[B, heads, T, head size]`
pub fn rotate(input: Tensor<4>, table: Arc<RotaryTable>) -> Tensor<4> {
    let shape = input.dims();
    node([input.into_dispatch()], shape, Arc::new(Rotate(table)))
}

impl HostOperation<1> for Rotate {
    fn forward(&self, [input]: [&[f32]; 1]) -> Vec<f32> {
        self.0.rotated(input)
    }

    fn backward(&self, gradient: &[f32], _: [&[f32]; 1], _: [bool; 1]) -> [Option<Vec<f32>>; 1] {
        [Some(self.0.rotated_back(gradient))]
    }
}
