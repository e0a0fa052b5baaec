//! The 3x3 convolution as an operation of the autodiff graph: forward by the direct kernel, gradients by the same kernel
//! with the weights turned round (input) and by matrix products over bands of rows (weights).

use std::fmt;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients as Graph;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, backend_extension};
use burn::tensor::{DType, Tensor, TensorData};
use gemm::Parallelism;
use rayon::prelude::*;

use super::conv::{After, Conv3x3};

/// Taps of a kernel.
const TAPS: usize = 9;
/// Floats of the rows that one matrix product of the weights' gradient reads.
const BAND_FLOATS: usize = 128 << 10;

/// Sizes of a call: images, inputs, outputs, height, width.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sizes {
    images: usize,
    inputs: usize,
    outputs: usize,
    height: usize,
    width: usize,
}

impl Sizes {
    fn area(&self) -> usize {
        self.height * self.width
    }
}

/// Convolution with stride 1 and padding 1. `input [B, in, H, W]`, `weight [out, in, 3, 3]`, `bias [out]`
#[backend_extension(Flex, Autodiff)]
pub(crate) trait Convolve: Backend {
    /// The result, `[B, out, H, W]`.
    fn convolve(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        sizes: Sizes,
    ) -> FloatTensor<Self>;
}

/// Gradients of [`Convolve`] on a backend that has them.
pub(crate) trait ConvolveBackward: Backend {
    /// Gradients with respect to input, weight and bias, those that are wanted.
    fn gradients(
        gradient: FloatTensor<Self>,
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        sizes: Sizes,
        wanted: [bool; 3],
    ) -> [Option<FloatTensor<Self>>; 3];
}

/// Whether [`convolve`] may be used: f32 values that record gradients, on the CPU.
pub(crate) fn usable(input: &Tensor<4>, weight: &Tensor<4>) -> bool {
    let on_cpu = |tensor: &Tensor<4>| {
        tensor.dtype() == DType::F32
            && (tensor.device() == burn::tensor::Device::flex()
                || tensor.device() == burn::tensor::Device::flex().autodiff())
    };
    input.is_autodiff() && weight.is_autodiff() && on_cpu(input) && on_cpu(weight)
}

/// Convolves with gradients. `input [B, in, H, W]`, `weight [out, in, 3, 3]`, `bias [out]`
pub(crate) fn convolve(input: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    let ([images, inputs, height, width], [outputs, ..]) = (input.dims(), weight.dims());
    let sizes = Sizes {
        images,
        inputs,
        outputs,
        height,
        width,
    };
    let result = <Dispatch as Convolve>::convolve(
        input.into_dispatch(),
        weight.into_dispatch(),
        bias.into_dispatch(),
        sizes,
    );
    Tensor::from_dispatch(result)
}

type Host = FloatTensor<Flex>;

impl Convolve for Flex {
    fn convolve(input: Host, weight: Host, bias: Host, sizes: Sizes) -> Host {
        let (input, weight, bias) = (input.to_contiguous(), weight.to_contiguous(), bias.to_contiguous());
        let conv = Conv3x3::new(slice(&weight), slice(&bias), sizes.outputs, sizes.inputs);
        let values = conv.run(slice(&input), [sizes.height, sizes.width], false, After::Nothing, None);
        host(values, vec![sizes.images, sizes.outputs, sizes.height, sizes.width])
    }
}

impl ConvolveBackward for Flex {
    fn gradients(gradient: Host, input: Host, weight: Host, sizes: Sizes, wanted: [bool; 3]) -> [Option<Host>; 3] {
        let (gradient, input, weight) = (gradient.to_contiguous(), input.to_contiguous(), weight.to_contiguous());
        let (gradient, input, weight) = (slice(&gradient), slice(&input), slice(&weight));
        let Sizes {
            images,
            inputs,
            outputs,
            height,
            width,
        } = sizes;
        let of_input = wanted[0].then(|| {
            let conv = Conv3x3::new(&turned(weight, inputs, outputs), &[], inputs, outputs);
            let values = conv.run(gradient, [height, width], false, After::Nothing, None);
            host(values, vec![images, inputs, height, width])
        });
        let of_weight = wanted[1].then(|| {
            let values = weight_gradient(gradient, input, sizes);
            host(values, vec![outputs, inputs, 3, 3])
        });
        let of_bias = wanted[2].then(|| {
            let mut sums = vec![0.0f64; outputs];
            for (plane, values) in gradient.chunks_exact(sizes.area().max(1)).enumerate() {
                sums[plane % outputs] += values.iter().map(|&value| f64::from(value)).sum::<f64>();
            }
            host(sums.into_iter().map(|sum| sum as f32).collect(), vec![outputs])
        });
        [of_input, of_weight, of_bias]
    }
}

