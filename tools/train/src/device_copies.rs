//! The way of a network's outputs to another device and of their gradients back: a network runs on a GPU, while
//! the rasteriser and the losses of Stage 1 are those of the CPU.

use burn::tensor::{Device, Gradients, Tensor};
use rogs_tensors::parameters::{from_host, to_host};

use crate::error::Result;

/// Copies of tensors on another device.
pub(crate) struct DeviceCopies {
    /// Where the copies lie.
    device: Device,
    /// Every tensor, and its copy where that records gradients. `[n]` each
    copied: Vec<(Tensor<1>, Tensor<1>)>,
}

impl DeviceCopies {
    /// Nothing yet; copies record gradients where the device does.
    pub(crate) fn to(device: Device) -> Self {
        Self {
            device,
            copied: Vec::new(),
        }
    }

    /// A copy of a tensor, a leaf of its own.
    pub(crate) fn copy<const D: usize>(&mut self, tensor: &Tensor<D>) -> Result<Tensor<D>> {
        let (shape, count) = (tensor.dims(), tensor.shape().num_elements());
        let mut leaf: Tensor<1> = from_host(to_host(tensor.clone())?, [count], &self.device);
        if self.device.is_autodiff() {
            leaf = leaf.require_grad();
            self.copied.push((tensor.clone().reshape([count]), leaf.clone()));
        }
        Ok(leaf.reshape(shape))
    }

    /// A number on the device of the tensors whose gradients with respect to them are those that a backward pass found for
    /// their copies; `None` when it found none. `[1]`
    pub(crate) fn back(self, graph: &mut Gradients) -> Result<Option<Tensor<1>>> {
        let mut sum: Option<Tensor<1>> = None;
        for (tensor, leaf) in self.copied {
            let Some(gradient) = leaf.grad_remove(graph) else {
                continue;
            };
            let gradient = from_host(to_host(gradient)?, tensor.dims(), &tensor.device());
            let product = (tensor * gradient).sum();
            sum = Some(match sum {
                Some(sum) => sum + product,
                None => product,
            });
        }
        Ok(sum)
    }
}
