//! Percentile bootstrap over clips (`docs/spec/scoring.md` section 8).

use rogs_random::Pcg64;

use crate::metrics::stats::pairwise_sum;

/// Resamples of an interval (paper).
pub const BOOTSTRAP_RESAMPLES: usize = 10_000;
/// Seed of every interval's own generator.
pub const BOOTSTRAP_SEED: u64 = 42;

/// A mean with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Interval {
    /// Mean of the values.
    pub mean: f64,
    /// 2.5 percentile of the resampled means.
    pub low: f64,
    /// 97.5 percentile of the resampled means.
    pub high: f64,
}

/// Means of [`BOOTSTRAP_RESAMPLES`] resamples with replacement, in draw order. Empty for no values.
///
/// The indices are numpy's `default_rng(42).integers(0, n, (10000, n))`, so that values of the same count are resampled
/// alike for every method and metric.
#[must_use]
pub fn bootstrap_means(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    let Ok(count) = u32::try_from(n) else { return Vec::new() };
    if count == 0 {
        return Vec::new();
    }
    let mut rng = Pcg64::from_seed(BOOTSTRAP_SEED);
    let mut resample = vec![0.0; n];
    let mut draw = |_| {
        resample
            .iter_mut()
            .for_each(|value| *value = values[rng.lemire(count - 1) as usize]);
        pairwise_sum(&resample) / n as f64
    };
    (0..BOOTSTRAP_RESAMPLES).map(&mut draw).collect()
}

/// Mean and 95 % percentile interval; `None` of nothing.
#[must_use]
pub fn bootstrap_interval(values: &[f64]) -> Option<Interval> {
    let mut means = bootstrap_means(values);
    if means.is_empty() {
        return None;
    }
    means.sort_unstable_by(f64::total_cmp);
    let mean = pairwise_sum(values) / values.len() as f64;
    Some(Interval {
        mean,
        low: percentile(&means, 0.025),
        high: percentile(&means, 0.975),
    })
}

/// Percentile of sorted values with linear interpolation, rounded as numpy rounds it.
fn percentile(sorted: &[f64], fraction: f64) -> f64 {
    let position = fraction * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    let weight = position - below as f64;
    let step = sorted[above] - sorted[below];
    // From the nearer end, so that weight 1 gives exactly the upper value.
    if weight >= 0.5 {
        sorted[above] - step * (1.0 - weight)
    } else {
        sorted[below] + step * weight
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_clip_has_no_spread() {
        assert_eq!(
            bootstrap_interval(&[3.5]),
            Some(Interval {
                mean: 3.5,
                low: 3.5,
                high: 3.5
            })
        );
        assert_eq!(bootstrap_interval(&[]), None);
    }
}
