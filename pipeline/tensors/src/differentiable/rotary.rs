//! The rotary embedding: x * cos + swap(x) * sin, where `swap` exchanges the two quarters of each half of a head.

use std::sync::Arc;

use burn::tensor::Tensor;

use super::{INPUTS, InputGradients, Operation, of_one};
use rogs_kernels::RotaryTable;

#[derive(Debug)]
struct Rotate(Arc<RotaryTable>);

/// Rotates queries or keys; the table repeats after its last position. `[B, heads, T, head size]`
pub fn rotate(input: Tensor<4>, table: Arc<RotaryTable>) -> Tensor<4> {
    let shape = input.dims();
    of_one(input, shape, Rotate(table))
}

impl Operation for Rotate {
    fn forward(&self, [input, ..]: [&[f32]; INPUTS]) -> Vec<f32> {
        self.0.rotated(input)
    }

    fn backward(&self, gradient: &[f32], _: [&[f32]; INPUTS], _: [bool; INPUTS]) -> InputGradients {
        [Some(self.0.rotated_back(gradient)), None, None]
    }
}
