//! The tensor operations of the networks.

mod resample;
mod rotary;

use std::sync::{Arc, OnceLock};

use burn::tensor::module;
use burn::tensor::ops::{AttentionModuleOptions, ConvOptions};
use burn::tensor::{Tensor, activation};

use crate::Result;
use crate::parameters::Scope;
use crate::{differentiable, host};
use rogs_kernels::{After, Conv3x3, HeadNorm, PackedWeight, Precision, Winograd};

pub use resample::resize;
pub use rotary::Rotary;

/// alpha / rank of low-rank updates: 16 / 32 (`docs/spec/stage1.md` section 9). The ratio is fixed, whatever the rank.
pub const LORA_SCALE: f64 = 0.5;

/// y = x W^T + b with the weight as PyTorch stores it, plus a low-rank update where there is one.
#[derive(Debug, Clone)]
pub struct Linear {
    /// `[out, in]`
    pub weight: Tensor<2>,
    /// `[out]`
    pub bias: Option<Tensor<1>>,
    /// A `[rank, in]` and B `[out, rank]` of an update that is being trained.
    pub update: Option<[Tensor<2>; 2]>,
    /// Numbers that products are made of while gradients are recorded.
    pub products: Precision,
    /// The weight as the CPU kernel takes it, made when first needed.
    packed: Arc<OnceLock<PackedWeight>>,
}

impl Linear {
    /// A layer without a low-rank update.
    #[must_use]
    pub fn new(weight: Tensor<2>, bias: Option<Tensor<1>>) -> Self {
        Self {
            weight,
            bias,
            update: None,
            products: Precision::F32,
            packed: Arc::default(),
        }
    }

    /// The same layer, its products made of such numbers while gradients are recorded.
    #[must_use]
    pub fn with_products(self, products: Precision) -> Self {
        Self { products, ..self }
    }

    /// Reads `weight` and `bias`, and the low-rank update `lora_A`, `lora_B` when the scope has one: it is folded into the
    /// weight unless it records gradients.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load(scope: &Scope<'_>, outputs: usize, inputs: usize) -> Result<Self> {
        let weight = scope.get("weight", [outputs, inputs])?;
        let bias = Some(scope.get("bias", [outputs])?);
        let rank = scope.shape("lora_A.weight").and_then(|shape| shape.first().copied());
        let new = |weight, bias| Self::new(weight, bias).with_products(scope.products());
        let Some(rank) = rank else {
            return Ok(new(weight, bias));
        };
        let update = [
            scope.get("lora_A.weight", [rank, inputs])?,
            scope.get("lora_B.weight", [outputs, rank])?,
        ];
        if update.iter().any(|part| part.is_autodiff()) {
            return Ok(Self {
                update: Some(update),
                ..new(weight, bias)
            });
        }
        Ok(new(fold(weight, update), bias))
    }

    /// Applies the layer to the last dimension. `[..., in] -> [..., out]`
    #[must_use]
    pub fn forward<const D: usize>(&self, input: Tensor<D>) -> Tensor<D> {
        if self.update.is_none() && host::usable(&input) && host::usable(&self.weight) {
            return packed_linear(input, &self.weight, &self.packed, self.bias.as_ref());
        }
        let linear = |input, weight: &Tensor<2>, bias| linear(input, weight.clone(), bias, self.products);
        let plain = linear(input.clone(), &self.weight, self.bias.clone());
        match &self.update {
            Some([a, b]) => plain + linear(linear(input, a, None), b, None) * LORA_SCALE,
            None => plain,
        }
    }
}

/// W + (alpha / rank) B A.
#[must_use]
pub fn fold(weight: Tensor<2>, [a, b]: [Tensor<2>; 2]) -> Tensor<2> {
    weight + b.matmul(a) * LORA_SCALE
}

