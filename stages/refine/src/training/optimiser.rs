//! The optimiser of the trained parameters.

use std::collections::BTreeMap;

use burn::tensor::Tensor;
use rogs_networks::parameters::{Parameters, to_host};
use rogs_networks::stage2::weights::is_trained;
use rogs_worker::StageResult;

use crate::refinement::internal;

/// AdamW over the trained parameters of a store (`stage2-network.md` section B.8). Rates are fields, so that a schedule
/// sets them before each step.
#[derive(Debug, Clone)]
pub struct AdamW {
    /// Learning rate of the updater.
    pub learning_rate: f32,
    /// Learning rate of the residual gates.
    pub gate_learning_rate: f32,
    /// Decoupled weight decay of matrices; gates, biases and normalisations have none.
    pub weight_decay: f32,
    /// Largest norm of the gradient of all parameters together.
    pub clip: f32,
    steps: i32,
    moments: BTreeMap<String, [Vec<f32>; 2]>,
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
            moments: BTreeMap::new(),
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

    /// Differentiates a surrogate and moves the parameters.
    ///
    /// # Errors
    /// When the device fails.
    pub fn step(&mut self, parameters: &mut Parameters, surrogate: &Tensor<1>) -> StageResult<()> {
        const BETAS: [f32; 2] = [0.9, 0.999];
        let gradients = surrogate.backward();
        let mut found = Vec::new();
        for (name, parameter) in parameters.memory().iter().filter(|(name, _)| is_trained(name)) {
            if let Some(gradient) = parameter.values.grad(&gradients) {
                found.push((
                    name.clone(),
                    parameter.shape.clone(),
                    to_host(gradient).map_err(internal)?,
                ));
            }
        }
        let square = |values: &[f32]| {
            values
                .iter()
                .map(|&value| f64::from(value) * f64::from(value))
                .sum::<f64>()
        };
        let norm = found
            .iter()
            .map(|(_, _, gradient)| square(gradient))
            .sum::<f64>()
            .sqrt() as f32;
        let share = if norm > self.clip { self.clip / norm } else { 1.0 };
        self.steps += 1;
        let unbias = BETAS.map(|beta| 1.0 - beta.powi(self.steps));
        for (name, shape, gradient) in found {
            let gate = name == "encoder.update_gate.logit";
            let rate = if gate {
                self.gate_learning_rate
            } else {
                self.learning_rate
            };
            let decay = if shape.len() > 1 { self.weight_decay } else { 0.0 };
            let mut values = parameters.host(&name).map_err(internal)?;
            let moments = self.moments.entry(name.clone());
            let [first, second] = moments.or_insert_with(|| [vec![0.0; gradient.len()], vec![0.0; gradient.len()]]);
            for (index, gradient) in gradient.iter().map(|value| value * share).enumerate() {
                first[index] = BETAS[0] * first[index] + (1.0 - BETAS[0]) * gradient;
                second[index] = BETAS[1] * second[index] + (1.0 - BETAS[1]) * gradient * gradient;
                let direction = first[index] / unbias[0] / ((second[index] / unbias[1]).sqrt() + 1e-8);
                values[index] -= rate * (direction + decay * values[index]);
            }
            parameters.insert(&name, &shape, values).map_err(internal)?;
        }
        Ok(())
    }
}
