//! Absolute differences without the largest ones: of images, disparities and tracks.

use crate::error::{Result, expect};
use crate::losses::Loss;
use crate::statistics::quantile;

/// Added to sums of weights in divisions.
const EPSILON: f64 = 1e-8;
/// Added to depths before they become disparities.
const DEPTH_EPSILON: f64 = 1e-5;

/// Weighted mean of the absolute differences `e` (mean over channels) of the elements below the `share` quantile of all
/// `e`: `sum(w e) / (sum(w) + 1e-8)`; a share of 1 keeps all. `prediction`, `target` `[N, channels]`; `weights [N]`
///
/// # Errors
/// When the lengths differ.
pub fn masked_l1(prediction: &[f32], target: &[f32], weights: &[f32], share: f64) -> Result<Loss> {
    let channels = prediction.len().checked_div(weights.len()).unwrap_or(1).max(1);
    expect("predictions", prediction.len(), channels * weights.len())?;
    expect("targets", target.len(), prediction.len())?;
    let errors = errors(prediction, target, channels);
    let limit = limit(&errors, share);
    let (mut sum, mut total) = (0.0, EPSILON);
    for (&error, &weight) in errors.iter().zip(weights) {
        if error < limit {
            sum += f64::from(weight) * error;
            total += f64::from(weight);
        }
    }
    let factor = |index: usize| {
        if errors[index] < limit {
            f64::from(weights[index]) / total
        } else {
            0.0
        }
    };
    Ok(Loss {
        value: sum / total,
        gradient: signs(prediction, target, channels, factor),
    })
}

/// Plain mean of the absolute differences below their `share` quantile; 0 where nothing is below. `[N]`
///
/// # Errors
/// When the lengths differ.
pub fn trimmed_l1(prediction: &[f32], target: &[f32], share: f64) -> Result<Loss> {
    expect("targets", target.len(), prediction.len())?;
    let errors = errors(prediction, target, 1);
    let limit = limit(&errors, share);
    let kept: Vec<f64> = errors.iter().copied().filter(|&error| error < limit).collect();
    let count = kept.len().max(1) as f64;
    Ok(Loss {
        value: kept.iter().sum::<f64>() / count,
        gradient: signs(prediction, target, 1, |index| {
            if errors[index] < limit { 1.0 / count } else { 0.0 }
        }),
    })
}

/// Trimmed differences of the gradients in x and in y of two maps, where both pixels are valid; the two means are added.
/// `[B, height, width]`
///
/// # Errors
/// When the lengths differ.
pub fn gradient_l1(
    prediction: &[f32],
    target: &[f32],
    valid: &[bool],
    height: usize,
    width: usize,
    share: f64,
) -> Result<Loss> {
    expect("targets", target.len(), prediction.len())?;
    expect("valid pixels", valid.len(), prediction.len())?;
    let area = height * width;
    expect("predictions", prediction.len() % area.max(1), 0)?;
    let mut loss = Loss {
        value: 0.0,
        gradient: vec![0.0; prediction.len()],
    };
    for (step, rows, columns) in [
        (1, height, width.saturating_sub(1)),
        (width, height.saturating_sub(1), width),
    ] {
        let mut pairs = Vec::new();
        for first in (0..prediction.len()).step_by(area.max(1)) {
            for row in 0..rows {
                let starts = (0..columns).map(|column| first + row * width + column);
                pairs.extend(starts.filter(|&at| valid[at] && valid[at + step]));
            }
        }
        let difference = |map: &[f32]| -> Vec<f32> { pairs.iter().map(|&at| map[at + step] - map[at]).collect() };
        let own = trimmed_l1(&difference(prediction), &difference(target), share)?;
        loss.value += own.value;
        for (&at, &gradient) in pairs.iter().zip(&own.gradient) {
            loss.gradient[at + step] += gradient;
            loss.gradient[at] -= gradient;
        }
    }
    Ok(loss)
}

/// As [`masked_l1`], of the disparities `1 / (z + 1e-5)` of two depths. `[N]`
///
/// # Errors
/// When the lengths differ.
pub fn disparity_l1(depth: &[f32], target: &[f32], weights: &[f32], share: f64) -> Result<Loss> {
    expect("depths", depth.len(), weights.len())?;
    let disparity = |z: &f32| (1.0 / (f64::from(*z) + DEPTH_EPSILON)) as f32;
    let own: Vec<f32> = depth.iter().map(disparity).collect();
    let other: Vec<f32> = target.iter().map(disparity).collect();
    let mut loss = masked_l1(&own, &other, weights, share)?;
    for (gradient, &disparity) in loss.gradient.iter_mut().zip(&own) {
        *gradient *= -disparity * disparity;
    }
    Ok(loss)
}

