//! x W^T + b.

use std::sync::Arc;

use burn::tensor::Tensor;

use super::node::{HostOperation, node};
use rogs_kernels::lanes;
use rogs_kernels::pointwise::add_assign;
use rogs_kernels::{Matrix, PackedWeight, Precision};

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
    let inputs = [input.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()];
    node(inputs, shape, Arc::new(layer))
}

impl HostOperation<3> for Layer {
    fn forward(&self, [input, weight, bias]: [&[f32]; 3]) -> Vec<f32> {
        PackedWeight::new(weight, self.inputs, self.products).apply(
            input,
            #[inline(always)]
            |_, column, values| add_assign(values, &bias[column..]),
        )
    }

    fn backward(&self, gradient: &[f32], [input, weight, _]: [&[f32]; 3], wanted: [bool; 3]) -> [Option<Vec<f32>>; 3] {
        let &Self {
            inputs,
            outputs,
            products,
        } = self;
        let of_input = wanted[0].then(|| {
            let turned = PackedWeight::of(Matrix::new(weight, inputs).transposed(), products);
            turned.apply(gradient, |_, _, _| {})
        });
        let of_weight = wanted[1].then(|| {
            let input = PackedWeight::of(Matrix::new(input, inputs).transposed(), products);
            input.apply_to(Matrix::new(gradient, outputs).transposed(), |_, _, _| {})
        });
        let of_bias = wanted[2].then(|| {
            let mut sums = vec![0.0f64; outputs];
            lanes::add_rows(gradient, &mut sums);
            sums.into_iter().map(|sum| sum as f32).collect()
        });
        [of_input, of_weight, of_bias]
    }
}
