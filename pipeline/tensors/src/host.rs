//! The way from tensors to slices: one backend operation that lends the values of a tensor on the CPU.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, Flex, backend_extension};
use burn::tensor::{DType, Tensor};

use crate::device::is_cpu;

/// Backends whose values lie in the memory of this program: only that of the CPU.
#[backend_extension(Flex)]
trait HostValues: Backend {
    /// What a function makes of the values of a tensor.
    fn lend<R, F: FnOnce(&[f32]) -> R>(tensor: FloatTensor<Self>, function: F) -> R;
}

impl HostValues for Flex {
    fn lend<R, F: FnOnce(&[f32]) -> R>(tensor: FloatTensor<Self>, function: F) -> R {
        function(tensor.to_contiguous().storage())
    }
}

/// Whether kernels may be used: f32 values on the CPU that record no gradients.
pub fn usable<const D: usize>(tensor: &Tensor<D>) -> bool {
    !tensor.is_autodiff() && is_cpu(&tensor.device()) && tensor.dtype() == DType::F32
}

/// What a function makes of the values of a tensor, row-major, without a copy.
///
/// # Panics
/// When the tensor is not [`usable`]: the framework has no other way to say so.
pub fn with_values<const D: usize, R>(tensor: &Tensor<D>, function: impl FnOnce(&[f32]) -> R) -> R {
    <Dispatch as HostValues>::lend(tensor.clone().into_dispatch(), function)
}

/// A copy of the values of a tensor, row-major.
///
/// # Panics
/// As [`with_values`].
pub fn values<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
    with_values(tensor, <[f32]>::to_vec)
}
