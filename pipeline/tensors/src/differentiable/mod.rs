//! Operations of the autodiff graph whose values and gradients are computed on host slices: what training on a CPU spends
//! its time with.
//!
//! An [`Operation`] is a pair of functions on slices; this module makes it a node of the framework's graph. It keeps its
//! inputs and computes again what it needs of the forward pass. Sums have a fixed order, whatever the number of threads.

mod attention;
mod convolution;
mod gelu;
mod layer_norm;
mod linear;
mod resize;
mod rotary;
mod sweep;

use std::fmt;
use std::sync::Arc;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients as Graph;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, backend_extension};
use burn::tensor::{DType, Tensor, TensorData};

use crate::device::is_cpu;

pub use attention::attention;
pub use convolution::convolve;
pub use gelu::gelu;
pub use layer_norm::layer_norm;
pub use linear::linear;
pub use resize::resize;
pub use rotary::rotate;
pub use sweep::sweep;

/// Inputs of an operation; those that it does not have are tensors of one number.
const INPUTS: usize = 3;

/// Gradients of the inputs, of those that are wanted.
type InputGradients = [Option<Vec<f32>>; INPUTS];

/// A differentiable function of host values.
trait Operation: fmt::Debug + Send + Sync {
    /// The result.
    fn forward(&self, inputs: [&[f32]; INPUTS]) -> Vec<f32>;

    /// Gradients of the wanted inputs, given that of the result.
    fn backward(&self, gradient: &[f32], inputs: [&[f32]; INPUTS], wanted: [bool; INPUTS]) -> InputGradients;
}

/// Whether these operations may be used on a tensor: f32 values that record gradients, on the CPU.
pub fn usable<const D: usize>(tensor: &Tensor<D>) -> bool {
    tensor.is_autodiff() && tensor.dtype() == DType::F32 && is_cpu(&tensor.device())
}

/// A node of one input.
fn of_one<const A: usize, const R: usize>(
    input: Tensor<A>,
    shape: [usize; R],
    operation: impl Operation + 'static,
) -> Tensor<R> {
    let none = || Tensor::<1>::zeros([1], &input.device());
    let (second, third) = (none(), none());
    of_three(input, second, third, shape, operation)
}

/// A node of three inputs; `shape` is that of the result.
fn of_three<const A: usize, const B: usize, const C: usize, const R: usize>(
    first: Tensor<A>,
    second: Tensor<B>,
    third: Tensor<C>,
    shape: [usize; R],
    operation: impl Operation + 'static,
) -> Tensor<R> {
    let result = <Dispatch as Host>::run(
        first.into_dispatch(),
        second.into_dispatch(),
        third.into_dispatch(),
        Arc::new(operation),
        shape.to_vec(),
    );
    Tensor::from_dispatch(result)
}

type Shared = Arc<dyn Operation>;

/// Backends that can run an [`Operation`].
#[backend_extension(Flex, Autodiff)]
trait Host: Backend {
    /// The result, of this shape.
    fn run(
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        third: FloatTensor<Self>,
        operation: Shared,
        shape: Vec<usize>,
    ) -> FloatTensor<Self>;
}

/// Gradients of [`Host`] on a backend that has them.
trait HostBackward: Backend {
    /// Gradients of the wanted inputs.
    fn gradients(
        gradient: FloatTensor<Self>,
        inputs: [FloatTensor<Self>; INPUTS],
        operation: &Shared,
        wanted: [bool; INPUTS],
    ) -> [Option<FloatTensor<Self>>; INPUTS];
}

type CpuTensor = FloatTensor<Flex>;

fn slice(tensor: &CpuTensor) -> &[f32] {
    tensor.as_slice::<f32>().unwrap_or_default()
}

impl Host for Flex {
    fn run(first: CpuTensor, second: CpuTensor, third: CpuTensor, operation: Shared, shape: Vec<usize>) -> CpuTensor {
        let inputs = [first, second, third].map(|input| input.to_contiguous());
        let values = operation.forward(inputs.each_ref().map(slice));
        CpuTensor::from_data(TensorData::new(values, shape))
    }
}

impl HostBackward for Flex {
    fn gradients(
        gradient: CpuTensor,
        inputs: [CpuTensor; INPUTS],
        operation: &Shared,
        wanted: [bool; INPUTS],
    ) -> [Option<CpuTensor>; INPUTS] {
        let gradient = gradient.to_contiguous();
        let shapes = inputs.each_ref().map(|input| input.layout().shape().clone());
        let inputs = inputs.map(|input| input.to_contiguous());
        let mut gradients = operation.backward(slice(&gradient), inputs.each_ref().map(slice), wanted);
        std::array::from_fn(|input| {
            let values = gradients[input].take().filter(|_| wanted[input])?;
            Some(CpuTensor::from_data(TensorData::new(values, shapes[input].clone())))
        })
    }
}

/// The backward pass of a node.
#[derive(Debug)]
struct Step;

/// What the backward pass needs.
#[derive(Clone)]
struct Saved<T> {
    inputs: [T; INPUTS],
    operation: Shared,
}

impl<T> fmt::Debug for Saved<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Saved")
            .field("operation", &self.operation)
            .finish_non_exhaustive()
    }
}

impl<B: HostBackward> Backward<B, INPUTS> for Step {
    type State = Saved<FloatTensor<B>>;

    fn backward(self, ops: Ops<Self::State, INPUTS>, graph: &mut Graph, _: &mut Checkpointer) {
        let gradient = graph.consume::<B>(&ops.node);
        let wanted = ops.parents.each_ref().map(Option::is_some);
        let Saved { inputs, operation } = ops.state;
        let gradients = B::gradients(gradient, inputs, &operation, wanted);
        for (parent, gradient) in ops.parents.into_iter().zip(gradients) {
            if let (Some(parent), Some(gradient)) = (parent, gradient) {
                graph.register::<B>(parent.id, gradient);
            }
        }
    }
}

impl<B: Host + HostBackward, C: CheckpointStrategy> Host for Autodiff<B, C> {
    fn run(
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        third: FloatTensor<Self>,
        operation: Shared,
        shape: Vec<usize>,
    ) -> FloatTensor<Self> {
        let nodes = [first.node(), second.node(), third.node()];
        let inputs = [first, second, third].map(|input| input.into_primitive());
        let [first, second, third] = inputs.clone();
        match Step.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prepared) => {
                let saved = Saved {
                    inputs,
                    operation: operation.clone(),
                };
                prepared.finish(saved, B::run(first, second, third, operation, shape))
            }
            OpsKind::UnTracked(prepared) => prepared.finish(B::run(first, second, third, operation, shape)),
        }
    }
}

#[cfg(test)]
mod tests;
