//! Rotary position embedding of queries and keys.

use std::sync::Arc;

use burn::tensor::{Device, Tensor};
use rogs_kernels::RotaryTable;

use crate::differentiable;
use crate::parameters::from_host;

/// A [`RotaryTable`] on a device. `[1, 1, T, head_size]` each
#[derive(Debug, Clone)]
pub struct Rotary {
    /// The table of one period; the positions of longer token lists repeat it.
    table: Arc<RotaryTable>,
    cosine: Tensor<4>,
    sine: Tensor<4>,
}

impl Rotary {
    /// A table on a device.
    #[must_use]
    pub fn new(table: RotaryTable, device: &Device) -> Self {
        let shape = [1, 1, table.len(), table.head_size];
        Self {
            cosine: from_host(table.cosine.clone(), shape, device),
            sine: from_host(table.sine.clone(), shape, device),
            table: Arc::new(table),
        }
    }

    /// Rotates queries or keys. `[B, heads, T, head_size]`
    #[must_use]
    pub fn apply(&self, input: Tensor<4>) -> Tensor<4> {
        if differentiable::usable(&input) {
            return differentiable::rotate(input, self.table.clone());
        }
        self.apply_on_tensors(input)
    }

    /// [`Self::apply`] in operations of the framework.
    pub fn apply_on_tensors(&self, input: Tensor<4>) -> Tensor<4> {
        let [batch, heads, tokens, size] = input.dims();
        let quarter = size / 4;
        let part = |index: usize| input.clone().narrow(3, index * quarter, quarter);
        let swapped = Tensor::cat(vec![part(1), part(0), part(3), part(2)], 3).reshape([batch, heads, tokens, size]);
        input.clone() * self.cosine.clone() + swapped * self.sine.clone()
    }

    /// The values of one period of positions.
    pub fn table(&self) -> &Arc<RotaryTable> {
        &self.table
    }

    /// The same table for `frames` copies of the token list, one after another.
    #[must_use]
    pub fn repeated(&self, frames: usize) -> Self {
        let repeat = |table: &Tensor<4>| table.clone().repeat(&[1, 1, frames, 1]);
        Self {
            table: self.table.clone(),
            cosine: repeat(&self.cosine),
            sine: repeat(&self.sine),
        }
    }
}
