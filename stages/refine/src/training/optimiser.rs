//! Which parameters of the refiner are trained, and how fast.

use burn::tensor::Tensor;
use rogs_stage2::weights::is_trained;
use rogs_tensors::optimiser::{self, Gradients, Moments, Rule};
use rogs_tensors::parameters::Parameters;
use rogs_worker::StageResult;

use crate::refinement::internal;

/// AdamW over the trained parameters of a store (`docs/spec/stage2.md` section B.8). Rates are fields, so that a schedule
/// sets them before each step.
#[derive(Debug, Clone)]
pub struct AdamW {
    /// Learning rate of the updater.
    pub learning_rate: f64,
    /// Learning rate of the residual gates.
    pub gate_learning_rate: f64,
    /// Decoupled weight decay of matrices; gates, biases and normalisations have none.
    pub weight_decay: f64,
    /// Largest norm of the gradient of all parameters together.
    pub clip: f64,
    /// Steps done.
    pub steps: u64,
    /// What the next step depends on besides the parameters.
    pub moments: Moments,
}

impl Default for AdamW {
    /// The paper's rates and decay, ReSplat's clip.
    fn default() -> Self {
        Self {
            learning_rate: 1e-4,
            gate_learning_rate: 1.521e-4,
            weight_decay: 0.01,
            clip: 0.5,
            steps: 0,
            moments: Moments::default(),
        }
    }
}

impl AdamW {
    /// Makes the trained parameters of a store require gradients. Call it before the network is loaded from them.
    pub fn track(parameters: &mut Parameters) {
        for (name, parameter) in parameters.memory_mut() {
            if is_trained(name) {
                parameter.values = parameter.values.clone().require_grad();
            }
        }
    }

    /// Differentiates a surrogate and moves the parameters; they are leaves of their own afterwards.
    ///
    /// # Errors
    /// When the device fails.
    pub fn step(&mut self, parameters: &mut Parameters, surrogate: &Tensor<1>) -> StageResult<()> {
        let gradients = optimiser::gradients(parameters, surrogate).map_err(internal)?;
        self.apply(parameters, &gradients).map(|_| ())
    }

    /// Moves the parameters by gradients; returns the norm of these before clipping. When that is not finite, nothing is
    /// moved and no step counted.
    ///
    /// # Errors
    /// When a parameter cannot be read.
    pub fn apply(&mut self, parameters: &mut Parameters, gradients: &Gradients) -> StageResult<f64> {
        let (rate, gate_rate, decay) = (self.learning_rate, self.gate_learning_rate, self.weight_decay);
        let rule = Rule {
            rate: &|name| {
                let gate = name == "encoder.update_gate.logit";
                is_trained(name).then_some(if gate { gate_rate } else { rate })
            },
            share: 1.0,
            betas: [0.9, 0.999],
            weight_decay: &|shape| if shape.len() > 1 { decay } else { 0.0 },
            clip: self.clip,
        };
        let moments = &mut self.moments;
        let norm = optimiser::update(parameters, moments, gradients, &rule, self.steps).map_err(internal)?;
        self.steps += u64::from(norm.is_finite());
        Ok(norm)
    }
}
