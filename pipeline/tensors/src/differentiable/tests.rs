//! Every operation against the framework's own.

use burn::tensor::ops::{AttentionModuleOptions, ConvOptions, InterpolateMode, InterpolateOptions};
use burn::tensor::{Device, Tensor, activation, module};

use super::*;
use crate::ops::Rotary;
use crate::parameters::{from_host, to_host};
use rogs_kernels::Precision;
use rogs_kernels::RotaryTable;

fn noise<const D: usize>(shape: [usize; D], seed: usize) -> Tensor<D> {
    let count = shape.iter().product::<usize>();
    let values = (0..count).map(|k| (((k * 7919 + seed * 104_729) % 1009) as f32 / 504.5) - 1.0);
    from_host(values.collect(), shape, &Device::flex().autodiff()).require_grad()
}

fn close(own: Vec<f32>, other: Vec<f32>, what: &str) {
    assert_eq!(own.len(), other.len(), "{what}");
    let size = other.iter().fold(1.0f32, |size, value| size.max(value.abs()));
    for (a, b) in own.iter().zip(&other) {
        // The framework adds thousands of products one after the other in f32.
        assert!((a - b).abs() < 1e-4 * size, "{what}: {a} {b}");
    }
}

/// Reads the gradient of a tensor.
type GradientOf<'a> = &'a dyn Fn(&burn::tensor::Gradients) -> Vec<f32>;

