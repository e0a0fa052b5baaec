//! Layer normalisation.

use burn::tensor::{Tensor, module};
use rayon::prelude::*;
use rogs_kernels::{Norm, vectorised};

use crate::parameters::{Scope, from_host};
use crate::{Result, differentiable, host};

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
        if differentiable::usable(&input) {
            return differentiable::layer_norm(input, self.weight.clone(), self.bias.clone(), self.epsilon);
        }
        if host::usable(&input) && host::usable(&self.weight) {
            return by_kernel(&input, &self.host());
        }
        module::layer_norm(input, self.weight.clone(), Some(self.bias.clone()), self.epsilon)
    }

    /// The norm on the host, for a kernel that applies it on the way.
    pub(super) fn host(&self) -> HostNorm {
        HostNorm {
            weight: host::values(&self.weight),
            bias: host::values(&self.bias),
            epsilon: self.epsilon as f32,
        }
    }
}

/// The numbers of a [`LayerNorm`] on the host.
pub(super) struct HostNorm {
    weight: Vec<f32>,
    bias: Vec<f32>,
    epsilon: f32,
}

impl HostNorm {
    /// The norm as kernels take it.
    pub(super) fn borrow(&self) -> Norm<'_> {
        Norm {
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
    if host::usable(&input) {
        let (weight, bias, epsilon) = (vec![1.0; size], vec![0.0; size], epsilon as f32);
        return by_kernel(&input, &HostNorm { weight, bias, epsilon });
    }
    module::layer_norm(input, ones, None, epsilon)
}

/// The norm of every row by a kernel whose sums have the same order for vectors of any width; the framework's have not.
fn by_kernel<const D: usize>(input: &Tensor<D>, norm: &HostNorm) -> Tensor<D> {
    /// Rows of a task.
    const ROWS: usize = 64;
    let mut values = host::values(input);
    values.par_chunks_mut(ROWS * norm.weight.len().max(1)).for_each(|rows| {
        vectorised(
            #[inline(always)]
            || {
                for row in rows.chunks_exact_mut(norm.weight.len().max(1)) {
                    norm.borrow().apply(row);
                }
            },
        );
    });
    from_host(values, input.dims(), &input.device())
}
