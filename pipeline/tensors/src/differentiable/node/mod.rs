//! A function of host values, with its gradients, as a node of the framework's graph. Without the feature `gradients`
//! there is no graph, and the function is only run.

#[cfg(feature = "gradients")]
mod gradients;

use std::fmt;
use std::sync::Arc;

use burn::backend::tensor::FloatTensor;
use burn::backend::{
    Backend, BackendTensor, Dispatch, DispatchAutodiffContext, DispatchTensor, DispatchTensorKind, ExtensionType, Flex,
    backend_extension,
};
use burn::tensor::{Tensor, TensorData};

/// A differentiable function of the host values of `N` tensors.
pub(crate) trait HostOperation<const N: usize>: fmt::Debug + Send + Sync {
    /// The result.
    fn forward(&self, inputs: [&[f32]; N]) -> Vec<f32>;

    /// The result, of a call whose gradients will be asked for.
    fn forward_kept(&self, inputs: [&[f32]; N]) -> Vec<f32> {
        self.forward(inputs)
    }

    /// Gradients of the wanted inputs, given that of the result.
    #[cfg_attr(not(feature = "gradients"), allow(dead_code, reason = "nobody asks without a graph"))]
    fn backward(&self, gradient: &[f32], inputs: [&[f32]; N], wanted: [bool; N]) -> [Option<Vec<f32>>; N];
}

/// Makes an operation on tensors of the CPU a node of the graph; `shape` is that of the result.
///
/// # Panics
/// When an input is not f32, or not on the CPU; [`super::usable`] tells.
pub(crate) fn node<const N: usize, const R: usize>(
    inputs: [DispatchTensor; N],
    shape: [usize; R],
    operation: Arc<dyn HostOperation<N>>,
) -> Tensor<R> {
    let inputs = Inputs(inputs.into());
    Tensor::from_dispatch(<Dispatch as Host>::run(inputs, operation, shape.to_vec(), false))
}

/// The inputs of an operation, as they cross the dispatch of the framework.
struct Inputs<B: Backend>(Vec<FloatTensor<B>>);

impl<B: Backend> ExtensionType<B> for Inputs<B> {
    type Target = Inputs<Dispatch>;

    fn map_to_dispatch<F>(self, map_kind: F, autodiff: DispatchAutodiffContext) -> Self::Target
    where
        F: Fn(BackendTensor<B>) -> DispatchTensorKind,
    {
        let wrap = |tensor| DispatchTensor {
            kind: map_kind(BackendTensor::Float(tensor)),
            autodiff,
        };
        Inputs(self.0.into_iter().map(wrap).collect())
    }

    fn map_from_dispatch<F>(target: Self::Target, unwrap_kind: F) -> Self
    where
        F: Fn(DispatchTensor) -> BackendTensor<B>,
    {
        Self(target.0.into_iter().map(|tensor| unwrap_kind(tensor).float()).collect())
    }

    fn routing_tensor(target: &Self::Target) -> Option<&DispatchTensor> {
        target.0.first()
    }

    fn routing_float_tensor(target: &Self::Target) -> Option<&DispatchTensor> {
        target.0.first()
    }

    fn autodiff_context(target: &Self::Target) -> DispatchAutodiffContext {
        let contexts = target.0.iter().map(|tensor| tensor.autodiff);
        contexts.fold(DispatchAutodiffContext::Disabled, DispatchAutodiffContext::merge)
    }
}

/// Backends that can run a [`HostOperation`].
#[cfg_attr(feature = "gradients", backend_extension(Flex, Autodiff))]
#[cfg_attr(not(feature = "gradients"), backend_extension(Flex))]
trait Host: Backend {
    /// The result, of this shape. `keep`: whether gradients will be asked for.
    fn run<const N: usize>(
        #[extension_type] inputs: Inputs<Self>,
        operation: Arc<dyn HostOperation<N>>,
        shape: Vec<usize>,
        keep: bool,
    ) -> FloatTensor<Self>;
}

type CpuTensor = FloatTensor<Flex>;

/// The inputs of an operation, each in one piece.
fn contiguous<const N: usize>(inputs: &[CpuTensor]) -> [CpuTensor; N] {
    std::array::from_fn(|index| inputs[index].to_contiguous())
}

impl Host for Flex {
    fn run<const N: usize>(
        inputs: Inputs<Self>,
        operation: Arc<dyn HostOperation<N>>,
        shape: Vec<usize>,
        keep: bool,
    ) -> CpuTensor {
        let inputs = contiguous(&inputs.0);
        let inputs = inputs.each_ref().map(CpuTensor::storage);
        let values = if keep {
            operation.forward_kept(inputs)
        } else {
            operation.forward(inputs)
        };
        CpuTensor::from_data(TensorData::new(values, shape))
    }
}
