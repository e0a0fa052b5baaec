//! Layer normalisation of rows.

use crate::lanes::sum;

/// Affine map and epsilon of a layer norm. `[width]` each
#[derive(Debug, Clone, Copy)]
pub struct Norm<'a> {
    /// Scale.
    pub weight: &'a [f32],
    /// Shift.
    pub bias: &'a [f32],
    /// Added to the variance.
    pub epsilon: f32,
}

impl Norm<'_> {
    /// `(x - mean) / sqrt(variance + epsilon) * weight + bias` of one row, in place.
    #[inline(always)]
    pub fn apply(&self, row: &mut [f32]) {
        let moments = moments(row, self.epsilon);
        self.apply_with(row, moments);
    }

    /// The same with sums one after the other: for the short rows of attention heads.
    #[inline(always)]
    pub(crate) fn apply_in_order(&self, row: &mut [f32]) {
        let count = row.len() as f32;
        let mean = row.iter().sum::<f32>() / count;
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
}
