//! Adam: the update rule of one array of parameters.

use rayon::prelude::*;

use crate::error::{Result, expect};

/// Decay rates of the two moments.
const BETAS: [f64; 2] = [0.9, 0.999];
/// Keeps a division by a zero moment finite.
const EPSILON: f64 = 1e-8;
/// Parameters of one piece of work.
const PIECE: usize = 1 << 14;

/// The two moments of an array of parameters, and how many updates they have seen.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Adam {
    /// Running mean of the gradients.
    pub first: Vec<f32>,
    /// Running mean of their squares.
    pub second: Vec<f32>,
    /// Updates so far.
    pub updates: u32,
}

impl Adam {
    /// For `count` parameters, before the first update.
    #[must_use]
    pub fn new(count: usize) -> Self {
        Self {
            first: vec![0.0; count],
            second: vec![0.0; count],
            updates: 0,
        }
    }

    /// Moves the parameters against their gradients; `rate` is the learning rate of this update.
    ///
    /// # Errors
    /// When the lengths differ.
    pub fn update(&mut self, rate: f64, parameters: &mut [f32], gradients: &[f32]) -> Result<()> {
        expect("parameters", parameters.len(), self.first.len())?;
        expect("gradients", gradients.len(), self.first.len())?;
        self.updates += 1;
        let [keep_first, keep_second] = BETAS.map(|beta| beta as f32);
        let [take_first, take_second] = BETAS.map(|beta| (1.0 - beta) as f32);
        let [seen_first, seen_second] = BETAS.map(|beta| 1.0 - libm::pow(beta, f64::from(self.updates)));
        let step = (rate / seen_first) as f32;
        let inverse = (1.0 / seen_second.sqrt()) as f32;
        let epsilon = EPSILON as f32;
        (parameters.par_chunks_mut(PIECE))
            .zip(gradients.par_chunks(PIECE))
            .zip(self.first.par_chunks_mut(PIECE))
            .zip(self.second.par_chunks_mut(PIECE))
            .for_each(|(((parameters, gradients), first), second)| {
                for (((parameter, &gradient), first), second) in
                    parameters.iter_mut().zip(gradients).zip(first).zip(second)
                {
                    *first = keep_first * *first + take_first * gradient;
                    *second = keep_second * *second + take_second * gradient * gradient;
                    *parameter -= step * *first / (second.sqrt() * inverse + epsilon);
                }
            });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn updates_follow_the_definition() {
        let gradients = [[0.5, -2.0, 0.0], [0.25, 1.0, 1e-6], [-0.5, 0.1, 3.0]];
        let (mut parameters, mut adam) = ([1.0f32, -1.0, 0.5], Adam::new(3));
        for gradient in gradients {
            let gradient = gradient.map(|value: f64| value as f32);
            adam.update(0.01, &mut parameters, &gradient).unwrap();
        }
        for k in 0..3 {
            let (mut expected, mut m, mut v) = ([1.0, -1.0, 0.5][k], 0.0, 0.0);
            for (step, gradient) in gradients.iter().enumerate() {
                m = 0.9 * m + 0.1 * gradient[k];
                v = 0.999 * v + 0.001 * gradient[k] * gradient[k];
                let power = step as i32 + 1;
                let (m, v): (f64, f64) = (m / (1.0 - 0.9f64.powi(power)), v / (1.0 - 0.999f64.powi(power)));
                expected -= 0.01 * m / (v.sqrt() + 1e-8);
            }
            assert!(
                (f64::from(parameters[k]) - expected).abs() < 1e-6,
                "{k}: {} {expected}",
                parameters[k]
            );
        }
        assert!(adam.update(0.01, &mut parameters, &[0.0; 2]).is_err());
    }
}
