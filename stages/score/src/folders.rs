//! Scores of images without any manifest: two files, or two folders whose files have the same names.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;

use crate::metrics::{MetricError, RgbView, SsimVariant, depth_scores, depth_support, mean, psnr, ssim};
use crate::pictures::{Content, EXTENSIONS, Picture, PictureError, extension, read_pictures};

/// Reference depths that count, metres, both ends excluded (`docs/spec/scoring.md` section 5).
pub const DEPTH_RANGE_M: [f32; 2] = [0.1, 5.0];

/// Scores of one pair of images or depth maps. What does not apply, or cannot be measured, is none.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
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

/// Scores of all pairs. A mean is over the pairs that have the value; their number stands beside it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FolderScores {
    /// SSIM variant name.
    pub ssim_variant: String,
    /// Why LPIPS is missing, if it is.
    pub lpips_note: Option<String>,
    /// Pairs by name.
    pub pairs: Vec<PairScores>,
    /// Mean PSNR, dB.
    pub psnr: Option<f64>,
    /// Mean SSIM.
    pub ssim: Option<f64>,
    /// Mean LPIPS.
    pub lpips: Option<f64>,
    /// Mean relative depth error.
    pub absrel: Option<f64>,
    /// Mean depth RMSE, metres.
    pub rmse_m: Option<f64>,
    /// Mean share of pixels within a factor of 1.25, in 0..=1.
    pub delta1: Option<f64>,
    /// Pairs behind each mean.
    pub n: Counts,
    /// Files (or arrays) of the prediction without a reference.
    pub only_in_prediction: Vec<String>,
    /// Files (or arrays) of the reference without a prediction.
    pub only_in_reference: Vec<String>,
}

/// How many pairs have a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Counts {
    /// Of PSNR.
    pub psnr: usize,
    /// Of SSIM.
    pub ssim: usize,
    /// Of LPIPS.
    pub lpips: usize,
    /// Of the three depth errors.
    pub depth: usize,
}

/// Why images cannot be scored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// A file cannot be read.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// A path that does not exist.
    #[error("there is no file or folder `{}`", path.display())]
    Nothing {
        /// The path.
        path: PathBuf,
    },
    /// A file against a folder.
    #[error("`{}` and `{}` must both be files or both be folders", prediction.display(), reference.display())]
    Mixed {
        /// Prediction.
        prediction: PathBuf,
        /// Reference.
        reference: PathBuf,
    },
    /// The folders, or files of arrays, have no name in common.
    #[error(
        "`{}` and `{}` have no image in common by name (files of {}); the first holds {}, the second {}",
        prediction.display(), reference.display(), EXTENSIONS.join(", "), some(own), some(other)
    )]
    NothingInCommon {
        /// Prediction.
        prediction: PathBuf,
        /// Reference.
        reference: PathBuf,
        /// What is there of the prediction.
        own: Vec<String>,
        /// What is there of the reference.
        other: Vec<String>,
    },
    /// Two images cannot be compared.
    #[error("`{name}` cannot be scored")]
    Pair {
        /// File name.
        name: String,
        /// Why.
        source: MetricError,
    },
    /// Two pictures cannot be compared.
    #[error("`{name}` cannot be scored: {what}")]
    Unlike {
        /// File name.
        name: String,
        /// Why.
        what: String,
    },
}

/// A few names of a list.
fn some(names: &[String]) -> String {
    match names {
        [] => "none".to_owned(),
        [first] => format!("`{first}`"),
        [first, .., last] => format!("{}, `{first}` to `{last}`", names.len()),
    }
}

/// Another image distance of two RGB images of one size, prediction and reference; none where it is not defined.
pub type Distance<'a> = &'a (dyn Fn(&RgbView<'_>, &RgbView<'_>) -> Option<f64> + Sync);

