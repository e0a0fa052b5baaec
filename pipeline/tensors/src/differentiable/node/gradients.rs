//! The node's place in the graph of gradients.

use std::fmt;
use std::sync::Arc;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients as Graph;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex};
use burn::tensor::TensorData;

use super::{CpuTensor, Host, HostOperation, Inputs, contiguous};

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