/// Compares two results, and the gradients of their inputs under the same slopes.
fn same<const R: usize>(own: Tensor<R>, other: Tensor<R>, inputs: &[(&str, GradientOf<'_>)]) {
    close(to_host(own.clone()).unwrap(), to_host(other.clone()).unwrap(), "value");
    let slope = noise(own.dims(), 99).detach();
    let (own, other) = ((own * slope.clone()).sum().backward(), (other * slope).sum().backward());
    for (what, gradient) in inputs {
        close(gradient(&own), gradient(&other), what);
    }
}

fn of<const D: usize>(tensor: &Tensor<D>) -> impl Fn(&burn::tensor::Gradients) -> Vec<f32> {
    let tensor = tensor.clone();
    move |gradients| to_host(tensor.grad(gradients).unwrap()).unwrap()
}

#[test]
fn convolutions_equal_those_of_the_framework() {
    for [images, inputs, outputs, height, width] in [[1, 1, 1, 1, 1], [2, 3, 5, 7, 33], [3, 16, 9, 40, 19]] {
        let input = noise([images, inputs, height, width], 1);
        let (weight, bias) = (noise([outputs, inputs, 3, 3], 2), noise([outputs], 3));
        assert!(usable(&input) && usable(&weight));
        for rectify in [false, true] {
            let options = ConvOptions::new([1, 1], [1, 1], [1, 1], 1);
            let seen = if rectify {
                activation::relu(input.clone())
            } else {
                input.clone()
            };
            same(
                convolve(input.clone(), weight.clone(), bias.clone(), rectify, Precision::F32),
                module::conv2d(seen, weight.clone(), Some(bias.clone()), options),
                &[("input", &of(&input)), ("weight", &of(&weight)), ("bias", &of(&bias))],
            );
        }
    }
}

#[test]
fn convolutions_of_pixels_equal_those_of_the_framework() {
    for [images, inputs, outputs, height, width] in [[1, 1, 1, 1, 1], [2, 3, 5, 7, 33], [3, 16, 9, 40, 19]] {
        let input = noise([images, inputs, height, width], 1);
        let (weight, bias) = (noise([outputs, inputs, 1, 1], 2), noise([outputs], 3));
        for rectify in [false, true] {
            let options = ConvOptions::new([1, 1], [0, 0], [1, 1], 1);
            let seen = if rectify {
                activation::relu(input.clone())
            } else {
                input.clone()
            };
            same(
                convolve_pixels(input.clone(), weight.clone(), bias.clone(), rectify),
                module::conv2d(seen, weight.clone(), Some(bias.clone()), options),
                &[("input", &of(&input)), ("weight", &of(&weight)), ("bias", &of(&bias))],
            );
        }
    }
}

#[test]
fn linear_layers_equal_those_of_the_framework() {
    for [batch, rows, inputs, outputs] in [[1, 1, 1, 1], [2, 7, 33, 40], [3, 150, 64, 200]] {
        let (input, weight, bias) = (
            noise([batch, rows, inputs], 1),
            noise([outputs, inputs], 2),
            noise([outputs], 3),
        );
        let other = input
            .clone()
            .reshape([batch * rows, inputs])
            .matmul(weight.clone().transpose())
            + bias.clone().unsqueeze();
        same(
            linear(input.clone(), weight.clone(), bias.clone(), Precision::F32),
            other.reshape([batch, rows, outputs]),
            &[("input", &of(&input)), ("weight", &of(&weight)), ("bias", &of(&bias))],
        );
    }
}

/// Values and slopes that bfloat16 holds exactly, so that only the order of sums differs from products in f32.
#[test]
fn products_of_bfloat16_equal_those_of_f32_on_its_own_numbers() {
    fn coarse<const D: usize>(shape: [usize; D], seed: usize) -> Tensor<D> {
        let count = shape.iter().product::<usize>();
        let values = (0..count).map(|k| ((k * 7919 + seed * 104_729) % 1009 % 129) as f32 / 64.0 - 1.0);
        from_host(values.collect(), shape, &Device::flex().autodiff()).require_grad()
    }
    fn both<const R: usize>(run: impl Fn(Precision) -> Tensor<R>, inputs: &[(&str, GradientOf<'_>)]) {
        let (own, other) = (run(Precision::Bf16), run(Precision::F32));
        close(to_host(own.clone()).unwrap(), to_host(other.clone()).unwrap(), "value");
        let slope = coarse(own.dims(), 99).detach();
        let (own, other) = ((own * slope.clone()).sum().backward(), (other * slope).sum().backward());
        for (what, gradient) in inputs {
            close(gradient(&own), gradient(&other), what);
        }
    }
    for [rows, inputs, outputs] in [[1, 1, 1], [7, 33, 40], [450, 64, 200]] {
        let (input, weight, bias) = (
            coarse([rows, inputs], 1),
            coarse([outputs, inputs], 2),
            coarse([outputs], 3),
        );
        both(
            |products| linear(input.clone(), weight.clone(), bias.clone(), products),
            &[("input", &of(&input)), ("weight", &of(&weight)), ("bias", &of(&bias))],
        );
    }
    for [images, inputs, outputs, height, width] in [[1, 1, 1, 1, 1], [2, 3, 5, 7, 33], [3, 16, 9, 40, 19]] {
        let input = coarse([images, inputs, height, width], 1);
        let (weight, bias) = (coarse([outputs, inputs, 3, 3], 2), coarse([outputs], 3));
        both(
            |products| convolve(input.clone(), weight.clone(), bias.clone(), true, products),
            &[("input", &of(&input)), ("weight", &of(&weight)), ("bias", &of(&bias))],
        );
    }
}

#[test]
fn gelu_equals_that_of_the_framework() {
    let input = noise([3, 5, 41], 1) * 4.0;
    let input = input.detach().require_grad();
    same(
        gelu(input.clone()),
        activation::gelu(input.clone()),
        &[("input", &of(&input))],
    );
}

#[test]
fn layer_norms_equal_those_of_the_framework() {
    for size in [3, 16, 70] {
        let (input, weight, bias) = (noise([3, 50, size], 1), noise([size], 2), noise([size], 3));
        same(
            layer_norm(input.clone(), weight.clone(), bias.clone(), 1e-5),
            module::layer_norm(input.clone(), weight.clone(), Some(bias.clone()), 1e-5),
            &[("input", &of(&input)), ("weight", &of(&weight)), ("bias", &of(&bias))],
        );
    }
}

#[test]
fn attention_equals_that_of_the_framework() {
    for tokens in [1, 5, 300] {
        let shape = [2, 3, tokens, 8];
        let [query, key, value] = [1, 2, 3].map(|seed| noise(shape, seed));
        same(
            attention(query.clone(), key.clone(), value.clone()),
            module::attention(
                query.clone(),
                key.clone(),
                value.clone(),
                None,
                None,
                AttentionModuleOptions::default(),
            ),
            &[("query", &of(&query)), ("key", &of(&key)), ("value", &of(&value))],
        );
    }
}

#[test]
fn resampling_equals_that_of_the_framework() {
    for [rows, columns, height, width] in [[5, 7, 9, 14], [9, 14, 5, 7], [4, 6, 4, 11], [3, 3, 1, 1]] {
        let input = noise([2, 3, rows, columns], 1);
        let options = InterpolateOptions::new(InterpolateMode::Bilinear).with_align_corners(true);
        same(
            resize(input.clone(), [height, width]),
            module::interpolate(input.clone(), options.with_output_size([height, width])),
            &[("input", &of(&input))],
        );
    }
}

#[test]
fn rotation_equals_the_formula_on_tensors() {
    let positions = [[0, 0], [0, 0], [1, 1], [1, 2], [1, 3], [2, 1], [2, 2], [2, 3]];
    let rotary = Rotary::new(RotaryTable::new(&positions, 8), &Device::flex().autodiff()).repeated(2);
    let input = noise([2, 3, 16, 8], 1);
    same(
        rotate(input.clone(), rotary.table().clone()),
        rotary.apply_on_tensors(input.clone()),
        &[("input", &of(&input))],
    );
}
