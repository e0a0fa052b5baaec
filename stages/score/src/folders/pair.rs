//! Scores of one image or depth map against its reference.

use rogs_geometry::unit_factor;
use schemars::JsonSchema;
use serde::Serialize;

use super::error::FolderError;
use crate::metrics::{MetricError, RgbView, SsimVariant, depth_scores, depth_support, median_scale, psnr, ssim};
use crate::pictures::{Content, Picture};

/// Reference depths that count, metres, both ends excluded (`docs/spec/scoring.md` section 5).
pub const DEPTH_RANGE_M: [f32; 2] = [0.1, 5.0];

/// Scores of one pair of images or depth maps. What does not apply, or cannot be measured, is none.
#[derive(Debug, Clone, PartialEq, Default, Serialize, JsonSchema)]
pub struct PairScores {
    /// File name, or the prediction's path for two files; with the array and its index for files of arrays.
    pub name: String,
    /// PSNR, dB.
    pub psnr: Option<f64>,
    /// SSIM; none for images smaller than its window.
    pub ssim: Option<f64>,
    /// LPIPS-VGG; none without weights.
    pub lpips: Option<f64>,
    /// Relative depth error.
    pub absrel: Option<f64>,
    /// Depth RMSE, metres.
    pub rmse_m: Option<f64>,
    /// Share of pixels within a factor of 1.25, in 0..=1.
    pub delta1: Option<f64>,
    /// Reference depths in range.
    pub support_n: Option<u64>,
    /// What a person should know of the values.
    pub notes: Vec<String>,
}

/// Another image distance of two RGB images of one size, prediction and reference; none where it is not defined.
pub type Distance<'a> = &'a (dyn Fn(&RgbView<'_>, &RgbView<'_>) -> Option<f64> + Sync);

/// Scores one picture against its reference.
///
/// # Errors
/// When one holds colours and the other depth, the sizes differ, or the reference holds values that are not finite.
pub(super) fn score_pair(
    name: String,
    own: &Picture,
    other: &Picture,
    variant: SsimVariant,
    lpips: Option<Distance<'_>>,
) -> Result<PairScores, FolderError> {
    let mut scores = PairScores {
        name,
        ..PairScores::default()
    };
    let wrong = |source| FolderError::Pair {
        name: scores.name.clone(),
        source,
    };
    let unlike = |what: String| FolderError::Unlike {
        name: scores.name.clone(),
        what,
    };
    match (own.content.pixels(), other.content.pixels()) {
        (Some(own_pixels), Some(other_pixels)) => {
            let a = RgbView::new(own.height, own.width, own_pixels).map_err(wrong)?;
            let b = RgbView::new(other.height, other.width, other_pixels).map_err(wrong)?;
            let psnr = psnr(&a, &b).map_err(wrong)?;
            if let Some(count) = undefined(other) {
                return Err(unlike(format!("{count} values of the reference are not finite")));
            }
            let ssim = match ssim(&a, &b, variant) {
                Ok(value) => Some(value),
                Err(MetricError::TooSmall { .. }) => None,
                Err(error) => return Err(wrong(error)),
            };
            scores.lpips = lpips.and_then(|distance| distance(&a, &b));
            (scores.psnr, scores.ssim) = (Some(psnr), ssim);
        }
        (None, None) => {
            let (Content::Depth(predicted), Content::Depth(truth)) = (&own.content, &other.content) else {
                return Err(unlike("it holds neither colours nor depth".to_owned()));
            };
            if (own.height, own.width) != (other.height, other.width) {
                return Err(wrong(MetricError::SizeMismatch {
                    prediction: [own.height, own.width],
                    reference: [other.height, other.width],
                }));
            }
            let support = depth_support(truth, DEPTH_RANGE_M);
            let depth = depth_scores(predicted, truth, &support, 1.0);
            scores.support_n = Some(depth.map_or(0, |depth| depth.count));
            scores.absrel = depth.map(|depth| depth.absrel);
            scores.rmse_m = depth.map(|depth| depth.rmse_m);
            scores.delta1 = depth.map(|depth| depth.delta1);
            scores.notes.extend(match depth {
                Some(_) => other_unit(predicted, truth, &support),
                None => Some(nothing_in_range(truth)),
            });
        }
        (own, _) => {
            let kind = |colours: bool| if colours { "colours" } else { "depth" };
            let (own, other) = (kind(own.is_some()), kind(own.is_none()));
            return Err(unlike(format!("the prediction holds {own}, the reference {other}")));
        }
    }
    if let Some(count) = undefined(own) {
        let how = match own.content {
            Content::Depth(_) => "they count as 0",
            _ => "NaN counts as 0, infinite values are clipped",
        };
        scores
            .notes
            .push(format!("{count} values of the prediction are not finite: {how}"));
    }
    for (side, picture) in [("prediction", own), ("reference", other)] {
        scores.notes.extend(clipped(side, picture));
        scores.notes.extend(dark(side, picture));
        scores
            .notes
            .extend(picture.notes.iter().map(|note| format!("{side}: {note}")));
    }
    Ok(scores)
}

