//! Normalisation of rows: layer norm, and by the root mean square.

use crate::lanes::sum;

/// Affine map and epsilon of a norm. `[width]` each
#[derive(Debug, Clone, Copy)]
pub struct Norm<'a> {
    /// Scale.
    pub weight: &'a [f32],
    /// Shift.
    pub bias: &'a [f32],
    /// Added to the variance.
    pub epsilon: f32,
    /// Whether the mean comes off first (layer norm), or values are divided by their root mean square as they are.
    pub centred: bool,
}

impl Norm<'_> {
    /// `(x - mean) / sqrt(variance + epsilon) * weight + bias` of one row, in place; without [`Self::centred`] the mean
    /// counts as 0.
    #[inline(always)]
    pub fn apply(&self, row: &mut [f32]) {
        let moments = if self.centred {
            moments(row, self.epsilon)
        } else {
            let square = sum(row, |value| value * value) / row.len() as f32;
            (0.0, inverse_deviation(square, self.epsilon))
        };
        self.apply_with(row, moments);
    }

    /// The same with sums one after the other: for the short rows of attention heads.
    #[inline(always)]
    pub(crate) fn apply_in_order(&self, row: &mut [f32]) {
        let count = row.len() as f32;
        let mean = if self.centred {
            row.iter().sum::<f32>() / count
        } else {
            0.0
        };
        let variance = row.iter().map(|value| (value - mean) * (value - mean)).sum::<f32>() / count;
        self.apply_with(row, (mean, inverse_deviation(variance, self.epsilon)));
    }

    #[inline(always)]
    fn apply_with(&self, row: &mut [f32], (mean, inverse): (f32, f32)) {
        for ((value, weight), bias) in row.iter_mut().zip(self.weight).zip(self.bias) {
            *value = ((*value - mean) * inverse).mul_add(*weight, *bias);
        }
    }
}

/// Mean and `1 / sqrt(variance + epsilon)` of a row.
#[inline(always)]
pub fn moments(row: &[f32], epsilon: f32) -> (f32, f32) {
    let count = row.len() as f32;
    let mean = sum(row, |value| value) / count;
    let variance = sum(row, |value| (value - mean) * (value - mean)) / count;
    (mean, inverse_deviation(variance, epsilon))
}

#[inline(always)]
fn inverse_deviation(variance: f32, epsilon: f32) -> f32 {
    1.0 / (variance + epsilon).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_get_the_mean_and_deviation_of_the_affine_map() {
        for count in [5usize, 16, 50] {
            let mut row: Vec<f32> = (0..count).map(|k| ((k * 7) % 11) as f32).collect();
            let mut other = row.clone();
            let (weight, bias) = (vec![2.0; count], vec![0.5; count]);
            let norm = Norm {
                weight: &weight,
                bias: &bias,
                epsilon: 0.0,
                centred: true,
            };
            norm.apply(&mut row);
            norm.apply_in_order(&mut other);
            let mean = row.iter().sum::<f32>() / count as f32;
            let variance = row.iter().map(|value| (value - mean) * (value - mean)).sum::<f32>() / count as f32;
            assert!(
                (mean - 0.5).abs() < 1e-5 && (variance - 4.0).abs() < 1e-4,
                "{mean} {variance}"
            );
            for (a, b) in row.iter().zip(&other) {
                assert!((a - b).abs() < 1e-5, "{a} {b}");
            }
        }
    }

    #[test]
    fn rows_are_divided_by_their_root_mean_square() {
        let row: Vec<f32> = (0..12).map(|k| ((k * 7) % 11) as f32 - 2.0).collect();
        let square: f64 = row.iter().map(|&value| f64::from(value).powi(2)).sum::<f64>() / 12.0;
        let (weight, bias) = (vec![3.0; 12], vec![0.0; 12]);
        let norm = Norm {
            weight: &weight,
            bias: &bias,
            epsilon: 0.25,
            centred: false,
        };
        let (mut found, mut other) = (row.clone(), row.clone());
        norm.apply(&mut found);
        norm.apply_in_order(&mut other);
        for ((value, found), other) in row.iter().zip(found).zip(other) {
            let expected = 3.0 * f64::from(*value) / (square + 0.25).sqrt();
            assert!((f64::from(found) - expected).abs() < 1e-5, "{found} {expected}");
            assert!((found - other).abs() < 1e-5, "{found} {other}");
        }
    }
}
