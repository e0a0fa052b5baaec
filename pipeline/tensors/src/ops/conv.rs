//! 2-D convolutions.

use std::sync::{Arc, OnceLock};

use burn::tensor::ops::ConvOptions;
use burn::tensor::{Tensor, module};
use rogs_kernels::{Conv3x3, Matrix, PackedWeight, Precision, TileSize, Winograd};

use super::relu;
use crate::parameters::{Scope, from_host};
use crate::{Result, differentiable, host};

/// 2-D convolution weights.
#[derive(Debug, Clone)]
pub struct Conv {
    /// `[out, in, k, k]`
    pub weight: Tensor<4>,
    /// `[out]`
    pub bias: Option<Tensor<1>>,
    stride: usize,
    padding: usize,
    /// Numbers that products are made of while gradients are recorded.
    products: Precision,
    /// The weights as the CPU kernel takes them, made when first needed.
    packed: Arc<OnceLock<Conv3x3>>,
    /// The same for Winograd's algorithm; `None` inside where the layer is too narrow to gain from it.
    tiled: Arc<OnceLock<Option<Winograd>>>,
}

/// Channels from which Winograd's algorithm pays.
const WIDE: usize = 64;

impl Conv {
    /// Reads a `kernel x kernel` convolution padded to keep its size (before the stride).
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load(scope: &Scope<'_>, [outputs, inputs]: [usize; 2], kernel: usize, stride: usize) -> Result<Self> {
        let bias = Some(scope.get("bias", [outputs])?);
        Ok(Self {
            bias,
            ..Self::load_unbiased(scope, [outputs, inputs], kernel, stride)?
        })
    }

