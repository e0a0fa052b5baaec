//! The way from burn tensors to slices and back: one backend operation that runs a function on the host values.

use std::sync::{Arc, OnceLock};

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, Flex, backend_extension};
use burn::tensor::{Tensor, TensorData};

use crate::device::is_cpu;
use rogs_kernels::{PackedWeight, Precision};

/// A function of the values of two tensors; returns the values of the result.
pub type HostReader = Arc<dyn Fn(&[f32], &[f32]) -> Vec<f32> + Send + Sync>;

/// Operations on host values; only the CPU backend has them.
#[backend_extension(Flex)]
pub trait HostKernels: Backend {
    /// Runs a function on the values of two tensors; `shape` is that of the result.
    fn host(
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        function: HostReader,
        shape: Vec<usize>,
    ) -> FloatTensor<Self>;
}

type CpuTensor = FloatTensor<Flex>;

impl HostKernels for Flex {
    fn host(first: CpuTensor, second: CpuTensor, function: HostReader, shape: Vec<usize>) -> CpuTensor {
        let (first, second) = (first.to_contiguous(), second.to_contiguous());
        let values = function(
            first.as_slice::<f32>().unwrap_or_default(),
            second.as_slice::<f32>().unwrap_or_default(),
        );
        CpuTensor::from_data(TensorData::new(values, shape))
    }
}

/// Whether kernels may be used: f32 values on the CPU that record no gradients.
pub fn usable<const D: usize>(tensor: &Tensor<D>) -> bool {
    !tensor.is_autodiff() && is_cpu(&tensor.device()) && tensor.dtype() == burn::tensor::DType::F32
}

/// Runs a kernel on the values of two tensors.
pub fn read<const A: usize, const B: usize, const D: usize>(
    first: Tensor<A>,
    second: Tensor<B>,
    shape: [usize; D],
    function: impl Fn(&[f32], &[f32]) -> Vec<f32> + Send + Sync + 'static,
) -> Tensor<D> {
    let (first, second, shape) = (first.into_dispatch(), second.into_dispatch(), shape.to_vec());
    Tensor::from_dispatch(<Dispatch as HostKernels>::host(
        first,
        second,
        Arc::new(function),
        shape,
    ))
}

/// Packs the weights of a linear layer for products. `[out, in]`
pub fn pack(weight: &Tensor<2>, precision: Precision) -> PackedWeight {
    let slot = Arc::new(OnceLock::new());
    let (filled, inputs) = (slot.clone(), weight.dims()[1]);
    let _: Tensor<1> = read(weight.clone(), weight.clone(), [0], move |weight, _| {
        filled.get_or_init(|| PackedWeight::new(weight, inputs, precision));
        Vec::new()
    });
    let packed = Arc::try_unwrap(slot).ok().and_then(OnceLock::into_inner);
    packed.unwrap_or_else(|| PackedWeight::new(&[], inputs, precision))
}