/// Weights of the convolution that takes gradients back: inputs and outputs exchanged, taps in reverse order.
fn turned(weight: &[f32], inputs: usize, outputs: usize) -> Vec<f32> {
    let mut turned = vec![0.0; weight.len()];
    for output in 0..outputs {
        for input in 0..inputs {
            for tap in 0..TAPS {
                turned[(input * outputs + output) * TAPS + TAPS - 1 - tap] =
                    weight[(output * inputs + input) * TAPS + tap];
            }
        }
    }
    turned
}

/// Gradient of the weights: for bands of rows, the product of the gradient `[out, pixels]` with the shifted inputs
/// `[in * 9, pixels]` transposed. Bands do not depend on the threads and are added up in order.
fn weight_gradient(gradient: &[f32], input: &[f32], sizes: Sizes) -> Vec<f32> {
    let Sizes {
        images,
        inputs,
        outputs,
        height,
        width,
    } = sizes;
    let (area, columns) = (sizes.area(), inputs * TAPS);
    let rows = (BAND_FLOATS / (columns * width).max(1)).clamp(1, height.max(1));
    let bands = height.div_ceil(rows);
    let partial: Vec<Vec<f32>> = (0..images * bands)
        .into_par_iter()
        .map(|task| {
            let (image, first) = (task / bands, (task % bands) * rows);
            let count = rows.min(height - first);
            let pixels = count * width;
            let shifted = shifted(&input[image * inputs * area..][..inputs * area], sizes, first, count);
            let gradient = &gradient[image * outputs * area + first * width..];
            let mut sums = vec![0.0f32; outputs * columns];
            let sizes = [outputs, columns, pixels];
            product(sizes, &mut sums, columns, (gradient, area, 1), (&shifted, 1, pixels));
            sums
        })
        .collect();
    let mut sum = vec![0.0f32; outputs * columns];
    for sums in partial {
        sum.iter_mut().zip(sums).for_each(|(sum, value)| *sum += value);
    }
    sum
}

/// What every tap sees of a band of rows. `[in * 9, rows * width]`
fn shifted(input: &[f32], sizes: Sizes, first: usize, count: usize) -> Vec<f32> {
    let (width, height) = (sizes.width, sizes.height);
    let mut out = vec![0.0f32; sizes.inputs * TAPS * count * width];
    for (line, out) in out.chunks_exact_mut(count * width).enumerate() {
        let (channel, tap) = (line / TAPS, line % TAPS);
        let plane = &input[channel * height * width..][..height * width];
        let (below, right) = (tap / 3, tap % 3);
        for (row, out) in out.chunks_exact_mut(width).enumerate() {
            let Some(y) = (first + row + below).checked_sub(1).filter(|&y| y < height) else {
                continue;
            };
            let source = &plane[y * width..(y + 1) * width];
            match right {
                0 => out[1..].copy_from_slice(&source[..width - 1]),
                1 => out.copy_from_slice(source),
                _ => out[..width - 1].copy_from_slice(&source[1..]),
            }
        }
    }
    out
}

/// The backward pass of the graph.
#[derive(Debug)]
struct ConvolveStep;

/// What the backward pass needs.
#[derive(Clone)]
struct Saved<T> {
    input: T,
    weight: T,
    sizes: Sizes,
}

impl<T> fmt::Debug for Saved<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Saved")
            .field("sizes", &self.sizes)
            .finish_non_exhaustive()
    }
}

impl<B: ConvolveBackward> Backward<B, 3> for ConvolveStep {
    type State = Saved<FloatTensor<B>>;

    fn backward(self, ops: Ops<Self::State, 3>, graph: &mut Graph, _: &mut Checkpointer) {
        let gradient = graph.consume::<B>(&ops.node);
        let wanted = ops.parents.each_ref().map(Option::is_some);
        let Saved { input, weight, sizes } = ops.state;
        let gradients = B::gradients(gradient, input, weight, sizes, wanted);
        for (parent, gradient) in ops.parents.into_iter().zip(gradients) {
            if let (Some(parent), Some(gradient)) = (parent, gradient) {
                graph.register::<B>(parent.id, gradient);
            }
        }
    }
}

