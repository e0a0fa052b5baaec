//! Operations of the autodiff graph whose values and gradients are computed on host slices: what training on a CPU spends
//! its time with.
//!
//! An operation is a pair of functions on slices (`HostOperation`), which this module makes a node of the
//! framework's graph. It keeps its inputs and computes again what it needs of the forward pass. Sums have a fixed order,
//! whatever the number of threads.

mod attention;
mod convolution;
mod gelu;
mod layer_norm;
mod linear;
pub(crate) mod node;
mod resize;
mod rotary;
mod sweep;

use burn::tensor::{DType, Tensor};

use crate::device::is_cpu;

pub use attention::attention;
pub use convolution::{convolve, convolve_pixels};
pub use gelu::gelu;
pub use layer_norm::layer_norm;
pub use linear::linear;
pub use resize::resize;
pub use rotary::rotate;
pub use sweep::sweep;

/// Whether these operations may be used on a tensor: f32 values that record gradients, on the CPU.
pub fn usable<const D: usize>(tensor: &Tensor<D>) -> bool {
    tensor.is_autodiff() && tensor.dtype() == DType::F32 && is_cpu(&tensor.device())
}

#[cfg(test)]
mod tests;
