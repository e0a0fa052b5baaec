//! Depth metrics over a support that does not depend on the prediction (`docs/spec/scoring.md` section 5).

use crate::metrics::stats::median;

/// Reference depths of the far diagnostic, metres, both ends included.
pub const FAR_RANGE_M: [f32; 2] = [1.5, 5.0];

/// Depth errors over one support.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthScores {
    /// Mean of `|z_hat - z| / z`.
    pub absrel: f64,
    /// Root of the mean squared difference, metres.
    pub rmse_m: f64,
    /// Fraction of pixels with `z / 1.25 < z_hat < 1.25 z`, in 0..=1.
    pub delta1: f64,
    /// Pixels of the support.
    pub count: u64,
}

/// The pixels that count: reference finite and strictly inside the range, metres.
#[must_use]
pub fn depth_support(reference: &[f32], range_m: [f32; 2]) -> Vec<bool> {
    reference
        .iter()
        .map(|&depth| depth.is_finite() && depth > range_m[0] && depth < range_m[1])
        .collect()
}

/// The part of a support with reference depths in [`FAR_RANGE_M`].
#[must_use]
pub fn far_support(reference: &[f32], support: &[bool]) -> Vec<bool> {
    let far = |depth: f32| (FAR_RANGE_M[0]..=FAR_RANGE_M[1]).contains(&depth);
    reference
        .iter()
        .zip(support)
        .map(|(&depth, &supported)| supported && far(depth))
        .collect()
}

/// Depth errors of `scale * prediction`; undefined predictions (NaN, infinite) count as 0. `None` on empty support.
///
/// The three slices have one entry a pixel.
#[must_use]
pub fn depth_scores(prediction: &[f32], reference: &[f32], support: &[bool], scale: f64) -> Option<DepthScores> {
    let (mut relative, mut squared, mut close, mut count) = (0.0, 0.0, 0u64, 0u64);
    for ((&predicted, &truth), _) in prediction
        .iter()
        .zip(reference)
        .zip(support)
        .filter(|(_, supported)| **supported)
    {
        let predicted = scale * f64::from(if predicted.is_finite() { predicted } else { 0.0 });
        let truth = f64::from(truth);
        let difference = predicted - truth;
        relative += difference.abs() / truth;
        squared += difference * difference;
        close += u64::from(truth / 1.25 < predicted && predicted < 1.25 * truth);
        count += 1;
    }
    let n = count as f64;
    (count > 0).then(|| DepthScores {
        absrel: relative / n,
        rmse_m: (squared / n).sqrt(),
        delta1: close as f64 / n,
        count,
    })
}

/// The factor that brings the median of `z / z_hat` over supported pixels with a positive prediction to 1; 1 if none.
///
/// A diagnostic for methods without a metric scale: it uses the target and never enters the main tables.
#[must_use]
pub fn median_scale(prediction: &[f32], reference: &[f32], support: &[bool]) -> f64 {
    let ratio = |((&predicted, &truth), &supported): ((&f32, &f32), &bool)| {
        (supported && predicted.is_finite() && predicted > 0.0).then(|| f64::from(truth) / f64::from(predicted))
    };
    let ratios = prediction
        .iter()
        .zip(reference)
        .zip(support)
        .filter_map(ratio)
        .collect();
    median(ratios).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_range_is_open() {
        let reference = [0.1, 0.100_001, 4.999_999, 5.0, f32::NAN, f32::INFINITY, 0.0, -1.0];
        let expected = [false, true, true, false, false, false, false, false];
        assert_eq!(depth_support(&reference, [0.1, 5.0]), expected);
    }

    #[test]
    fn the_delta_bounds_are_open() {
        let reference = [1.0, 1.25, 1.0, 1.25];
        let scores = depth_scores(&[1.25, 1.0, 1.249, 1.001], &reference, &[true; 4], 1.0).unwrap();
        assert_eq!(scores.delta1, 0.5);
    }

    #[test]
    fn undefined_and_zero_predictions_count_as_zero_depth() {
        let scores = depth_scores(&[f32::NAN, f32::INFINITY, 0.0], &[1.0, 2.0, 4.0], &[true; 3], 1.0).unwrap();
        assert_eq!((scores.absrel, scores.delta1, scores.count), (1.0, 0.0, 3));
        assert_eq!(scores.rmse_m, 7f64.sqrt());
    }

    #[test]
    fn no_support_is_no_score() {
        assert_eq!(depth_scores(&[1.0], &[f32::NAN], &[false], 1.0), None);
        assert_eq!(median_scale(&[1.0], &[f32::NAN], &[false]), 1.0);
        assert_eq!(median_scale(&[0.0, -1.0], &[1.0, 1.0], &[true; 2]), 1.0);
    }

    #[test]
    fn the_median_scale_takes_the_mean_of_the_middle_two() {
        assert_eq!(
            median_scale(&[1.0, 1.0, 1.0, 1.0], &[1.0, 2.0, 3.0, 4.0], &[true; 4]),
            2.5
        );
    }

    #[test]
    fn far_is_a_closed_part_of_the_support() {
        assert_eq!(
            far_support(&[1.4, 1.5, 3.0, 3.0], &[true, true, true, false]),
            [false, true, true, false]
        );
    }
}
