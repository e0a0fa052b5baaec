//! Times and memory of one clip (`docs/spec/scoring.md` section 9).

use serde::{Deserialize, Serialize};

use crate::metrics::mean;

/// Bytes of a GiB, the unit of memory in tables.
pub(crate) const GIB: f64 = 1024.0 * 1024.0 * 1024.0;

/// What one clip cost one method. Absent fields were not measured or do not apply; they are never 0 for that.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ClipTiming {
    /// Method label, as in the score sheets.
    pub method: String,
    /// `recorded` or `rollout`.
    pub setting: String,
    /// Clip.
    pub clip_id: String,
    /// Preparation of a method's own inputs, seconds.
    pub preprocess_s: Option<f64>,
    /// Reconstruction: lifting, inference or optimisation, seconds.
    pub lift_s: Option<f64>,
    /// Refinement and fit, seconds.
    pub refine_s: Option<f64>,
    /// Rendering of the query plan, seconds.
    pub render_query_s: Option<f64>,
    /// Rendering of displacements, seconds.
    pub render_displacement_s: Option<f64>,
    /// Transformation into the robot frame and merging, seconds.
    pub transform_merge_s: Option<f64>,
    /// Peak memory allocated on the device, bytes.
    pub peak_bytes: Option<u64>,
    /// Peak resident memory of the process, bytes; what is recorded on a CPU.
    pub peak_rss_bytes: Option<u64>,
    /// Device name.
    pub device: String,
    /// Threads used.
    pub threads: Option<u32>,
    /// The first clip of a process; left out of means.
    pub warmup: bool,
}

/// Which parts a method's reported time is the sum of (paper, appendix on efficiency).
#[must_use]
pub fn reported_seconds(timing: &ClipTiming) -> Option<f64> {
    let base = timing.method.split('/').next().unwrap_or_default();
    let ClipTiming {
        preprocess_s,
        lift_s,
        refine_s,
        render_query_s,
        render_displacement_s,
        transform_merge_s,
        ..
    } = *timing;
    let (required, optional): (&[Option<f64>], &[Option<f64>]) = match base {
        "movies" => (&[lift_s, render_query_s], &[transform_merge_s]),
        "4dgt" => (&[lift_s, render_query_s], &[preprocess_s, render_displacement_s]),
        "som" => (&[lift_s, render_query_s], &[preprocess_s]),
        "stage1+2" | "fit" => (&[lift_s, refine_s, render_query_s], &[]),
        _ => (&[lift_s, render_query_s], &[refine_s]),
    };
    let required: Option<Vec<f64>> = required.iter().copied().collect();
    Some(required?.iter().sum::<f64>() + optional.iter().flatten().sum::<f64>())
}

/// Mean over the clips of a method that are not warm-up and have the value.
#[must_use]
pub fn mean_of(
    timings: &[ClipTiming],
    setting: &str,
    method: &str,
    value: impl Fn(&ClipTiming) -> Option<f64>,
) -> Option<(f64, usize)> {
    let own = timings
        .iter()
        .filter(|t| t.setting == setting && t.method == method && !t.warmup);
    let values: Vec<f64> = own.filter_map(value).collect();
    Some((mean(&values)?, values.len()))
}

/// Largest peak memory of a method in bytes, and whether it is resident memory instead of device memory.
#[must_use]
pub fn peak_memory(timings: &[ClipTiming], setting: &str, method: &str) -> Option<(u64, bool)> {
    let own = || timings.iter().filter(|t| t.setting == setting && t.method == method);
    let device = own().filter_map(|t| t.peak_bytes).max();
    let resident = own().filter_map(|t| t.peak_rss_bytes).max();
    device
        .map(|bytes| (bytes, false))
        .or_else(|| resident.map(|bytes| (bytes, true)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reported_time_follows_the_method() {
        let all = ClipTiming {
            preprocess_s: Some(1.0),
            lift_s: Some(2.0),
            refine_s: Some(4.0),
            render_query_s: Some(8.0),
            render_displacement_s: Some(16.0),
            transform_merge_s: Some(32.0),
            ..ClipTiming::default()
        };
        let of = |method: &str| {
            reported_seconds(&ClipTiming {
                method: method.into(),
                ..all.clone()
            })
        };
        assert_eq!(of("stage1+2/no-fk"), Some(14.0));
        assert_eq!(of("movies"), Some(42.0));
        assert_eq!(of("4dgt"), Some(27.0));
        assert_eq!(of("som"), Some(11.0));
        let unrefined = ClipTiming {
            refine_s: None,
            method: "stage1+2".into(),
            ..all.clone()
        };
        assert_eq!(reported_seconds(&unrefined), None);
    }

    #[test]
    fn warm_up_clips_are_left_out() {
        let one = |seconds, warmup| ClipTiming {
            lift_s: Some(seconds),
            warmup,
            ..ClipTiming::default()
        };
        assert_eq!(
            mean_of(&[one(9.0, true), one(1.0, false), one(3.0, false)], "", "", |t| t
                .lift_s),
            Some((2.0, 2))
        );
    }
}
