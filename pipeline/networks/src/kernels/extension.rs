//! The way from burn tensors to slices and back: one backend operation that runs a function on the host values.

use std::sync::Arc;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, Flex, backend_extension};
use burn::tensor::{Device, Tensor, TensorData};

/// A function of the values of two tensors: the first handed over (without a copy where nobody else holds it), the second
/// lent; returns the values of the result.
pub(crate) type HostFunction = Arc<dyn Fn(Vec<f32>, &[f32]) -> Vec<f32> + Send + Sync>;
/// A function that only reads both.
pub(crate) type HostReader = Arc<dyn Fn(&[f32], &[f32]) -> Vec<f32> + Send + Sync>;

/// What to do with the values.
#[derive(Clone)]
pub(crate) enum HostOp {
    /// Consume the first tensor.
    Update(HostFunction),
    /// Read both tensors.
    Read(HostReader),
}

/// Operations on host values; only the CPU backend has them.
#[backend_extension(Flex)]
pub(crate) trait HostKernels: Backend {
    /// Runs a function on the values of two tensors; `shape` is that of the result.
    fn host(first: FloatTensor<Self>, second: FloatTensor<Self>, op: HostOp, shape: Vec<usize>) -> FloatTensor<Self>;
}

type CpuTensor = FloatTensor<Flex>;

impl HostKernels for Flex {
    fn host(first: CpuTensor, second: CpuTensor, op: HostOp, shape: Vec<usize>) -> CpuTensor {
        let second = second.to_contiguous();
        let other = second.as_slice::<f32>().unwrap_or_default();
        let values = match op {
            HostOp::Update(function) => function(first.to_contiguous_data(), other),
            HostOp::Read(function) => {
                let first = first.to_contiguous();
                function(first.as_slice::<f32>().unwrap_or_default(), other)
            }
        };
        CpuTensor::from_data(TensorData::new(values, shape))
    }
}

/// The values of a tensor as a vector.
trait IntoValues {
    fn to_contiguous_data(self) -> Vec<f32>;
}

impl IntoValues for CpuTensor {
    fn to_contiguous_data(self) -> Vec<f32> {
        let contiguous = if self.is_contiguous() {
            self
        } else {
            self.to_contiguous()
        };
        contiguous.into_data().try_into_vec::<f32>().unwrap_or_default()
    }
}

/// Whether kernels may be used: f32 values on the CPU that record no gradients.
pub(crate) fn usable<const D: usize>(tensor: &Tensor<D>) -> bool {
    !tensor.is_autodiff() && tensor.device() == Device::flex() && tensor.dtype() == burn::tensor::DType::F32
}

/// Runs a kernel that reads two tensors.
pub(crate) fn read<const A: usize, const B: usize, const D: usize>(
    first: Tensor<A>,
    second: Tensor<B>,
    shape: [usize; D],
    function: impl Fn(&[f32], &[f32]) -> Vec<f32> + Send + Sync + 'static,
) -> Tensor<D> {
    run(first, second, HostOp::Read(Arc::new(function)), shape)
}

/// Runs a kernel that consumes the first tensor.
pub(crate) fn update<const A: usize, const B: usize, const D: usize>(
    first: Tensor<A>,
    second: Tensor<B>,
    shape: [usize; D],
    function: impl Fn(Vec<f32>, &[f32]) -> Vec<f32> + Send + Sync + 'static,
) -> Tensor<D> {
    run(first, second, HostOp::Update(Arc::new(function)), shape)
}

fn run<const A: usize, const B: usize, const D: usize>(
    first: Tensor<A>,
    second: Tensor<B>,
    op: HostOp,
    shape: [usize; D],
) -> Tensor<D> {
    let result = <Dispatch as HostKernels>::host(first.into_dispatch(), second.into_dispatch(), op, shape.to_vec());
    Tensor::from_dispatch(result)
}
