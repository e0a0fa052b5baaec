//! The 3x3 and the 1x1 convolution: forward by the direct kernel, gradients by the same kernel
//! with the weights turned round (input) and by [`weight_gradient`] and [`pointwise_gradient`] (weights).

use std::sync::Arc;

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::node::{HostOperation, node};
use rogs_kernels::lanes;
use rogs_kernels::{Conv3x3, Maps, Pointwise, Precision, pointwise_gradient, weight_gradient};

/// Taps of a kernel.
const TAPS: usize = 9;

/// Convolves the input, or its positive part if `rectify`. `input [B, in, H, W]`, `weight [out, in, 3, 3]`, `bias [out]`
pub fn convolve(input: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>, rectify: bool, products: Precision) -> Tensor<4> {
    let ([images, inputs, height, width], [outputs, ..]) = (input.dims(), weight.dims());
    let maps = Maps {
        inputs,
        outputs,
        height,
        width,
        rectify,
        products,
    };
    let inputs = [input.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()];
    node(inputs, [images, outputs, height, width], Arc::new(maps))
}

impl HostOperation<3> for Maps {
    fn forward(&self, [input, weight, bias]: [&[f32]; 3]) -> Vec<f32> {
        let conv = Conv3x3::new(weight, bias, self.outputs, self.inputs, self.products);
        let size = [self.height, self.width];
        conv.run(input, size, self.rectify, None)
    }

    fn backward(&self, gradient: &[f32], [input, weight, _]: [&[f32]; 3], wanted: [bool; 3]) -> [Option<Vec<f32>>; 3] {
        let size = [self.height, self.width];
        let of_input = wanted[0].then(|| {
            let turned = turned(weight, self.inputs, self.outputs);
            let conv = Conv3x3::new(&turned, &[], self.inputs, self.outputs, self.products);
            if self.rectify {
                conv.run_gated(gradient, size, input)
            } else {
                conv.run(gradient, size, false, None)
            }
        });
        let of_weight = wanted[1].then(|| weight_gradient(gradient, input, *self));
        let of_bias = wanted[2].then(|| of_bias(gradient, self.outputs, self.height * self.width));
        [of_input, of_weight, of_bias]
    }
}

/// Sums of the planes of every output over all images. `[B, out, area] -> [out]`
fn of_bias(gradient: &[f32], outputs: usize, area: usize) -> Vec<f32> {
    let planes: Vec<f64> = gradient.par_chunks_exact(area.max(1)).map(lanes::total).collect();
    let of = |output: usize| planes.iter().skip(output).step_by(outputs).sum::<f64>() as f32;
    (0..outputs).map(of).collect()
}

/// A 1x1 convolution.
#[derive(Debug)]
struct Pixels {
    outputs: usize,
    inputs: usize,
    size: [usize; 2],
    rectify: bool,
}

/// The 1x1 convolution of the input, or of its positive part if `rectify`. `input [B, in, H, W]`, `weight [out, in, 1, 1]`,
/// `bias [out]`
pub fn convolve_pixels(input: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>, rectify: bool) -> Tensor<4> {
    let ([images, inputs, height, width], [outputs, ..]) = (input.dims(), weight.dims());
    let operation = Pixels {
        outputs,
        inputs,
        size: [height, width],
        rectify,
    };
    let inputs = [input.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()];
    node(inputs, [images, outputs, height, width], Arc::new(operation))
}

impl HostOperation<3> for Pixels {
    fn forward(&self, [input, weight, bias]: [&[f32]; 3]) -> Vec<f32> {
        let conv = Pointwise::new(weight, bias, self.outputs, self.inputs);
        conv.run(input, self.size, self.rectify, None)
    }

    fn backward(&self, gradient: &[f32], [input, weight, _]: [&[f32]; 3], wanted: [bool; 3]) -> [Option<Vec<f32>>; 3] {
        let &Self {
            outputs,
            inputs,
            size,
            rectify,
        } = self;
        let area = size[0] * size[1];
        let back = || Pointwise::turned(weight, inputs, outputs).run(gradient, size, false, rectify.then_some(input));
        [
            wanted[0].then(back),
            wanted[1].then(|| pointwise_gradient(gradient, input, [outputs, inputs], area, rectify)),
            wanted[2].then(|| of_bias(gradient, outputs, area)),
        ]
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
