//! Normalisation of rows: layer norm, and by the root mean square.

use burn::tensor::{Tensor, module};
use rayon::prelude::*;
use rogs_kernels::{Norm, vectorised};

use crate::parameters::{Scope, from_host};
use crate::{Result, differentiable, host};

/// Layer normalisation over the last dimension, with its affine map; or division by the root mean square instead
/// ([`LayerNorm::root_mean_square`]).
#[derive(Debug, Clone)]
pub struct LayerNorm {
    weight: Tensor<1>,
    bias: Tensor<1>,
    epsilon: f64,
    /// Whether the mean comes off first.
    centred: bool,
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
            centred: true,
        })
    }

    /// A layer norm that scales and does not shift: `weight` of `size` numbers.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn scaling(scope: &Scope<'_>, size: usize, epsilon: f64) -> Result<Self> {
        Ok(Self {
            weight: scope.get("weight", [size])?,
            bias: Tensor::zeros([size], scope.device()),
            epsilon,
            centred: true,
        })
    }

    /// x / sqrt(mean of x^2 + epsilon) * `weight`, of `size` numbers.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn root_mean_square(scope: &Scope<'_>, size: usize, epsilon: f64) -> Result<Self> {
        Ok(Self {
            centred: false,
            ..Self::scaling(scope, size, epsilon)?
        })
    }

    /// Applies the layer.
    #[must_use]
    pub fn forward<const D: usize>(&self, input: Tensor<D>) -> Tensor<D> {
        let on_host = host::usable(&input) && host::usable(&self.weight);
        if !(self.centred || on_host) {
            let square = (input.clone() * input.clone()).mean_dim(D - 1);
            let scaled = input / square.add_scalar(self.epsilon).sqrt();
            return scaled * self.weight.clone().unsqueeze() + self.bias.clone().unsqueeze();
        }
        if differentiable::usable(&input) {
            return differentiable::layer_norm(input, self.weight.clone(), self.bias.clone(), self.epsilon);
        }
        if on_host {
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
            centred: self.centred,
        }
    }
}

/// The numbers of a [`LayerNorm`] on the host.
pub(super) struct HostNorm {
    weight: Vec<f32>,
    bias: Vec<f32>,
    epsilon: f32,
    centred: bool,
}

impl HostNorm {
    /// The norm as kernels take it.
    pub(super) fn borrow(&self) -> Norm<'_> {
        Norm {
            weight: &self.weight,
            bias: &self.bias,
            epsilon: self.epsilon,
            centred: self.centred,
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
        let norm = HostNorm {
            weight,
            bias,
            epsilon,
            centred: true,
        };
        return by_kernel(&input, &norm);
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