/// y = x W^T + b on the last dimension, `weight [out, in]`. While gradients are recorded on the CPU, products are made of
/// such numbers.
#[must_use]
pub fn linear<const D: usize>(
    input: Tensor<D>,
    weight: Tensor<2>,
    bias: Option<Tensor<1>>,
    products: Precision,
) -> Tensor<D> {
    let mut dims = input.dims();
    let [outputs, inputs] = weight.dims();
    let rows = dims[..D - 1].iter().product::<usize>();
    if host::usable(&input) && host::usable(&weight) {
        return packed_linear(input, &weight, &Arc::default(), bias.as_ref());
    }
    if let Some(bias) = bias
        .as_ref()
        .filter(|_| differentiable::usable(&input) && differentiable::usable(&weight))
    {
        return differentiable::linear(input, weight, bias.clone(), products);
    }
    let product = input.reshape([rows, inputs]).matmul(weight.transpose());
    dims[D - 1] = outputs;
    let sum = match bias {
        Some(bias) => product + bias.unsqueeze(),
        None => product,
    };
    sum.reshape(dims)
}

/// The same by the CPU kernel; the packed weight is made where there is none yet.
fn packed_linear<const D: usize>(
    input: Tensor<D>,
    weight: &Tensor<2>,
    packed: &Arc<OnceLock<PackedWeight>>,
    bias: Option<&Tensor<1>>,
) -> Tensor<D> {
    packed.get_or_init(|| host::pack(weight, Precision::F32));
    let (mut shape, packed) = (input.dims(), packed.clone());
    let outputs = weight.dims()[0];
    shape[D - 1] = outputs;
    let bias = bias.map_or_else(|| vec![0.0; outputs], values);
    host::read(input, weight.clone(), shape, move |input, _| {
        let apply = |packed: &PackedWeight| {
            packed.apply(
                input,
                #[inline(always)]
                |_, column, values| {
                    for (value, bias) in values.iter_mut().zip(&bias[column..]) {
                        *value += bias;
                    }
                },
            )
        };
        packed.get().map(apply).unwrap_or_default()
    })
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

    /// The layer on host values.
    #[must_use]
    pub fn host(&self) -> HostNorm {
        HostNorm {
            weight: values(&self.weight),
            bias: values(&self.bias),
            epsilon: self.epsilon as f32,
        }
    }

    /// Applies the layer.
    #[must_use]
    pub fn forward<const D: usize>(&self, input: Tensor<D>) -> Tensor<D> {
        if differentiable::usable(&input) {
            return differentiable::layer_norm(input, self.weight.clone(), self.bias.clone(), self.epsilon);
        }
        module::layer_norm(input, self.weight.clone(), Some(self.bias.clone()), self.epsilon)
    }
}

/// The numbers of a [`LayerNorm`] on the host.
pub struct HostNorm {
    weight: Vec<f32>,
    bias: Vec<f32>,
    epsilon: f32,
}

impl HostNorm {
    /// The norm as the attention kernel takes it.
    pub fn borrow(&self) -> HeadNorm<'_> {
        HeadNorm {
            weight: &self.weight,
            bias: &self.bias,
            epsilon: self.epsilon,
        }
    }
}

/// (x - mean) / sqrt(variance + epsilon) over the last dimension, without an affine map.
#[must_use]
pub fn standardise<const D: usize>(input: Tensor<D>, epsilon: f64) -> Tensor<D> {
    let size = input.dims()[D - 1];
    let ones = Tensor::<1>::ones([size], &input.device());
    if differentiable::usable(&input) {
        let zeros = ones.zeros_like();
        return differentiable::layer_norm(input, ones, zeros, epsilon);
    }
    module::layer_norm(input, ones, None, epsilon)
}

/// GELU in its exact (erf) form.
#[must_use]
pub fn gelu<const D: usize>(input: Tensor<D>) -> Tensor<D> {
    if differentiable::usable(&input) {
        return differentiable::gelu(input);
    }
    activation::gelu(input)
}

