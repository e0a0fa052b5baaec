//! Bicubic resampling with antialiasing: weights of one axis.

use std::iter::Sum;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// The samples that make one output sample.
#[derive(Debug, Clone, PartialEq)]
pub struct CubicTaps {
    /// The first of them.
    pub start: usize,
    /// Their weights, which sum to one.
    pub weights: Vec<f32>,
}

/// The taps of the outputs `offset..offset + count` of an axis scaled from `from` to `to` samples; the kernel has
/// `a = -0.5` and is stretched where the axis shrinks.
///
/// `T` is what weights are computed in, f32 or f64, before they are rounded to f32: each user follows the library that its
/// reference values come from.
#[must_use]
pub fn cubic_taps<T>(from: usize, to: usize, offset: usize, count: usize) -> Vec<CubicTaps>
where
    T: Copy + PartialOrd + From<f32> + Into<f64> + Sum,
    T: Add<Output = T> + Sub<Output = T> + Mul<Output = T> + Div<Output = T> + Neg<Output = T>,
{
    let number = |value: f32| T::from(value);
    // Exact: an axis has fewer than 2^24 samples.
    let place = |index: usize| number(index as f32);
    let half = number(0.5);
    let scale = place(from) / place(to);
    let stretch = if scale > number(1.0) { scale } else { number(1.0) };
    let radius = number(2.0) * stretch;
    let taps = |index: usize| {
        let centre = scale * (place(index + offset) + half);
        // Casts cut towards zero, and below zero to it.
        let start = (centre - radius + half).into() as usize;
        let end = ((centre + radius + half).into() as usize).min(from);
        let raw: Vec<T> = (start..end)
            .map(|tap| cubic((place(tap) - centre + half) / stretch))
            .collect();
        let sum: T = raw.iter().copied().sum();
        let weight = |&raw: &T| (raw / sum).into() as f32;
        CubicTaps {
            start,
            weights: raw.iter().map(weight).collect(),
        }
    };
    (0..count).map(taps).collect()
}

/// The cubic convolution kernel with `a = -0.5`.
fn cubic<T>(offset: T) -> T
where
    T: Copy + PartialOrd + From<f32>,
    T: Add<Output = T> + Sub<Output = T> + Mul<Output = T> + Neg<Output = T>,
{
    let number = |value: f32| T::from(value);
    let t = if offset < number(0.0) { -offset } else { offset };
    if t < number(1.0) {
        (number(1.5) * t - number(2.5)) * t * t + number(1.0)
    } else if t < number(2.0) {
        ((number(-0.5) * t + number(2.5)) * t - number(4.0)) * t + number(2.0)
    } else {
        number(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_both_precisions_agree() {
        for (from, to) in [(5, 9), (9, 4), (37, 37), (3, 1), (1, 4)] {
            let (single, double) = (cubic_taps::<f32>(from, to, 0, to), cubic_taps::<f64>(from, to, 0, to));
            for (a, b) in single.iter().zip(&double) {
                assert_eq!(a.start, b.start);
                assert!((a.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
                for (a, b) in a.weights.iter().zip(&b.weights) {
                    assert!((a - b).abs() < 1e-6, "{from} to {to}: {a} {b}");
                }
            }
        }
        assert_eq!(cubic_taps::<f64>(9, 5, 2, 3), cubic_taps::<f64>(9, 5, 0, 5)[2..]);
    }

    #[test]
    fn the_kernel_interpolates() {
        assert_eq!([-2.0, -1.0, 0.0, 1.0, 2.0].map(cubic::<f64>), [0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(cubic(0.5f32), 0.5625);
        assert_eq!(cubic(-1.5f32), -0.0625);
    }
}
