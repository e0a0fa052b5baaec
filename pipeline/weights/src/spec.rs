//! What tensors a network has: names, shapes, and how they start without a file. Seeded values depend on the seed, the
//! tensor's name and the position in it, on nothing else.

use std::collections::BTreeMap;

use crate::{Error, ParameterSource, Result};

/// How a parameter starts when no checkpoint gives it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Initial {
    /// All equal.
    Constant(f32),
    /// Normal with mean 0.
    Normal {
        /// Standard deviation.
        std: f32,
    },
    /// Uniform in plus or minus 1 / sqrt(fan in), the default of linear and convolution layers in PyTorch.
    Uniform {
        /// Inputs that feed one output.
        fan_in: usize,
    },
}

/// A parameter of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterSpec {
    /// Name in the checkpoint.
    pub name: String,
    /// Shape.
    pub shape: Vec<usize>,
    /// Initial values.
    pub initial: Initial,
}

impl ParameterSpec {
    /// Number of values.
    #[must_use]
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// True when the shape has no value.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Values from its distribution.
    #[must_use]
    pub fn drawn(&self, seed: u64) -> Vec<f32> {
        let (count, key) = (self.len(), mix(seed ^ mix(hash(self.name.as_bytes()))));
        match self.initial {
            Initial::Constant(value) => vec![value; count],
            Initial::Uniform { fan_in } => {
                let bound = 1.0 / (fan_in.max(1) as f64).sqrt();
                (0..count as u64)
                    .map(|index| ((2.0 * unit(key, index) - 1.0) * bound) as f32)
                    .collect()
            }
            Initial::Normal { std } => {
                // Box and Muller, the cosine branch only: one value per pair of counters.
                let value = |index: u64| {
                    let radius = (-2.0 * libm::log(1.0 - unit(key, 2 * index))).sqrt();
                    (radius * libm::cos(std::f64::consts::TAU * unit(key, 2 * index + 1)) * f64::from(std)) as f32
                };
                (0..count as u64).map(value).collect()
            }
        }
    }
}

/// Seeded parameters, drawn when asked for.
pub struct Seeded {
    specs: BTreeMap<String, ParameterSpec>,
    seed: u64,
}

impl Seeded {
    /// Parameters from a seed.
    #[must_use]
    pub fn new(specs: Vec<ParameterSpec>, seed: u64) -> Self {
        let specs = specs.into_iter().map(|spec| (spec.name.clone(), spec)).collect();
        Self { specs, seed }
    }
}

impl ParameterSource for Seeded {
    fn shape(&self, name: &str) -> Option<&[usize]> {
        self.specs.get(name).map(|spec| spec.shape.as_slice())
    }

    fn values(&self, name: &str) -> Result<Vec<f32>> {
        let spec = self.specs.get(name);
        let spec = spec.ok_or_else(|| Error::MissingTensor { name: name.to_owned() })?;
        Ok(spec.drawn(self.seed))
    }

    fn names(&self) -> Vec<&str> {
        self.specs.keys().map(String::as_str).collect()
    }
}

/// A number in [0, 1) from a key and a counter.
fn unit(key: u64, counter: u64) -> f64 {
    (mix(key.wrapping_add(counter.wrapping_mul(0x9e37_79b9_7f4a_7c15))) >> 11) as f64 / (1u64 << 53) as f64
}

/// The finaliser of SplitMix64: a bijection of 64-bit numbers that passes statistical tests on counters.
fn mix(value: u64) -> u64 {
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

/// FNV-1a.
fn hash(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(name: &str, count: usize, initial: Initial, seed: u64) -> Vec<f32> {
        let (name, shape) = (name.to_owned(), vec![count]);
        ParameterSpec { name, shape, initial }.drawn(seed)
    }

    fn moments(values: &[f32]) -> (f64, f64) {
        let mean = values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64;
        let variance = values
            .iter()
            .map(|&value| (f64::from(value) - mean).powi(2))
            .sum::<f64>()
            / values.len() as f64;
        (mean, variance.sqrt())
    }

    #[test]
    fn draws_have_the_moments_of_their_distribution() {
        let (mean, std) = moments(&draw("a", 100_000, Initial::Normal { std: 0.02 }, 7));
        assert!(mean.abs() < 3e-4 && (std / 0.02 - 1.0).abs() < 0.02, "{mean} {std}");
        let uniform = draw("a", 100_000, Initial::Uniform { fan_in: 16 }, 7);
        let (mean, std) = moments(&uniform);
        assert!(
            mean.abs() < 2e-3 && (std / (0.25 / 3f64.sqrt()) - 1.0).abs() < 0.02,
            "{mean} {std}"
        );
        assert!(uniform.iter().all(|value| value.abs() <= 0.25));
    }

    #[test]
    fn tensors_differ_by_name_and_by_seed() {
        let draw = |name, seed| draw(name, 8, Initial::Normal { std: 1.0 }, seed);
        assert_eq!(draw("a", 1), draw("a", 1));
        assert_ne!(draw("a", 1), draw("b", 1));
        assert_ne!(draw("a", 1), draw("a", 2));
    }
}
