//! Bilinear resampling of maps.

use burn::tensor::ops::{InterpolateMode, InterpolateOptions};
use burn::tensor::{Tensor, module};

use crate::differentiable;
use crate::parameters::from_host;
use rogs_kernels::Axis;

/// Bilinear resampling that keeps the corner pixel centres in place (align_corners = true).
/// `[B, c, h, w] -> [B, c, height, width]`
#[must_use]
pub fn resize(input: Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4> {
    let [_, _, rows, columns] = input.dims();
    if [rows, columns] == [height, width] {
        return input;
    }
    if differentiable::usable(&input) {
        return differentiable::resize(input, [height, width]);
    }
    if input.is_autodiff() {
        return by_products(input, [height, width]);
    }
    let options = InterpolateOptions::new(InterpolateMode::Bilinear).with_align_corners(true);
    module::interpolate(input, options.with_output_size([height, width]))
}

/// The same as products with constant matrices: the framework has no gradient of its own resampling on GPUs.
fn by_products(input: Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4> {
    let ([images, channels, rows, columns], device) = (input.dims(), input.device());
    let matrix = |inputs: usize, outputs: usize| -> Tensor<3> {
        from_host(Axis::new(inputs, outputs).matrix(), [1, outputs, inputs], &device)
    };
    let wide = input
        .reshape([1, images * channels * rows, columns])
        .matmul(matrix(columns, width).swap_dims(1, 2))
        .reshape([images * channels, rows, width]);
    matrix(rows, height)
        .matmul(wide)
        .reshape([images, channels, height, width])
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::parameters::to_host;

    /// Against the operation of the CPU: values, and gradients under the same slopes.
    #[test]
    fn products_resample_like_the_kernel() {
        let device = Device::flex().autodiff();
        let noise = |shape: [usize; 4], seed: usize| -> Tensor<4> {
            let value = |k: usize| ((k * 7919 + seed * 104_729) % 1009) as f32 / 504.5 - 1.0;
            from_host((0..shape.iter().product()).map(value).collect(), shape, &device)
        };
        for [rows, columns, height, width] in [
            [5, 7, 9, 14],
            [9, 14, 5, 7],
            [4, 6, 4, 11],
            [3, 3, 1, 1],
            [1, 1, 3, 4],
            [1, 5, 6, 1],
            [2, 1, 1, 2],
        ] {
            let input = noise([2, 3, rows, columns], 1).require_grad();
            let slopes = noise([2, 3, height, width], 2);
            let of = |output: Tensor<4>| {
                let gradients = (output.clone() * slopes.clone()).sum().backward();
                [output, input.grad(&gradients).unwrap()].map(|map| to_host(map).unwrap())
            };
            let found = of(by_products(input.clone(), [height, width]));
            let expected = of(differentiable::resize(input.clone(), [height, width]));
            for (found, expected) in found.into_iter().zip(expected) {
                assert_eq!(found.len(), expected.len());
                for (a, b) in found.into_iter().zip(expected) {
                    // Sums of at most a few numbers around one.
                    assert!(
                        (a - b).abs() < 1e-5,
                        "{rows} x {columns} to {height} x {width}: {a} {b}"
                    );
                }
            }
        }
    }
}
