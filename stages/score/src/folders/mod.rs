//! Scores of images without any manifest: two files, or two folders whose files have the same names.

mod error;
mod pair;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;

use crate::metrics::{SsimVariant, mean};
use crate::pictures::{EXTENSIONS, Picture, PictureError, extension, read_pictures};

pub use error::FolderError;
pub use pair::{DEPTH_RANGE_M, Distance, PairScores};

use pair::score_pair;

/// Scores of all pairs. A mean is over the pairs that have the value; their number stands beside it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, JsonSchema)]
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

/// Scores a prediction against a reference: two files, or two folders of files matched by name (formats and contents as
/// in [`read_pictures`]). Colours are clipped to [0, 1], undefined predictions count as 0; depth counts where the reference
/// lies in [`DEPTH_RANGE_M`].
///
/// `lpips` computes that distance where weights are at hand; `units_m` are the metres of one step of depth in the prediction
/// and in the reference, where they are not what [`read_pictures`] takes.
///
/// # Errors
/// When something cannot be read or compared, or a reference image holds undefined values.
pub fn score_paths(
    prediction: &Path,
    reference: &Path,
    variant: SsimVariant,
    lpips: Option<Distance<'_>>,
    units_m: [Option<f64>; 2],
) -> Result<FolderScores, FolderError> {
    let Files {
        matched,
        mut only_in_prediction,
        mut only_in_reference,
    } = match_files(prediction, reference)?;
    let one =
        |(name, own, other): &(String, PathBuf, PathBuf)| score_files(name, [own, other], variant, lpips, units_m);
    let measured: Vec<Result<FileScores, FolderError>> = matched.par_iter().map(one).collect();
    let mut pairs = Vec::new();
    for measured in measured {
        let measured = measured?;
        pairs.extend(measured.pairs);
        only_in_prediction.extend(measured.only_in_prediction);
        only_in_reference.extend(measured.only_in_reference);
    }
    if pairs.is_empty() {
        return Err(FolderError::NothingInCommon {
            prediction: prediction.to_owned(),
            reference: reference.to_owned(),
            own: only_in_prediction,
            other: only_in_reference,
        });
    }
    let without_lpips = |pair: &PairScores| pair.psnr.is_some() && pair.lpips.is_none();
    let lpips_note = if lpips.is_none() {
        Some("no LPIPS weights were given (`--lpips FILE`)")
    } else if pairs.iter().any(without_lpips) {
        Some("images smaller than 16x16 pixels have no LPIPS")
    } else {
        None
    };
    let average = |value: fn(&PairScores) -> Option<f64>| {
        let values: Vec<f64> = pairs.iter().filter_map(value).collect();
        (mean(&values), values.len())
    };
    let (psnr, psnr_pairs) = average(|pair| pair.psnr);
    let (ssim, ssim_pairs) = average(|pair| pair.ssim);
    let (lpips, lpips_pairs) = average(|pair| pair.lpips);
    let (absrel, depth_pairs) = average(|pair| pair.absrel);
    Ok(FolderScores {
        ssim_variant: variant.name().to_owned(),
        lpips_note: lpips_note.map(str::to_owned),
        psnr,
        ssim,
        lpips,
        absrel,
        rmse_m: average(|pair| pair.rmse_m).0,
        delta1: average(|pair| pair.delta1).0,
        n: Counts {
            psnr: psnr_pairs,
            ssim: ssim_pairs,
            lpips: lpips_pairs,
            depth: depth_pairs,
        },
        pairs,
        only_in_prediction,
        only_in_reference,
    })
}

/// Files to compare.
struct Files {
    /// Name, prediction, reference.
    matched: Vec<(String, PathBuf, PathBuf)>,
    only_in_prediction: Vec<String>,
    only_in_reference: Vec<String>,
}

/// Two files, or the files of two folders by name.
fn match_files(prediction: &Path, reference: &Path) -> Result<Files, FolderError> {
    if let Some(path) = [prediction, reference].into_iter().find(|path| !path.exists()) {
        return Err(FolderError::Nothing { path: path.to_owned() });
    }
    match (prediction.is_dir(), reference.is_dir()) {
        (false, false) => Ok(Files {
            matched: vec![(
                prediction.display().to_string(),
                prediction.to_owned(),
                reference.to_owned(),
            )],
            only_in_prediction: Vec::new(),
            only_in_reference: Vec::new(),
        }),
        (true, true) => {
            let (own, other) = (image_names(prediction)?, image_names(reference)?);
            let both = own.intersection(&other);
            Ok(Files {
                matched: both
                    .map(|name| (name.clone(), prediction.join(name), reference.join(name)))
                    .collect(),
                only_in_prediction: own.difference(&other).cloned().collect(),
                only_in_reference: other.difference(&own).cloned().collect(),
            })
        }
        _ => Err(FolderError::Mixed {
            prediction: prediction.to_owned(),
            reference: reference.to_owned(),
        }),
    }
}

/// The pairs of two files.
struct FileScores {
    pairs: Vec<PairScores>,
    only_in_prediction: Vec<String>,
    only_in_reference: Vec<String>,
}

fn score_files(
    name: &str,
    [prediction, reference]: [&Path; 2],
    variant: SsimVariant,
    lpips: Option<Distance<'_>>,
    [own_unit_m, other_unit_m]: [Option<f64>; 2],
) -> Result<FileScores, FolderError> {
    let own = read_pictures(prediction, own_unit_m)?;
    let other = read_pictures(reference, other_unit_m)?;
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
            pairs: vec![score_pair(whole(part), own, other, variant, lpips)?],
            only_in_prediction: Vec::new(),
            only_in_reference: Vec::new(),
        });
    }
    let names = |pictures: &[Picture]| pictures.iter().map(|own| own.name.clone()).collect::<BTreeSet<_>>();
    let (own_names, other_names) = (names(&own), names(&other));
    let mut pairs = Vec::new();
    for own in &own {
        if let Some(other) = other.iter().find(|other| other.name == own.name) {
            pairs.push(score_pair(whole(&own.name), own, other, variant, lpips)?);
        }
    }
    Ok(FileScores {
        pairs,
        only_in_prediction: own_names.difference(&other_names).map(|part| whole(part)).collect(),
        only_in_reference: other_names.difference(&own_names).map(|part| whole(part)).collect(),
    })
}

/// Names of the files of a folder that are read.
fn image_names(folder: &Path) -> Result<BTreeSet<String>, FolderError> {
    let read = |source| PictureError::Read {
        path: folder.to_owned(),
        source,
    };
    let mut names = BTreeSet::new();
    for entry in rogs_files::entries(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        let known = EXTENSIONS.contains(&extension(&path).as_str()) && path.is_file();
        if let Some(name) = path.file_name().filter(|_| known) {
            names.insert(name.to_string_lossy().into_owned());
        }
    }
    Ok(names)
}
