//! The same distance on tensors: any device, with gradients.

use burn::tensor::module;
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{Device, Tensor, activation};

use crate::distances::LENGTH_FLOOR;
use crate::{BLOCKS, LAYERS, LpipsWeights, SCALE, SHIFT};
use rogs_tensors::parameters::from_host;

/// The network as tensors of a device.
#[derive(Debug, Clone)]
pub struct LpipsTensors {
    /// `[out, in, 3, 3]` and `[out]`
    convolutions: Vec<(Tensor<4>, Tensor<1>)>,
    /// `[1, C, 1, 1]`
    heads: Vec<Tensor<4>>,
    shift: Tensor<4>,
    scale: Tensor<4>,
}

impl LpipsTensors {
    /// Puts the weights on a device.
    #[must_use]
    pub fn new(weights: &LpipsWeights, device: &Device) -> Self {
        let convolution = |own: &super::weights::ConvolutionWeights| {
            let weight = from_host(own.weight.clone(), [own.outputs, own.inputs, 3, 3], device);
            (weight, from_host(own.bias.clone(), [own.outputs], device))
        };
        Self {
            convolutions: weights.convolutions.iter().map(convolution).collect(),
            heads: weights
                .heads
                .iter()
                .map(|head| from_host(head.clone(), [1, head.len(), 1, 1], device))
                .collect(),
            shift: from_host(SHIFT.to_vec(), [1, 3, 1, 1], device),
            scale: from_host(SCALE.to_vec(), [1, 3, 1, 1], device),
        }
    }

    /// Normalised features of images in [0, 1]. `[B, 3, H, W]`, at least 16 pixels on a side
    #[must_use]
    pub fn features(&self, images: Tensor<4>) -> [Tensor<4>; LAYERS] {
        let mut values = (images * 2.0 - 1.0 - self.shift.clone()) / self.scale.clone();
        let mut convolutions = self.convolutions.iter();
        std::array::from_fn(|block| {
            if block > 0 {
                values = module::max_pool2d(values.clone(), MaxPoolOptions::new([2, 2]));
            }
            for (weight, bias) in convolutions.by_ref().take(BLOCKS[block]) {
                let options = ConvOptions::new([1, 1], [1, 1], [1, 1], 1);
                values = activation::relu(module::conv2d(
                    values.clone(),
                    weight.clone(),
                    Some(bias.clone()),
                    options,
                ));
            }
            // The tiny addend keeps the gradient of the root finite where all features are 0.
            let length = ((values.clone() * values.clone()).sum_dim(1) + 1e-20).sqrt() + LENGTH_FLOOR;
            values.clone() / length
        })
    }

    /// Distance of every image of a batch from its partner. `[B, 3, H, W]` each -> `[B]`
    #[must_use]
    pub fn distance(&self, a: Tensor<4>, b: Tensor<4>) -> Tensor<1> {
        let batch = a.dims()[0];
        let (a, b) = (self.features(a), self.features(b));
        let mut total = Tensor::<1>::zeros([batch], &self.shift.device());
        for ((a, b), head) in a.into_iter().zip(b).zip(&self.heads) {
            let difference = a - b;
            let weighted = difference.clone() * difference * head.clone();
            let pixels = weighted.dims()[2] * weighted.dims()[3];
            total = total + weighted.sum_dim(3).sum_dim(2).sum_dim(1).reshape([batch]) / pixels as f32;
        }
        total
    }
}
