//! AdamW with a rate and a decay per parameter (`docs/spec/stage1.md` section 15, `docs/spec/stage2.md` section B.8).

use std::collections::BTreeMap;

use burn::tensor::Tensor;
use rayon::prelude::*;
use rogs_kernels::vectorised;

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
    let squares: Vec<f64> = gradients.par_iter().map(|(_, values)| square(values)).collect();
    squares.into_iter().sum::<f64>().sqrt()
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
pub fn add(sum: &mut Gradients, share: f64, mut gradients: Gradients) {
    let share = share as f32;
    sum.par_iter_mut().for_each(|(name, total)| {
        for (total, value) in total.iter_mut().zip(gradients.get(name).into_iter().flatten()) {
            *total += share * value;
        }
    });
    gradients.retain(|name, _| !sum.contains_key(name));
    gradients
        .par_iter_mut()
        .for_each(|(_, values)| values.iter_mut().for_each(|value| *value *= share));
    sum.append(&mut gradients);
}

/// These gradients, all smaller by one factor where their norm is above `most`; as they are where it is not finite.
#[must_use]
pub fn clipped(mut gradients: Gradients, most: f64) -> Gradients {
    let size = norm(&gradients);
    if size > most && size.is_finite() {
        let share = (most / size) as f32;
        gradients
            .par_iter_mut()
            .for_each(|(_, values)| values.iter_mut().for_each(|value| *value *= share));
    }
    gradients
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
    let mut moved = Vec::with_capacity(gradients.len());
    for (name, gradient) in gradients {
        let Some(rate) = (rule.rate)(name) else { continue };
        let (shape, values) = (
            parameters.shape(name).unwrap_or_default().to_vec(),
            parameters.host(name)?,
        );
        let zeros = || vec![0.0; gradient.len()];
        let one = Moved {
            rate: rate * rule.share,
            decay: (rule.weight_decay)(&shape),
            moments: moments.by_name.remove(name).unwrap_or_else(|| [zeros(), zeros()]),
            name: name.clone(),
            shape,
            values,
        };
        moved.push((one, gradient));
    }
    let step = Step {
        clip,
        betas: rule.betas,
        unbias,
    };
    moved
        .par_iter_mut()
        .for_each(|(one, gradient)| step.apply(one, gradient));
    for (one, _) in moved {
        parameters.insert(&one.name, &one.shape, one.values)?;
        moments.by_name.insert(one.name, one.moments);
    }
    Ok(size)
}

/// A parameter that an update moves.
struct Moved {
    name: String,
    shape: Vec<usize>,
    values: Vec<f32>,
    moments: [Vec<f32>; 2],
    rate: f64,
    decay: f64,
}

/// What all parameters of an update have in common.
struct Step {
    /// What gradients are multiplied with.
    clip: f64,
    betas: [f64; 2],
    /// What the moments are divided by.
    unbias: [f64; 2],
}

impl Step {
    /// Moves one parameter.
    fn apply(&self, moved: &mut Moved, gradient: &[f32]) {
        let Self { clip, betas, unbias } = *self;
        let Moved {
            values,
            moments: [first, second],
            rate,
            decay,
            ..
        } = moved;
        let (rate, decay, [beta1, beta2]) = (*rate, *decay, betas);
        vectorised(
            #[inline(always)]
            || {
                let moments = first.iter_mut().zip(second.iter_mut());
                for ((value, &gradient), (first, second)) in values.iter_mut().zip(gradient).zip(moments) {
                    let gradient = f64::from(gradient) * clip;
                    let mean = beta1 * f64::from(*first) + (1.0 - beta1) * gradient;
                    let square = beta2 * f64::from(*second) + (1.0 - beta2) * gradient * gradient;
                    (*first, *second) = (mean as f32, square as f32);
                    let direction = mean / unbias[0] / ((square / unbias[1]).sqrt() + EPSILON);
                    let old = f64::from(*value);
                    *value = (old - rate * (direction + decay * old)) as f32;
                }
            },
        );
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::{Gradients, clipped, norm};

    #[test]
    fn gradients_are_clipped_together() {
        let gradients: Gradients = [("a".to_owned(), vec![3.0, 0.0]), ("b".to_owned(), vec![4.0])].into();
        assert_eq!(clipped(gradients.clone(), 5.0), gradients);
        let half = clipped(gradients.clone(), 2.5);
        assert!((norm(&half) - 2.5).abs() < 1e-6);
        assert_eq!((half["a"][0], half["b"][0]), (1.5, 2.0));
        let broken: Gradients = [("a".to_owned(), vec![f32::NAN])].into();
        assert!(clipped(broken, 1.0)["a"][0].is_nan());
    }
}
