//! Losses with their gradients (`docs/spec/baseline-som.md` section 6).
//!
//! Every function gives the value and the gradient with respect to what it was given first. Values below a quantile are
//! chosen anew at every call; the choice itself has no gradient.

pub mod image;
pub mod robust;
pub mod smoothness;
pub mod ssim;

/// A loss and its gradient, laid out as what the loss was taken of.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Loss {
    /// The value.
    pub value: f64,
    /// The gradient.
    pub gradient: Vec<f32>,
}

impl Loss {
    /// Adds another loss of the same array, times a weight.
    pub fn add(&mut self, weight: f64, other: &Self) {
        self.value += weight * other.value;
        for (to, &from) in self.gradient.iter_mut().zip(&other.gradient) {
            *to += weight as f32 * from;
        }
    }
}

#[cfg(test)]
pub(crate) mod differences {
    use super::Loss;

    /// Compares a gradient with central differences of the value.
    pub(crate) fn check(values: &[f32], step: f32, tolerance: f64, loss: impl Fn(&[f32]) -> Loss) {
        let found = loss(values).gradient;
        assert_eq!(found.len(), values.len());
        for k in 0..values.len() {
            let at = |step: f32| {
                let mut moved = values.to_vec();
                moved[k] += step;
                (loss(&moved).value, f64::from(moved[k]))
            };
            let ((above, high), (below, low)) = (at(step), at(-step));
            let expected = (above - below) / (high - low);
            let difference = (f64::from(found[k]) - expected).abs();
            assert!(
                difference < tolerance * (1.0 + expected.abs()),
                "{k}: {} {expected}",
                found[k]
            );
        }
    }

    /// Numbers without a pattern, between -1 and 1.
    pub(crate) fn numbers(count: usize, seed: u32) -> Vec<f32> {
        let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(12345);
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        (0..count).map(|_| next()).collect()
    }
}