/// Scores a prediction against a reference: two files, or two folders of files matched by name (formats and contents as
/// in [`read_pictures`]). Colours are clipped to [0, 1], undefined predictions count as 0; depth counts where the reference
/// lies in [`DEPTH_RANGE_M`].
///
/// `lpips` computes that distance where weights are at hand.
///
/// # Errors
/// When something cannot be read or compared, or a reference image holds undefined values.
pub fn score_paths(
    prediction: &Path,
    reference: &Path,
    variant: SsimVariant,
    lpips: Option<Distance<'_>>,
) -> Result<FolderScores, FolderError> {
    let mut scores = FolderScores {
        ssim_variant: variant.name().to_owned(),
        lpips_note: lpips
            .is_none()
            .then(|| "no LPIPS weights were given (`--lpips FILE`)".to_owned()),
        pairs: Vec::new(),
        psnr: None,
        ssim: None,
        lpips: None,
        absrel: None,
        rmse_m: None,
        delta1: None,
        n: Counts::default(),
        only_in_prediction: Vec::new(),
        only_in_reference: Vec::new(),
    };
    let nothing_in_common = |own: Vec<String>, other: Vec<String>| FolderError::NothingInCommon {
        prediction: prediction.to_owned(),
        reference: reference.to_owned(),
        own,
        other,
    };
    for path in [prediction, reference] {
        if !path.exists() {
            let path = path.to_owned();
            return Err(FolderError::Nothing { path });
        }
    }
    let files: Vec<(String, PathBuf, PathBuf)> = match (prediction.is_dir(), reference.is_dir()) {
        (false, false) => vec![(
            prediction.display().to_string(),
            prediction.to_owned(),
            reference.to_owned(),
        )],
        (true, true) => {
            let (own, other) = (image_names(prediction)?, image_names(reference)?);
            scores.only_in_prediction = own.difference(&other).cloned().collect();
            scores.only_in_reference = other.difference(&own).cloned().collect();
            if own.is_disjoint(&other) {
                return Err(nothing_in_common(scores.only_in_prediction, scores.only_in_reference));
            }
            own.intersection(&other)
                .map(|name| (name.clone(), prediction.join(name), reference.join(name)))
                .collect()
        }
        _ => {
            return Err(FolderError::Mixed {
                prediction: prediction.to_owned(),
                reference: reference.to_owned(),
            });
        }
    };
    let one = |(name, own, other): &(String, PathBuf, PathBuf)| file(name, own, other, variant, lpips);
    let measured: Vec<Result<FileScores, FolderError>> = files.par_iter().map(one).collect();
    for measured in measured {
        let FileScores {
            pairs,
            only_in_prediction,
            only_in_reference,
        } = measured?;
        scores.pairs.extend(pairs);
        scores.only_in_prediction.extend(only_in_prediction);
        scores.only_in_reference.extend(only_in_reference);
    }
    if scores.pairs.is_empty() {
        return Err(nothing_in_common(scores.only_in_prediction, scores.only_in_reference));
    }
    if lpips.is_some()
        && scores
            .pairs
            .iter()
            .any(|pair| pair.psnr.is_some() && pair.lpips.is_none())
    {
        scores.lpips_note = Some("images smaller than 16x16 pixels have no LPIPS".to_owned());
    }
    let average = |value: fn(&PairScores) -> Option<f64>| {
        let values: Vec<f64> = scores.pairs.iter().filter_map(value).collect();
        (mean(&values), values.len())
    };
    let mut n = Counts::default();
    let (psnr, ssim, lpips);
    (psnr, n.psnr) = average(|pair| pair.psnr);
    (ssim, n.ssim) = average(|pair| pair.ssim);
    (lpips, n.lpips) = average(|pair| pair.lpips);
    let (absrel, rmse_m, delta1);
    (absrel, n.depth) = average(|pair| pair.absrel);
    (rmse_m, _) = average(|pair| pair.rmse_m);
    (delta1, _) = average(|pair| pair.delta1);
    Ok(FolderScores {
        psnr,
        ssim,
        lpips,
        absrel,
        rmse_m,
        delta1,
        n,
        ..scores
    })
}

/// The pairs of two files.
struct FileScores {
    pairs: Vec<PairScores>,
    only_in_prediction: Vec<String>,
    only_in_reference: Vec<String>,
}

fn file(
    name: &str,
    prediction: &Path,
    reference: &Path,
    variant: SsimVariant,
    lpips: Option<Distance<'_>>,
) -> Result<FileScores, FolderError> {
    let (own, other) = (read_pictures(prediction)?, read_pictures(reference)?);
    let whole = |part: &str| {
        if part.is_empty() {
            name.to_owned()
        } else {
            format!("{name}:{part}")
        }
    };
    // An image is compared with an image whatever they are called; arrays by their names.
    if let ([own], [other]) = (own.as_slice(), other.as_slice()) {
        let part = if own.name == other.name { own.name.as_str() } else { "" };
        return Ok(FileScores {
            pairs: vec![pair(whole(part), own, other, variant, lpips)?],
            only_in_prediction: Vec::new(),
            only_in_reference: Vec::new(),
        });
    }
    let names = |pictures: &[Picture]| pictures.iter().map(|own| own.name.clone()).collect::<BTreeSet<_>>();
    let (own_names, other_names) = (names(&own), names(&other));
    let mut pairs = Vec::new();
    for own in &own {
        if let Some(other) = other.iter().find(|other| other.name == own.name) {
            pairs.push(pair(whole(&own.name), own, other, variant, lpips)?);
        }
    }
    Ok(FileScores {
        pairs,
        only_in_prediction: own_names.difference(&other_names).map(|part| whole(part)).collect(),
        only_in_reference: other_names.difference(&own_names).map(|part| whole(part)).collect(),
    })
}

fn pair(
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
                return Err(unlike(format!("{count} values of the reference are no finite numbers")));
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
            if depth.is_none() {
                let [near, far] = DEPTH_RANGE_M;
                scores.notes.push(format!(
                    "no reference depth lies between {near} and {far} m: nothing is measured (is it in metres?)"
                ));
            }
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
            .push(format!("{count} values of the prediction are no finite numbers: {how}"));
    }
    for (side, picture) in [("prediction", own), ("reference", other)] {
        scores.notes.extend(clipped(side, picture));
    }
    Ok(scores)
}

/// How many values are no finite numbers, if any.
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

/// Names of the files of a folder that are read.
fn image_names(folder: &Path) -> Result<BTreeSet<String>, FolderError> {
    let read = |source| PictureError::Read {
        path: folder.to_owned(),
        source,
    };
    let mut names = BTreeSet::new();
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        let known = EXTENSIONS.contains(&extension(&path).as_str()) && path.is_file();
        if let Some(name) = path.file_name().filter(|_| known) {
            names.insert(name.to_string_lossy().into_owned());
        }
    }
    Ok(names)
}