impl<B: Convolve + ConvolveBackward, C: CheckpointStrategy> Convolve for Autodiff<B, C> {
    fn convolve(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        sizes: Sizes,
    ) -> FloatTensor<Self> {
        let nodes = [input.node(), weight.node(), bias.node()];
        let (input, weight, bias) = (input.into_primitive(), weight.into_primitive(), bias.into_primitive());
        match ConvolveStep.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prepared) => {
                let saved = Saved {
                    input: input.clone(),
                    weight: weight.clone(),
                    sizes,
                };
                prepared.finish(saved, B::convolve(input, weight, bias, sizes))
            }
            OpsKind::UnTracked(prepared) => prepared.finish(B::convolve(input, weight, bias, sizes)),
        }
    }
}

fn slice(tensor: &Host) -> &[f32] {
    tensor.as_slice::<f32>().unwrap_or_default()
}

fn host(values: Vec<f32>, shape: Vec<usize>) -> Host {
    Host::from_data(TensorData::new(values, shape))
}

/// out [m, n] = lhs [m, k] rhs [k, n]; operands come with their row and column strides, `out` with its row stride.
// The gemm crate takes pointers. Every index it forms is checked against the slices first.
#[allow(unsafe_code)]
fn product(
    [m, n, k]: [usize; 3],
    out: &mut [f32],
    out_stride: usize,
    (lhs, lhs_rows, lhs_columns): (&[f32], usize, usize),
    (rhs, rhs_rows, rhs_columns): (&[f32], usize, usize),
) {
    if m == 0 || n == 0 || k == 0 {
        return;
    }
    assert!((m - 1) * out_stride + n <= out.len());
    assert!((m - 1) * lhs_rows + (k - 1) * lhs_columns < lhs.len());
    assert!((k - 1) * rhs_rows + (n - 1) * rhs_columns < rhs.len());
    // SAFETY: the largest offset of each operand is inside its slice (asserted above), `out` is borrowed exclusively, and
    // without `read_dst` its old values are not read.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.as_mut_ptr(),
            1,
            out_stride as isize,
            false,
            lhs.as_ptr(),
            lhs_columns as isize,
            lhs_rows as isize,
            rhs.as_ptr(),
            rhs_columns as isize,
            rhs_rows as isize,
            0.0f32,
            1.0f32,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::module;
    use burn::tensor::ops::ConvOptions;
    use burn::tensor::{Device, Tensor};

    use super::*;
    use crate::parameters::{from_host, to_host};

    fn noise<const D: usize>(shape: [usize; D], seed: usize, device: &Device) -> Tensor<D> {
        let count = shape.iter().product::<usize>();
        let values = (0..count).map(|k| (((k * 7919 + seed * 104_729) % 1009) as f32 / 504.5) - 1.0);
        from_host(values.collect(), shape, device).require_grad()
    }

    /// Against the framework's own convolution.
    #[test]
    fn values_and_gradients_equal_those_of_the_framework() {
        let device = Device::flex().autodiff();
        for [images, inputs, outputs, height, width] in [[1, 1, 1, 1, 1], [2, 3, 5, 7, 33], [3, 16, 9, 40, 19]] {
            let (input, weight, bias) = (
                noise([images, inputs, height, width], 1, &device),
                noise([outputs, inputs, 3, 3], 2, &device),
                noise([outputs], 3, &device),
            );
            let slope = noise([images, outputs, height, width], 4, &device).detach();
            assert!(usable(&input, &weight));
            let own = convolve(input.clone(), weight.clone(), bias.clone());
            let options = ConvOptions::new([1, 1], [1, 1], [1, 1], 1);
            let other = module::conv2d(input.clone(), weight.clone(), Some(bias.clone()), options);
            let close = |a: Vec<f32>, b: Vec<f32>, what: &str| {
                assert_eq!(a.len(), b.len());
                let size = b.iter().fold(1.0f32, |size, value| size.max(value.abs()));
                for (a, b) in a.iter().zip(&b) {
                    // The framework adds thousands of products one after the other in f32.
                    assert!((a - b).abs() < 1e-4 * size, "{what}: {a} {b}");
                }
            };
            close(to_host(own.clone()).unwrap(), to_host(other.clone()).unwrap(), "value");
            let (own, other) = ((own * slope.clone()).sum().backward(), (other * slope).sum().backward());
            let grad = |tensor: &Tensor<4>, of| to_host(tensor.grad(of).unwrap()).unwrap();
            close(grad(&input, &own), grad(&input, &other), "input");
            close(grad(&weight, &own), grad(&weight, &other), "weight");
            let grad = |of| to_host(bias.grad(of).unwrap()).unwrap();
            close(grad(&own), grad(&other), "bias");
        }
    }
}