/// A note on a prediction whose depth is some usual factor off the reference's.
fn other_unit(predicted: &[f32], truth: &[f32], support: &[bool]) -> Option<String> {
    let ratio = 1.0 / median_scale(predicted, truth, support);
    let meaning = unit_factor(ratio)?.meaning;
    Some(format!(
        "the predicted depth is {ratio:.4} times that of the reference (median): {meaning}? `--prediction-unit-m` states \
         its unit"
    ))
}

/// A note on a reference without depth in range, with the unit that would bring it there.
fn nothing_in_range(truth: &[f32]) -> String {
    let [near, far] = DEPTH_RANGE_M;
    let mut known: Vec<f32> = (truth.iter().copied())
        .filter(|depth| depth.is_finite() && *depth > 0.0)
        .collect();
    let none = format!("no reference depth lies between {near} and {far} m: nothing is measured");
    if known.is_empty() {
        return format!("{none} (no value is above 0)");
    }
    let half = known.len() / 2;
    let (_, &mut median, _) = known.select_nth_unstable_by(half, f32::total_cmp);
    let meaning = match median / 1000.0 {
        metres if (near..far).contains(&metres) => "millimetres instead of metres",
        _ if median < near => "divided by 1000 once too often",
        _ => "is it in metres",
    };
    format!("{none} (their median is {median}: {meaning}? `--reference-unit-m` states their unit)")
}

/// A note on bytes that are probably colours in 0 to 1, cut to whole numbers.
fn dark(side: &str, picture: &Picture) -> Option<String> {
    let Content::Bytes(values) = &picture.content else {
        return None;
    };
    (values.iter().max() == Some(&1))
        .then(|| format!("the bytes of the {side} are 0 and 1 alone: were these colours in 0 to 1? bytes go to 255"))
}

/// How many values are not finite, if any.
fn undefined(picture: &Picture) -> Option<usize> {
    let (Content::Unit(values) | Content::Depth(values)) = &picture.content else {
        return None;
    };
    let count = values.iter().filter(|value| !value.is_finite()).count();
    (count > 0).then_some(count)
}

/// A note on colours outside of [0, 1].
fn clipped(side: &str, picture: &Picture) -> Option<String> {
    let Content::Unit(values) = &picture.content else {
        return None;
    };
    let outside = || {
        values
            .iter()
            .filter(|value| value.is_finite() && !(0.0..=1.0).contains(*value))
    };
    let count = outside().count();
    let widest = outside().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let hint = if widest > 2.0 {
        " (floats are colours in 0 to 1)"
    } else {
        ""
    };
    Some(format!(
        "{count} values of the {side} outside of 0 to 1, up to {widest}, are clipped{hint}"
    ))
}
