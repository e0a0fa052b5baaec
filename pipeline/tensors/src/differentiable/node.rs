//! A function of host values, with its gradients, as a node of the framework's graph.

use std::fmt;
use std::sync::Arc;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients as Graph;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{
    Autodiff, Backend, BackendTensor, Dispatch, DispatchAutodiffContext, DispatchTensor, DispatchTensorKind,
    ExtensionType, Flex, backend_extension,
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
#[backend_extension(Flex, Autodiff)]
trait Host: Backend {
    /// The result, of this shape. `keep`: whether gradients will be asked for.
    fn run<const N: usize>(
        #[extension_type] inputs: Inputs<Self>,
        operation: Arc<dyn HostOperation<N>>,
        shape: Vec<usize>,
        keep: bool,
    ) -> FloatTensor<Self>;
}

/// Gradients of [`Host`] on a backend that has them.
trait HostBackward: Backend {
    /// Gradients of the wanted inputs.
    fn gradients<const N: usize>(
        gradient: FloatTensor<Self>,
        inputs: &[FloatTensor<Self>],
        operation: &dyn HostOperation<N>,
        wanted: [bool; N],
    ) -> [Option<FloatTensor<Self>>; N];
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

impl HostBackward for Flex {
    fn gradients<const N: usize>(
        gradient: CpuTensor,
        inputs: &[CpuTensor],
        operation: &dyn HostOperation<N>,
        wanted: [bool; N],
    ) -> [Option<CpuTensor>; N] {
        let (gradient, values) = (gradient.to_contiguous(), contiguous(inputs));
        let values = values.each_ref().map(CpuTensor::storage);
        let mut gradients = operation.backward(gradient.storage(), values, wanted);
        std::array::from_fn(|input| {
            let values = gradients[input].take().filter(|_| wanted[input])?;
            let shape = inputs[input].layout().shape().clone();
            Some(CpuTensor::from_data(TensorData::new(values, shape)))
        })
    }
}

/// The backward pass of a node.
#[derive(Debug)]
struct Step;

/// What the backward pass needs.
#[derive(Clone)]
struct Saved<T, const N: usize> {
    inputs: Vec<T>,
    operation: Arc<dyn HostOperation<N>>,
}

impl<T, const N: usize> fmt::Debug for Saved<T, N> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Saved")
            .field("operation", &self.operation)
            .finish_non_exhaustive()
    }
}

impl<B: HostBackward, const N: usize> Backward<B, N> for Step {
    type State = Saved<FloatTensor<B>, N>;

    fn backward(self, ops: Ops<Self::State, N>, graph: &mut Graph, _: &mut Checkpointer) {
        let gradient = graph.consume::<B>(&ops.node);
        let wanted = ops.parents.each_ref().map(Option::is_some);
        let Saved { inputs, operation } = ops.state;
        let gradients = B::gradients(gradient, &inputs, &*operation, wanted);
        for (parent, gradient) in ops.parents.into_iter().zip(gradients) {
            if let (Some(parent), Some(gradient)) = (parent, gradient) {
                graph.register::<B>(parent.id, gradient);
            }
        }
    }
}

impl<B: Host + HostBackward, C: CheckpointStrategy> Host for Autodiff<B, C> {
    fn run<const N: usize>(
        inputs: Inputs<Self>,
        operation: Arc<dyn HostOperation<N>>,
        shape: Vec<usize>,
        keep: bool,
    ) -> FloatTensor<Self> {
        let nodes = std::array::from_fn::<_, N, _>(|index| inputs.0[index].node());
        let inputs: Vec<_> = inputs.0.into_iter().map(|input| input.into_primitive()).collect();
        let run = |keep| B::run(Inputs(inputs.clone()), operation.clone(), shape, keep);
        match Step.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prepared) => {
                let result = run(true);
                prepared.finish(Saved { inputs, operation }, result)
            }
            OpsKind::UnTracked(prepared) => prepared.finish(run(keep)),
        }
    }
}
