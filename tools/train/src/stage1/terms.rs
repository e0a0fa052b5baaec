//! Terms of the objective, and their weighted sum.

use std::collections::BTreeMap;

use burn::tensor::{Device, Tensor};
use rogs_lpips::LpipsTensors;
use rogs_tensors::parameters::to_host;

use crate::config::LossWeights;
use crate::error::Result;

/// Keeps a mean over nothing finite.
pub(super) const EPSILON: f64 = 1e-6;

/// The objective of a clip.
pub struct Objective {
    /// Value of each term before its weight, by key.
    pub terms: BTreeMap<&'static str, f64>,
    /// The weighted sum.
    pub value: f64,
    /// A tensor with its gradients with respect to the outputs, on their device. `[1]`
    pub loss: Tensor<1>,
}

/// What a clip is judged by.
#[derive(Clone, Copy)]
pub struct Losses<'a> {
    /// Weight of each term.
    pub weights: &'a LossWeights,
    /// The network of `movies_lpips`, on the CPU; that term is left out without it.
    pub perceptual: Option<&'a LpipsTensors>,
}

/// A weighted sum of differentiable terms.
pub(super) struct Sum {
    pub(super) objective: Objective,
}

impl Sum {
    pub(super) fn new(device: &Device) -> Self {
        Self {
            objective: Objective {
                terms: BTreeMap::new(),
                value: 0.0,
                loss: Tensor::zeros([1], device),
            },
        }
    }

    /// Adds `share` of a term (of one of several queries, say).
    pub(super) fn add(&mut self, key: &'static str, weight: f64, share: f64, term: Tensor<1>) -> Result<()> {
        let sum = &mut self.objective;
        let value = share * f64::from(to_host(term.clone())?.first().copied().unwrap_or(f32::NAN));
        *sum.terms.entry(key).or_insert(0.0) += value;
        sum.value += weight * value;
        sum.loss = sum.loss.clone() + term * (weight * share);
        Ok(())
    }
}