/// softmax(q k^T / sqrt(head size)) v. `[B, heads, T, head size]` each
#[must_use]
pub fn attention(query: Tensor<4>, key: Tensor<4>, value: Tensor<4>) -> Tensor<4> {
    if differentiable::usable(&query) {
        return differentiable::attention(query, key, value);
    }
    module::attention(query, key, value, None, None, AttentionModuleOptions::default())
}

/// The values of a small tensor on the CPU.
pub fn values<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
    tensor.to_data().try_into_vec::<f32>().unwrap_or_default()
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
    /// Numbers that products are made of while gradients are recorded.
    products: Precision,
    /// The weights as the CPU kernel takes them, made when first needed.
    packed: Arc<OnceLock<Conv3x3>>,
    /// The same for minimal filtering; `None` inside where the layer is too narrow to gain from it.
    tiled: Arc<OnceLock<Option<Winograd>>>,
}

/// Channels from which minimal filtering pays.
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
            self.run(input.clone(), input, false, After::Nothing, false)
        } else {
            self.plain(input)
        }
    }

    /// relu(conv(relu(x))).
    #[must_use]
    pub fn forward_rectified(&self, input: Tensor<4>) -> Tensor<4> {
        if self.has_kernel(&input) {
            self.run(input.clone(), input, true, After::Relu, false)
        } else {
            relu(self.plain(relu(input)))
        }
    }

    /// conv(x) + relu(r), for a convolution that keeps the size.
    #[must_use]
    pub fn forward_onto(&self, input: Tensor<4>, residual: Tensor<4>) -> Tensor<4> {
        if self.has_kernel(&input) {
            self.run(input, residual, false, After::Nothing, true)
        } else {
            self.plain(input) + relu(residual)
        }
    }

    fn plain(&self, input: Tensor<4>) -> Tensor<4> {
        let [outputs, inputs, size, _] = self.weight.dims();
        if size == 1 && self.stride == 1 {
            return self.pointwise(input, outputs, inputs);
        }
        if size == 3 && self.stride == 1 && differentiable::usable(&input) && differentiable::usable(&self.weight) {
            let bias = self
                .bias
                .clone()
                .unwrap_or_else(|| Tensor::zeros([outputs], &input.device()));
            return differentiable::convolve(input, self.weight.clone(), bias, self.products);
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

    /// Whether this convolution on this input has a kernel.
    fn has_kernel(&self, input: &Tensor<4>) -> bool {
        self.weight.dims()[2] == 3 && self.stride == 1 && host::usable(input) && host::usable(&self.weight)
    }

    /// Runs the kernel: by minimal filtering where that pays, else directly.
    fn run(&self, input: Tensor<4>, residual: Tensor<4>, rectify: bool, after: After, add: bool) -> Tensor<4> {
        let [images, inputs, height, width] = input.dims();
        let (size, outputs) = ([height, width], self.weight.dims()[0]);
        let bias = || self.bias.as_ref().map_or_else(|| vec![0.0; outputs], values);
        let tiled = || {
            let is_wide = inputs >= WIDE && outputs >= WIDE;
            is_wide.then(|| Winograd::new(&values(&self.weight), bias(), inputs, outputs).ok())?
        };
        let is_tiled = Winograd::fits(size) && self.tiled.get_or_init(tiled).is_some();
        if !is_tiled {
            self.packed
                .get_or_init(|| Conv3x3::new(&values(&self.weight), &bias(), outputs, inputs, Precision::F32));
        }
        let (packed, tiled) = (self.packed.clone(), self.tiled.clone());
        host::read(
            input,
            residual,
            [images, outputs, height, width],
            move |input, residual| {
                let residual = add.then_some(residual);
                match (tiled.get(), packed.get()) {
                    (Some(Some(conv)), _) if is_tiled => conv.run(input, size, rectify, after, residual),
                    (_, Some(conv)) => conv.run(input, size, rectify, after, residual),
                    _ => Vec::new(),
                }
            },
        )
    }
}

/// max(x, 0).
#[must_use]
pub fn relu(input: Tensor<4>) -> Tensor<4> {
    activation::relu(input)
}
