//! The last step of a dense head: two convolutions on a map that is enlarged first.

use std::sync::{Arc, OnceLock};

use burn::tensor::Tensor;
use rogs_kernels::{Conv3x3, DenseTail as Kernel, Precision};

use super::conv::Conv;
use super::resize;
use crate::parameters::{Scope, from_host};
use crate::{Result, host};

/// 3x3 convolution, ReLU, 1x1 convolution.
#[derive(Debug, Clone)]
pub struct DenseTail {
    first: Conv,
    second: Conv,
    /// The weights as the CPU kernel takes them for one image size, made when first needed.
    packed: Arc<OnceLock<([usize; 2], Kernel)>>,
}

impl DenseTail {
    /// Reads the convolutions `0` and `2` of a scope.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load(scope: &Scope<'_>, [inputs, hidden, outputs]: [usize; 3]) -> Result<Self> {
        Ok(Self {
            first: Conv::load(&scope.child("0"), [hidden, inputs], 3, 1)?,
            second: Conv::load(&scope.child("2"), [outputs, hidden], 1, 1)?,
            packed: Arc::default(),
        })
    }

    /// The convolutions. `[B, inputs, H, W] -> [B, outputs, H, W]`
    #[must_use]
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.second.forward_of_relu(self.first.forward(input))
    }

    /// The convolutions on the map resized to `[H, W]`, with position maps added where there are any: in one pass where there
    /// is a kernel. `[B, inputs, h, w] -> [B, outputs, H, W]`, `positions [1, inputs, H, W]`
    #[must_use]
    pub fn forward_resized(
        &self,
        input: Tensor<4>,
        size: [usize; 2],
        positions: Option<&dyn Fn() -> Tensor<4>>,
    ) -> Tensor<4> {
        if let Some(output) = self.by_kernel(&input, size, positions) {
            return output;
        }
        let resized = resize(input, size);
        self.forward(match positions {
            Some(positions) => resized + positions(),
            None => resized,
        })
    }

    /// The same by the kernel, where it can be used: it is prepared for the first image size that comes.
    fn by_kernel(
        &self,
        input: &Tensor<4>,
        size: [usize; 2],
        positions: Option<&dyn Fn() -> Tensor<4>>,
    ) -> Option<Tensor<4>> {
        let (weight, head) = (&self.first.weight, &self.second.weight);
        if !host::usable(input) || !host::usable(weight) || !host::usable(head) {
            return None;
        }
        let [images, inputs, rows, columns] = input.dims();
        let (prepared, tail) = self
            .packed
            .get_or_init(|| (size, self.prepare(inputs, size, positions)));
        if *prepared != size {
            return None;
        }
        let values = host::with_values(input, |input| tail.run(input, [rows, columns], size));
        let shape = [images, head.dims()[0], size[0], size[1]];
        Some(from_host(values, shape, &input.device()))
    }

    /// The 3x3 convolution is linear: that of the position map is computed once, and is a bias per pixel from then on.
    fn prepare(&self, inputs: usize, size: [usize; 2], positions: Option<&dyn Fn() -> Tensor<4>>) -> Kernel {
        let (hidden, area) = (self.second.weight.dims()[1], size[0] * size[1]);
        let new = |weight: &[f32]| Conv3x3::new(weight, &[], hidden, inputs, Precision::F32);
        let first = host::with_values(&self.first.weight, new);
        let mut map = match positions {
            Some(positions) => host::with_values(&positions(), |positions| first.run(positions, size, false, None)),
            None => vec![0.0; hidden * area],
        };
        for (plane, bias) in map.chunks_exact_mut(area).zip(self.first.host_bias()) {
            plane.iter_mut().for_each(|value| *value += bias);
        }
        Kernel {
            first,
            map,
            second: host::values(&self.second.weight),
            bias: self.second.host_bias(),
            inputs,
        }
    }
}
