//! The tensor operations of the networks.

use burn::tensor::module;
use burn::tensor::ops::{AttentionModuleOptions, ConvOptions, InterpolateMode, InterpolateOptions};
use burn::tensor::{Tensor, activation};

use crate::Result;
use crate::parameters::Scope;

/// y = x W^T + b with the weight as PyTorch stores it.
#[derive(Debug, Clone)]
pub struct Linear {
    /// `[out, in]`
    pub weight: Tensor<2>,
    /// `[out]`
    pub bias: Option<Tensor<1>>,
}

impl Linear {
    /// Reads `weight` and `bias`, and folds a low-rank update `lora_A`, `lora_B` in when the scope has one.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load(scope: &Scope<'_>, outputs: usize, inputs: usize) -> Result<Self> {
        let weight = scope.get("weight", [outputs, inputs])?;
        let bias = Some(scope.get("bias", [outputs])?);
        Ok(Self { weight, bias })
    }

    /// Applies the layer to the last dimension. `[..., in] -> [..., out]`
    #[must_use]
    pub fn forward<const D: usize>(&self, input: Tensor<D>) -> Tensor<D> {
        linear(input, self.weight.clone(), self.bias.clone())
    }
}

/// y = x W^T + b on the last dimension, `weight [out, in]`.
#[must_use]
pub fn linear<const D: usize>(input: Tensor<D>, weight: Tensor<2>, bias: Option<Tensor<1>>) -> Tensor<D> {
    let mut dims = input.dims();
    let [outputs, inputs] = weight.dims();
    let rows = dims[..D - 1].iter().product::<usize>();
    let product = input.reshape([rows, inputs]).matmul(weight.transpose());
    dims[D - 1] = outputs;
    let sum = match bias {
        Some(bias) => product + bias.unsqueeze(),
        None => product,
    };
    sum.reshape(dims)
}

/// Layer normalisation over the last dimension, with its affine map.
#[derive(Debug, Clone)]
pub struct LayerNorm {
    weight: Tensor<1>,
    bias: Tensor<1>,
    epsilon: f64,
}

impl LayerNorm {
    /// Reads `weight` and `bias` of `size` numbers.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load(scope: &Scope<'_>, size: usize, epsilon: f64) -> Result<Self> {
        Ok(Self {
            weight: scope.get("weight", [size])?,
            bias: scope.get("bias", [size])?,
            epsilon,
        })
    }

    /// Applies the layer.
    #[must_use]
    pub fn forward<const D: usize>(&self, input: Tensor<D>) -> Tensor<D> {
        module::layer_norm(input, self.weight.clone(), Some(self.bias.clone()), self.epsilon)
    }
}

/// (x - mean) / sqrt(variance + epsilon) over the last dimension, without an affine map.
#[must_use]
pub fn standardise<const D: usize>(input: Tensor<D>, epsilon: f64) -> Tensor<D> {
    let size = input.dims()[D - 1];
    let ones = Tensor::<1>::ones([size], &input.device());
    module::layer_norm(input, ones, None, epsilon)
}

/// GELU in its exact (erf) form.
#[must_use]
pub fn gelu<const D: usize>(input: Tensor<D>) -> Tensor<D> {
    activation::gelu(input)
}

/// softmax(q k^T / sqrt(head size)) v. `[B, heads, T, head size]` each
#[must_use]
pub fn attention(query: Tensor<4>, key: Tensor<4>, value: Tensor<4>) -> Tensor<4> {
    module::attention(query, key, value, None, None, AttentionModuleOptions::default())
}

/// 2-D convolution weights.
#[derive(Debug, Clone)]
pub struct Conv {
    /// `[out, in, k, k]`
    pub weight: Tensor<4>,
    /// `[out]`
    pub bias: Option<Tensor<1>>,
    stride: usize,
    padding: usize,
}

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
        })
    }

    /// Applies the convolution. `[B, in, H, W] -> [B, out, H', W']`
    #[must_use]
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let options = ConvOptions::new([self.stride; 2], [self.padding; 2], [1, 1], 1);
        module::conv2d(input, self.weight.clone(), self.bias.clone(), options)
    }
}

/// Bilinear resampling that keeps the corner pixel centres in place (align_corners = true).
#[must_use]
pub fn resize(input: Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4> {
    let [_, _, rows, columns] = input.dims();
    if [rows, columns] == [height, width] {
        return input;
    }
    let options = InterpolateOptions::new(InterpolateMode::Bilinear).with_align_corners(true);
    module::interpolate(input, options.with_output_size([height, width]))
}

/// max(x, 0).
#[must_use]
pub fn relu(input: Tensor<4>) -> Tensor<4> {
    activation::relu(input)
}
