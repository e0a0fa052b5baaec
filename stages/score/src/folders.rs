//! Scores of images without any manifest: two files, or two folders whose files have the same names.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;

use crate::metrics::{MetricError, Pixels, RgbView, SsimVariant, mean, psnr, ssim};

/// Largest image side that is read, pixels.
const MAX_SIDE: u32 = 1 << 15;
/// Most memory one decoded image may take, bytes.
const MAX_IMAGE_BYTES: u64 = 1 << 30;

/// Scores of one pair of images.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairScores {
    /// File name, or the prediction's path for two files.
    pub name: String,
    /// PSNR, dB.
    pub psnr: f64,
    /// SSIM; none for images smaller than its window.
    pub ssim: Option<f64>,
    /// LPIPS-VGG; none without weights.
    pub lpips: Option<f64>,
}

/// Scores of all pairs.
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
    /// Mean SSIM over the pairs that have one.
    pub ssim: Option<f64>,
    /// Mean LPIPS over the pairs that have one.
    pub lpips: Option<f64>,
    /// Files of the prediction without a reference.
    pub only_in_prediction: Vec<String>,
    /// Files of the reference without a prediction.
    pub only_in_reference: Vec<String>,
}

/// Why images cannot be scored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// A file or folder cannot be read.
    #[error("reading `{}`", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file is no image that can be read.
    #[error("`{}` is no readable image", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// Why.
        source: image::ImageError,
    },
    /// A file against a folder.
    #[error("`{}` and `{}` must both be files or both be folders", prediction.display(), reference.display())]
    Mixed {
        /// Prediction.
        prediction: PathBuf,
        /// Reference.
        reference: PathBuf,
    },
    /// The folders have no image name in common.
    #[error("`{}` and `{}` have no image file name in common", prediction.display(), reference.display())]
    NothingInCommon {
        /// Prediction.
        prediction: PathBuf,
        /// Reference.
        reference: PathBuf,
    },
    /// Two images cannot be compared.
    #[error("`{name}`")]
    Pair {
        /// File name.
        name: String,
        /// Why.
        source: MetricError,
    },
}

/// Another image distance that is given two 8-bit RGB images of one size: prediction, reference, height, width.
pub type Distance<'a> = &'a (dyn Fn(&[u8], &[u8], usize, usize) -> Option<f64> + Sync);

/// Scores a prediction against a reference: two PNG or JPEG files, or two folders of such files matched by name.
///
/// `lpips` computes that distance where weights are at hand.
///
/// # Errors
/// When something cannot be read or compared.
pub fn score_paths(
    prediction: &Path,
    reference: &Path,
    variant: SsimVariant,
    lpips: Option<Distance<'_>>,
) -> Result<FolderScores, FolderError> {
    let mixed = || FolderError::Mixed {
        prediction: prediction.to_owned(),
        reference: reference.to_owned(),
    };
    let mut scores = FolderScores {
        ssim_variant: variant.name().to_owned(),
        lpips_note: lpips
            .is_none()
            .then(|| "no LPIPS weights were given (`--lpips FILE`)".to_owned()),
        pairs: Vec::new(),
        psnr: None,
        ssim: None,
        lpips: None,
        only_in_prediction: Vec::new(),
        only_in_reference: Vec::new(),
    };
    let pairs: Vec<(String, PathBuf, PathBuf)> = match (prediction.is_dir(), reference.is_dir()) {
        (false, false) => vec![(
            prediction.display().to_string(),
            prediction.to_owned(),
            reference.to_owned(),
        )],
        (true, true) => {
            let (own, other) = (image_names(prediction)?, image_names(reference)?);
            scores.only_in_prediction = own.difference(&other).cloned().collect();
            scores.only_in_reference = other.difference(&own).cloned().collect();
            own.intersection(&other)
                .map(|name| (name.clone(), prediction.join(name), reference.join(name)))
                .collect()
        }
        _ => return Err(mixed()),
    };
    if pairs.is_empty() {
        let (prediction, reference) = (prediction.to_owned(), reference.to_owned());
        return Err(FolderError::NothingInCommon { prediction, reference });
    }
    let one =
        |(name, prediction, reference): &(String, PathBuf, PathBuf)| pair(name, prediction, reference, variant, lpips);
    let measured: Vec<Result<PairScores, FolderError>> = pairs.par_iter().map(one).collect();
    scores.pairs = measured.into_iter().collect::<Result<_, _>>()?;
    if lpips.is_some() && scores.pairs.iter().any(|pair| pair.lpips.is_none()) {
        scores.lpips_note = Some("images smaller than 16x16 pixels have no LPIPS".to_owned());
    }
    let average =
        |value: fn(&PairScores) -> Option<f64>| mean(&scores.pairs.iter().filter_map(value).collect::<Vec<_>>());
    (scores.psnr, scores.ssim, scores.lpips) = (average(|p| Some(p.psnr)), average(|p| p.ssim), average(|p| p.lpips));
    Ok(scores)
}

fn pair(
    name: &str,
    prediction: &Path,
    reference: &Path,
    variant: SsimVariant,
    lpips: Option<Distance<'_>>,
) -> Result<PairScores, FolderError> {
    let (own, other) = (read_rgb(prediction)?, read_rgb(reference)?);
    let wrong = |source| FolderError::Pair {
        name: name.to_owned(),
        source,
    };
    let view = |image: &image::RgbImage| (image.height() as usize, image.width() as usize);
    let ((height, width), (other_height, other_width)) = (view(&own), view(&other));
    let a = RgbView::new(height, width, Pixels::Bytes(own.as_raw())).map_err(wrong)?;
    let b = RgbView::new(other_height, other_width, Pixels::Bytes(other.as_raw())).map_err(wrong)?;
    let psnr = psnr(&a, &b).map_err(wrong)?;
    let ssim = match ssim(&a, &b, variant) {
        Ok(value) => Some(value),
        Err(MetricError::TooSmall { .. }) => None,
        Err(error) => return Err(wrong(error)),
    };
    let lpips = lpips.and_then(|distance| distance(own.as_raw(), other.as_raw(), height, width));
    Ok(PairScores {
        name: name.to_owned(),
        psnr,
        ssim,
        lpips,
    })
}

/// Names of the PNG and JPEG files of a folder.
fn image_names(folder: &Path) -> Result<BTreeSet<String>, FolderError> {
    let read = |source| FolderError::Read {
        path: folder.to_owned(),
        source,
    };
    let mut names = BTreeSet::new();
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        let extension = path
            .extension()
            .and_then(|own| own.to_str())
            .unwrap_or_default()
            .to_ascii_lowercase();
        if let Some(name) = path
            .file_name()
            .filter(|_| matches!(extension.as_str(), "png" | "jpg" | "jpeg"))
        {
            names.insert(name.to_string_lossy().into_owned());
        }
    }
    Ok(names)
}

fn read_rgb(path: &Path) -> Result<image::RgbImage, FolderError> {
    let read = |source| FolderError::Read {
        path: path.to_owned(),
        source,
    };
    let mut reader = image::ImageReader::open(path)
        .map_err(read)?
        .with_guessed_format()
        .map_err(read)?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_IMAGE_BYTES);
    reader.limits(limits);
    let image = reader.decode().map_err(|source| FolderError::Image {
        path: path.to_owned(),
        source,
    })?;
    Ok(image.into_rgb8())
}
