//! x W^T + b.

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::{INPUTS, InputGradients, Operation, of_three};
use rogs_kernels::products::product;
use rogs_kernels::transposed;
use rogs_kernels::{PackedWeight, Precision};

/// Rows of the weight whose gradient is one task.
const TASK_OUTPUTS: usize = 96;

#[derive(Debug)]
struct Layer {
    inputs: usize,
    outputs: usize,
    /// Numbers that products are made of.
    products: Precision,
}

/// The layer on the last dimension. `[..., in] -> [..., out]`, `weight [out, in]`, `bias [out]`
pub fn linear<const D: usize>(input: Tensor<D>, weight: Tensor<2>, bias: Tensor<1>, products: Precision) -> Tensor<D> {
    let [outputs, inputs] = weight.dims();
    let mut shape = input.dims();
    shape[D - 1] = outputs;
    let layer = Layer {
        inputs,
        outputs,
        products,
    };
    of_three(input, weight, bias, shape, layer)
}

impl Operation for Layer {
    fn forward(&self, [input, weight, bias]: [&[f32]; INPUTS]) -> Vec<f32> {
        PackedWeight::new(weight, self.inputs, self.products).apply(
            input,
            #[inline(always)]
            |_, column, values| {
                for (value, bias) in values.iter_mut().zip(&bias[column..]) {
                    *value += bias;
                }
            },
        )
    }

    fn backward(
        &self,
        gradient: &[f32],
        [input, weight, _]: [&[f32]; INPUTS],
        wanted: [bool; INPUTS],
    ) -> InputGradients {
        let &Self {
            inputs,
            outputs,
            products,
        } = self;
        let rows = gradient.len() / outputs.max(1);
        let of_input = wanted[0].then(|| {
            let turned = PackedWeight::strided(weight, [inputs, outputs], [1, inputs], products);
            turned.apply(gradient, |_, _, _| {})
        });
        let of_weight = wanted[1].then(|| match products {
            Precision::F32 => {
                let mut sums = vec![0.0f32; outputs * inputs];
                sums.par_chunks_mut((TASK_OUTPUTS * inputs).max(1))
                    .enumerate()
                    .for_each(|(task, sums)| {
                        let sizes = [sums.len() / inputs, inputs, rows];
                        let gradient = &gradient[task * TASK_OUTPUTS..];
                        product(sizes, (sums, inputs, false), (gradient, 1, outputs), (input, inputs, 1));
                    });
                sums
            }
            Precision::Bf16 => {
                let input = PackedWeight::strided(input, [inputs, rows], [1, inputs], products);
                input.apply(&transposed(gradient, rows, |value| value), |_, _, _| {})
            }
        });
        let of_bias = wanted[2].then(|| {
            let mut sums = vec![0.0f64; outputs];
            for row in gradient.chunks_exact(outputs) {
                sums.iter_mut()
                    .zip(row)
                    .for_each(|(sum, &value)| *sum += f64::from(value));
            }
            sums.into_iter().map(|sum| sum as f32).collect()
        });
        [of_input, of_weight, of_bias]
    }
}
