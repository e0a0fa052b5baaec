//! AdamW with a rate and a decay per parameter (`docs/spec/stage1.md` section 15, `docs/spec/stage2.md` section B.8).

use std::collections::BTreeMap;

use burn::tensor::Tensor;
use rayon::prelude::*;

use crate::Result;
use crate::parameters::{Parameters, to_host};

/// Keeps a division by a zero moment finite.
const EPSILON: f64 = 1e-8;

/// The two moments of every trained parameter.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Moments {
    /// First and second moment by parameter.
    pub by_name: BTreeMap<String, [Vec<f32>; 2]>,
}

/// Gradients of parameters by name, row-major.
pub type Gradients = BTreeMap<String, Vec<f32>>;

/// Share of the peak rate at an update (counted from 0): linear warm-up, then a cosine to zero.
#[must_use]
pub fn schedule(step: u64, steps: u64, warmup: u64) -> f64 {
    if step < warmup {
        return (step + 1) as f64 / warmup as f64;
    }
    let rest = steps.saturating_sub(warmup).max(1) as f64;
    let done = ((step - warmup) as f64 / rest).min(1.0);
    0.5 * (1.0 + libm::cos(std::f64::consts::PI * done))
}

/// Norm of all gradients together, summed in the order of names.
#[must_use]
pub fn norm(gradients: &Gradients) -> f64 {
    let square = |values: &Vec<f32>| {
        values
            .iter()
            .map(|&value| f64::from(value) * f64::from(value))
            .sum::<f64>()
    };
    gradients.values().map(square).sum::<f64>().sqrt()
}

/// How parameters are moved.
pub struct Rule<'a> {
    /// Peak learning rate of a parameter, `None` when it is not trained.
    pub rate: &'a dyn Fn(&str) -> Option<f64>,
    /// Share of the peak rate at this update.
    pub share: f64,
    /// Decay rates of the two moments.
    pub betas: [f64; 2],
    /// Decoupled weight decay of a parameter of this shape.
    pub weight_decay: &'a dyn Fn(&[usize]) -> f64,
    /// Largest norm of all gradients together.
    pub clip: f64,
}

/// Differentiates a loss with respect to all parameters in memory that record gradients.
///
/// # Errors
/// When a gradient cannot be read from the device.
pub fn gradients(leaves: &Parameters, loss: &Tensor<1>) -> Result<Gradients> {
    let mut by_name = Gradients::new();
    collect(leaves, &mut loss.backward(), &mut by_name)?;
    Ok(by_name)
}

/// Takes the gradients of parameters in memory out of a finished backward pass and adds them to those that are there.
///
/// # Errors
/// When a gradient cannot be read from the device.
pub fn collect(leaves: &Parameters, graph: &mut burn::tensor::Gradients, by_name: &mut Gradients) -> Result<()> {
    for (name, parameter) in leaves.memory() {
        if let Some(gradient) = parameter.values.grad_remove(graph) {
            let values = to_host(gradient)?;
            match by_name.get_mut(name) {
                Some(sum) => sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value),
                None => drop(by_name.insert(name.clone(), values)),
            }
        }
    }
    Ok(())
}

/// Adds a share of the gradients of one clip to those of an update.
pub fn add(sum: &mut Gradients, share: f64, gradients: Gradients) {
    for (name, gradient) in gradients {
        let total = sum.entry(name).or_insert_with(|| vec![0.0; gradient.len()]);
        for (total, value) in total.iter_mut().zip(gradient) {
            *total += share as f32 * value;
        }
    }
}

/// Moves the parameters by update `step` (counted from 0); returns the norm of the gradients before clipping. When that is
/// not finite, nothing is moved.
///
/// # Errors
/// When a parameter cannot be read.
pub fn update(
    parameters: &mut Parameters,
    moments: &mut Moments,
    gradients: &Gradients,
    rule: &Rule<'_>,
    step: u64,
) -> Result<f64> {
    let size = norm(gradients);
    if !size.is_finite() {
        return Ok(size);
    }
    let clip = if size > rule.clip { rule.clip / size } else { 1.0 };
    let unbias = rule.betas.map(|beta| 1.0 - beta.powi(step as i32 + 1));
    let [beta1, beta2] = rule.betas;
    for (name, gradient) in gradients {
        let Some(rate) = (rule.rate)(name) else { continue };
        let rate = rate * rule.share;
        let shape = parameters.shape(name).unwrap_or_default().to_vec();
        let decay = (rule.weight_decay)(&shape);
        let mut values = parameters.host(name)?;
        let [first, second] = moments
            .by_name
            .entry(name.clone())
            .or_insert_with(|| [vec![0.0; gradient.len()], vec![0.0; gradient.len()]]);
        (values.par_iter_mut().zip(gradient))
            .zip(first.par_iter_mut().zip(second.par_iter_mut()))
            .for_each(|((value, &gradient), (first, second))| {
                let gradient = f64::from(gradient) * clip;
                let mean = beta1 * f64::from(*first) + (1.0 - beta1) * gradient;
                let square = beta2 * f64::from(*second) + (1.0 - beta2) * gradient * gradient;
                (*first, *second) = (mean as f32, square as f32);
                let direction = mean / unbias[0] / ((square / unbias[1]).sqrt() + EPSILON);
                let old = f64::from(*value);
                *value = (old - rate * (direction + decay * old)) as f32;
            });
        parameters.insert(name, &shape, values)?;
    }
    Ok(size)
}
