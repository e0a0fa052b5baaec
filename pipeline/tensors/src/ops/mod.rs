//! The tensor operations of the networks. Each chooses by itself between a kernel of `rogs_kernels`, the same with gradients
//! ([`crate::differentiable`]), and the framework.

mod attention;
mod conv;
mod linear;
mod norm;
mod reduce;
mod resample;
mod rotary;
mod similarity;
mod tail;

use burn::tensor::{Tensor, activation};

use crate::differentiable;

pub use attention::{SelfAttention, attention};
pub use conv::Conv;
pub use linear::{LORA_SCALE, Linear, fold, linear};
pub use norm::{LayerNorm, standardise};
pub use reduce::{product, row_means};
pub use resample::resize;
pub use rotary::Rotary;
pub use similarity::similarity;
pub use tail::DenseTail;

/// GELU in its exact (erf) form.
#[must_use]
pub fn gelu<const D: usize>(input: Tensor<D>) -> Tensor<D> {
    if differentiable::usable(&input) {
        return differentiable::gelu(input);
    }
    activation::gelu(input)
}

/// max(x, 0).
#[must_use]
pub fn relu(input: Tensor<4>) -> Tensor<4> {
    activation::relu(input)
}