    /// The same without a bias.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load_unbiased(
        scope: &Scope<'_>,
        [outputs, inputs]: [usize; 2],
        kernel: usize,
        stride: usize,
    ) -> Result<Self> {
        let weight = scope.get("weight", [outputs, inputs, kernel, kernel])?;
        Ok(Self {
            weight,
            bias: None,
            stride,
            padding: kernel / 2,
            products: scope.products(),
            packed: Arc::default(),
            tiled: Arc::default(),
        })
    }

    /// Applies the convolution. `[B, in, H, W] -> [B, out, H', W']`
    #[must_use]
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        if self.has_kernel(&input) {
            self.by_kernel(&input, false, None)
        } else {
            self.plain(input, false)
        }
    }

    /// conv(relu(x)).
    #[must_use]
    pub fn forward_of_relu(&self, input: Tensor<4>) -> Tensor<4> {
        if self.has_kernel(&input) {
            self.by_kernel(&input, true, None)
        } else {
            self.plain(input, true)
        }
    }

    /// conv(relu(x)) + relu(r), for a convolution that keeps the size.
    #[must_use]
    pub fn forward_of_relu_onto(&self, input: Tensor<4>, residual: Tensor<4>) -> Tensor<4> {
        if self.has_kernel(&input) && host::usable(&residual) {
            host::with_values(&residual, |residual| self.by_kernel(&input, true, Some(residual)))
        } else {
            self.plain(input, true) + relu(residual)
        }
    }

    /// The convolution of the input, or of its positive part if `rectify`.
    fn plain(&self, input: Tensor<4>, rectify: bool) -> Tensor<4> {
        let [outputs, inputs, size, _] = self.weight.dims();
        let differentiable = differentiable::usable(&input) && differentiable::usable(&self.weight);
        if [1, 3].contains(&size) && self.stride == 1 && differentiable {
            let (weight, zeros) = (self.weight.clone(), || Tensor::zeros([outputs], &input.device()));
            let bias = self.bias.clone().unwrap_or_else(zeros);
            return match size {
                1 => differentiable::convolve_pixels(input, weight, bias, rectify),
                _ => differentiable::convolve(input, weight, bias, rectify, self.products),
            };
        }
        let input = if rectify { relu(input) } else { input };
        if host::usable(&input) && host::usable(&self.weight) {
            return self.by_patches(&input);
        }
        if size == 1 && self.stride == 1 {
            return self.pointwise(input, outputs, inputs);
        }
        let options = ConvOptions::new([self.stride; 2], [self.padding; 2], [1, 1], 1);
        module::conv2d(input, self.weight.clone(), self.bias.clone(), options)
    }

    /// A 1x1 convolution is a matrix product.
    fn pointwise(&self, input: Tensor<4>, outputs: usize, inputs: usize) -> Tensor<4> {
        let [images, _, height, width] = input.dims();
        let weight = self.weight.clone().reshape([1, outputs, inputs]);
        let product = weight.matmul(input.reshape([images, inputs, height * width]));
        let product = match &self.bias {
            Some(bias) => product + bias.clone().reshape([1, outputs, 1]),
            None => product,
        };
        product.reshape([images, outputs, height, width])
    }

    /// The convolution as products of its weights with the patch around every output, zeros beyond the edges.
    fn by_patches(&self, input: &Tensor<4>) -> Tensor<4> {
        let ([images, inputs, height, width], [outputs, _, size, _]) = (input.dims(), self.weight.dims());
        let along = |length: usize| (length + 2 * self.padding).saturating_sub(size) / self.stride + 1;
        let (rows, columns) = (along(height), along(width));
        let (area, weight) = (rows * columns, host::values(&self.weight));
        let of_image = |image: &[f32]| -> Vec<f32> {
            let mut patches = vec![0.0; inputs * size * size * area];
            for (unit, line) in patches.chunks_exact_mut(area.max(1)).enumerate() {
                let (channel, down, across) = (unit / (size * size), unit / size % size, unit % size);
                let plane = &image[channel * height * width..][..height * width];
                for (place, value) in line.iter_mut().enumerate() {
                    let at = |index: usize, offset: usize| (index * self.stride + offset).wrapping_sub(self.padding);
                    let (row, column) = (at(place / columns, down), at(place % columns, across));
                    if row < height && column < width {
                        *value = plane[row * width + column];
                    }
                }
            }
            PackedWeight::of(Matrix::new(&patches, area).transposed(), Precision::F32).apply(&weight, |_, _, _| {})
        };
        let mut values: Vec<f32> = host::with_values(input, |input| {
            input
                .chunks_exact((inputs * height * width).max(1))
                .flat_map(of_image)
                .collect()
        });
        let bias = self.host_bias();
        for (plane, line) in values.chunks_exact_mut(area.max(1)).enumerate() {
            line.iter_mut().for_each(|value| *value += bias[plane % outputs]);
        }
        from_host(values, [images, outputs, rows, columns], &input.device())
    }

    /// Whether this convolution on this input has a kernel.
    fn has_kernel(&self, input: &Tensor<4>) -> bool {
        self.weight.dims()[2] == 3 && self.stride == 1 && host::usable(input) && host::usable(&self.weight)
    }

    /// Runs the kernel: by Winograd's algorithm where that pays, else directly.
    fn by_kernel(&self, input: &Tensor<4>, rectify: bool, residual: Option<&[f32]>) -> Tensor<4> {
        let [images, inputs, height, width] = input.dims();
        let (size, outputs) = ([height, width], self.weight.dims()[0]);
        let bias = || self.host_bias();
        let tiled = || {
            let is_wide = inputs >= WIDE && outputs >= WIDE;
            let new = |weight: &[f32]| Winograd::new(weight, &bias(), inputs, outputs, TileSize::Two);
            is_wide.then(|| host::with_values(&self.weight, new))
        };
        let direct = || {
            let new = |weight: &[f32]| Conv3x3::new(weight, &bias(), outputs, inputs, Precision::F32);
            host::with_values(&self.weight, new)
        };
        let tiled = Winograd::fits(size)
            .then(|| self.tiled.get_or_init(tiled).as_ref())
            .flatten();
        let values = host::with_values(input, |input| match tiled {
            Some(conv) => conv.run(input, size, rectify, residual),
            None => self.packed.get_or_init(direct).run(input, size, rectify, residual),
        });
        from_host(values, [images, outputs, height, width], &input.device())
    }

    /// The bias on the host, zeros where there is none.
    pub(super) fn host_bias(&self) -> Vec<f32> {
        let zeros = || vec![0.0; self.weight.dims()[0]];
        self.bias.as_ref().map_or_else(zeros, host::values)
    }
}
