//! Linear layers.

use std::sync::{Arc, OnceLock};

use burn::tensor::Tensor;
use rogs_kernels::pointwise::{add_assign, gelu};
use rogs_kernels::{PackedWeight, Precision};

use crate::parameters::{Scope, from_host};
use crate::{Result, differentiable, host};

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
    /// Numbers that products are made of without gradients, on the CPU.
    precision: Precision,
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
            precision: Precision::F32,
            packed: Arc::default(),
        }
    }

    /// The same layer, its products made of such numbers while gradients are recorded.
    #[must_use]
    pub fn with_products(self, products: Precision) -> Self {
        Self { products, ..self }
    }

    /// The same layer, its products made of such numbers without gradients, on the CPU.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        Self {
            precision,
            packed: Arc::default(),
            ..self
        }
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

    /// Reads `weight` of a layer that has no bias.
    ///
    /// # Errors
    /// When it is missing or has another shape.
    pub fn load_unbiased(scope: &Scope<'_>, outputs: usize, inputs: usize) -> Result<Self> {
        let weight = scope.get("weight", [outputs, inputs])?;
        Ok(Self::new(weight, None).with_products(scope.products()))
    }

    /// Applies the layer to the last dimension. `[..., in] -> [..., out]`
    #[must_use]
    pub fn forward<const D: usize>(&self, input: Tensor<D>) -> Tensor<D> {
        if self.has_kernel(&input) {
            let bias = self.host_bias();
            return self.by_kernel(
                &input,
                #[inline(always)]
                |_, column, values| add_assign(values, &bias[column..]),
            );
        }
        let linear = |input, weight: &Tensor<2>, bias| linear(input, weight.clone(), bias, self.products);
        let plain = linear(input.clone(), &self.weight, self.bias.clone());
        match &self.update {
            Some([a, b]) => plain + linear(linear(input, a, None), b, None) * LORA_SCALE,
            None => plain,
        }
    }

    /// gelu(x W^T + b).
    #[must_use]
    pub fn forward_gelu<const D: usize>(&self, input: Tensor<D>) -> Tensor<D> {
        if !self.has_kernel(&input) {
            return super::gelu(self.forward(input));
        }
        let bias = self.host_bias();
        self.by_kernel(
            &input,
            #[inline(always)]
            |_, column, values| {
                for (value, bias) in values.iter_mut().zip(&bias[column..]) {
                    *value = gelu(*value + bias);
                }
            },
        )
    }

    /// residual + scale * (x W^T + b), `scale [out]` where there is one.
    #[must_use]
    pub fn forward_onto<const D: usize>(
        &self,
        input: Tensor<D>,
        residual: Tensor<D>,
        scale: Option<&Tensor<1>>,
    ) -> Tensor<D> {
        if !self.has_kernel(&input) || !host::usable(&residual) {
            let branch = self.forward(input);
            return residual
                + match scale {
                    Some(scale) => branch * scale.clone().unsqueeze(),
                    None => branch,
                };
        }
        let (bias, outputs) = (self.host_bias(), self.weight.dims()[0]);
        let scale = scale.map_or_else(|| vec![1.0; outputs], host::values);
        host::with_values(&residual, |residual| {
            self.by_kernel(
                &input,
                #[inline(always)]
                |row, column, values| {
                    let residual = &residual[row * outputs + column..];
                    let terms = bias[column..].iter().zip(&scale[column..]).zip(residual);
                    for (value, ((bias, scale), residual)) in values.iter_mut().zip(terms) {
                        *value = scale.mul_add(*value + bias, *residual);
                    }
                },
            )
        })
    }

    /// Numbers of the products without gradients.
    pub(super) fn precision(&self) -> Precision {
        self.precision
    }

    /// Whether the kernel can run this layer on this input.
    pub(super) fn has_kernel<const D: usize>(&self, input: &Tensor<D>) -> bool {
        self.update.is_none() && host::usable(input) && host::usable(&self.weight)
    }

    /// x W^T without the bias; `finish` as in [`PackedWeight::apply`].
    pub(super) fn by_kernel<const D: usize>(
        &self,
        input: &Tensor<D>,
        finish: impl Fn(usize, usize, &mut [f32]) + Sync,
    ) -> Tensor<D> {
        let packed = self.packed.get_or_init(|| {
            let inputs = self.weight.dims()[1];
            host::with_values(&self.weight, |weight| PackedWeight::new(weight, inputs, self.precision))
        });
        let mut shape = input.dims();
        shape[D - 1] = packed.outputs();
        from_host(
            host::with_values(input, |input| packed.apply(input, finish)),
            shape,
            &input.device(),
        )
    }

    /// The bias on the host, zeros where there is none.
    pub(super) fn host_bias(&self) -> Vec<f32> {
        let zeros = || vec![0.0; self.weight.dims()[0]];
        self.bias.as_ref().map_or_else(zeros, host::values)
    }
}

/// W + (alpha / rank) B A.
#[must_use]
pub fn fold(weight: Tensor<2>, [a, b]: [Tensor<2>; 2]) -> Tensor<2> {
    weight + super::product(b, a) * LORA_SCALE
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
        return Linear::new(weight, bias).forward(input);
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