/// Differences of tracked image positions where they are visible, in units of the longer image side. `[N, 2]`
///
/// # Errors
/// When the lengths differ.
pub fn track_2d(
    positions: &[f32],
    tracks: &[f32],
    visible: &[bool],
    confidence: &[f32],
    longer_side: f64,
    share: f64,
) -> Result<Loss> {
    expect("tracked positions", positions.len(), 2 * visible.len())?;
    expect("tracks", tracks.len(), positions.len())?;
    expect("confidences", confidence.len(), visible.len())?;
    let seen: Vec<usize> = (0..visible.len()).filter(|&index| visible[index]).collect();
    let pick = |values: &[f32]| -> Vec<f32> { seen.iter().flat_map(|&k| [values[2 * k], values[2 * k + 1]]).collect() };
    let weights: Vec<f32> = seen.iter().map(|&k| confidence[k]).collect();
    let own = masked_l1(&pick(positions), &pick(tracks), &weights, share)?;
    let mut gradient = vec![0.0; positions.len()];
    for (from, &index) in own.gradient.chunks_exact(2).zip(&seen) {
        for axis in 0..2 {
            gradient[2 * index + axis] = (f64::from(from[axis]) / longer_side) as f32;
        }
    }
    Ok(Loss {
        value: own.value / longer_side,
        gradient,
    })
}

/// Mean over channels of the absolute differences. `[N]`
fn errors(prediction: &[f32], target: &[f32], channels: usize) -> Vec<f64> {
    let pairs = prediction.chunks_exact(channels).zip(target.chunks_exact(channels));
    pairs
        .map(|(a, b)| {
            let differences = a.iter().zip(b).map(|(&a, &b)| (f64::from(a) - f64::from(b)).abs());
            differences.sum::<f64>() / channels as f64
        })
        .collect()
}

fn limit(errors: &[f64], share: f64) -> f64 {
    if share < 1.0 {
        quantile(errors, share).unwrap_or(f64::INFINITY)
    } else {
        f64::INFINITY
    }
}

/// Signs of the differences over the number of channels, times a factor per element.
fn signs(prediction: &[f32], target: &[f32], channels: usize, factor: impl Fn(usize) -> f64) -> Vec<f32> {
    let pairs = prediction.iter().zip(target).enumerate();
    pairs
        .map(|(k, (&a, &b))| {
            let sign = if a == b { 0.0 } else { f64::from((a - b).signum()) };
            (sign * factor(k / channels) / channels as f64) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::losses::differences::{check, numbers};

    #[test]
    fn gradients_are_those_of_central_differences() {
        let (values, target) = (numbers(60, 1), numbers(60, 2));
        let weights: Vec<f32> = numbers(30, 3).iter().map(|v| v.abs()).collect();
        for share in [1.0, 0.9] {
            check(&values, 1e-4, 1e-3, |v| masked_l1(v, &target, &weights, share).unwrap());
            check(&values, 1e-4, 1e-3, |v| trimmed_l1(v, &target, share).unwrap());
        }
        let valid: Vec<bool> = numbers(60, 4).iter().map(|&v| v > -0.6).collect();
        check(&values, 1e-4, 1e-3, |v| {
            gradient_l1(v, &target, &valid, 5, 6, 0.95).unwrap()
        });
        let depth: Vec<f32> = values.iter().map(|v| 2.0 + v).collect();
        let other: Vec<f32> = target.iter().map(|v| 2.0 + v).collect();
        let ones = vec![1.0; 60];
        check(&depth, 1e-3, 1e-3, |v| disparity_l1(v, &other, &ones, 0.98).unwrap());
        check(&values, 1e-4, 1e-3, |v| {
            track_2d(v, &target, &valid[..30], &weights, 20.0, 0.98).unwrap()
        });
    }

    #[test]
    fn nothing_to_compare_is_no_loss() {
        assert_eq!(masked_l1(&[], &[], &[], 0.98).unwrap().value, 0.0);
        assert_eq!(trimmed_l1(&[], &[], 0.95).unwrap().value, 0.0);
        assert!(masked_l1(&[1.0], &[], &[1.0], 1.0).is_err());
    }
}
