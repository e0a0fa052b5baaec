//! The 3x3 convolution: forward by the direct kernel, gradients by the same kernel
//! with the weights turned round (input) and by matrix products over bands of rows (weights).

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::products::product;
use super::{INPUTS, InputGradients, Operation, of_three};
use crate::kernels::{After, Conv3x3};

/// Taps of a kernel.
const TAPS: usize = 9;
/// Floats of the rows that one matrix product of the weights' gradient reads.
const BAND_FLOATS: usize = 128 << 10;

/// A convolution with stride 1 and padding 1, and the sizes of a call.
#[derive(Debug, Clone, Copy)]
struct Sizes {
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

/// Convolves. `input [B, in, H, W]`, `weight [out, in, 3, 3]`, `bias [out]`
pub(crate) fn convolve(input: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    let ([images, inputs, height, width], [outputs, ..]) = (input.dims(), weight.dims());
    let sizes = Sizes {
        images,
        inputs,
        outputs,
        height,
        width,
    };
    of_three(input, weight, bias, [images, outputs, height, width], sizes)
}

impl Operation for Sizes {
    fn forward(&self, [input, weight, bias]: [&[f32]; INPUTS]) -> Vec<f32> {
        let conv = Conv3x3::new(weight, bias, self.outputs, self.inputs);
        conv.run(input, [self.height, self.width], false, After::Nothing, None)
    }

    fn backward(
        &self,
        gradient: &[f32],
        [input, weight, _]: [&[f32]; INPUTS],
        wanted: [bool; INPUTS],
    ) -> InputGradients {
        let of_input = wanted[0].then(|| {
            let conv = Conv3x3::new(
                &turned(weight, self.inputs, self.outputs),
                &[],
                self.inputs,
                self.outputs,
            );
            conv.run(gradient, [self.height, self.width], false, After::Nothing, None)
        });
        let of_weight = wanted[1].then(|| weight_gradient(gradient, input, *self));
        let of_bias = wanted[2].then(|| {
            let mut sums = vec![0.0f64; self.outputs];
            for (plane, values) in gradient.chunks_exact(self.area().max(1)).enumerate() {
                sums[plane % self.outputs] += values.iter().map(|&value| f64::from(value)).sum::<f64>();
            }
            sums.into_iter().map(|sum| sum as f32).collect()
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
            product(
                sizes,
                (&mut sums, columns, false),
                (gradient, area, 1),
                (&shifted, 1, pixels),
            );
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
