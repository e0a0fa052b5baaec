//! From score sheets to per-clip values and means (`docs/spec/scoring.md` section 8).

use std::collections::{BTreeMap, BTreeSet};

use rogs_schemas::records::scores::{ImageScore, ScoreSheet};

use crate::metrics::{Interval, bootstrap_interval, mean};

/// `configuration` of [`WeightsInfo`](rogs_schemas::records::field::WeightsInfo) in the sheets of outside methods.
pub const OUTSIDE: &str = "outside method";
/// The same where one factor per camera from recorded source depth brought the fields to metres.
pub const OUTSIDE_SCALED: &str = "outside method, one source-depth scale per camera";

/// A number of a clip, the same for every table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Metric {
    /// Image score over the source cameras.
    Source(ImageMetric),
    /// Image score over the held-out cameras.
    Novel(ImageMetric),
    /// Robot displacement error, millimetres.
    RobotEpe,
    /// Robot depth error, millimetres.
    RobotDepth,
    /// PSNR of the observations against the field of the other cameras, dB.
    CrossView,
    /// Share of the observations that the field of the other cameras shows, PER CENT.
    CrossViewShown,
}

/// A score of one image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ImageMetric {
    /// Peak signal-to-noise ratio, dB.
    Psnr,
    /// Structural similarity.
    Ssim,
    /// LPIPS-VGG.
    Lpips,
    /// Relative depth error.
    AbsRel,
    /// Depth RMSE, metres.
    Rmse,
    /// Share of pixels within a factor of 1.25, PER CENT.
    Delta1,
    /// Relative depth error after per-image median scaling.
    AbsRelScaled,
    /// Relative depth error between 1.5 and 5 m.
    FarAbsRel,
}

impl ImageMetric {
    fn of(self, image: &ImageScore) -> Option<f64> {
        match self {
            Self::Psnr => image.psnr,
            Self::Ssim => image.ssim,
            Self::Lpips => image.lpips,
            Self::AbsRel => image.absrel,
            Self::Rmse => image.rmse_m,
            Self::Delta1 => image.delta1.map(|fraction| 100.0 * fraction),
            Self::AbsRelScaled => image.absrel_scaled,
            Self::FarAbsRel => image.far_absrel,
        }
    }
}

/// The value of a metric on one clip; `None` where nothing could be measured.
///
/// Images: all valid images of the view group count equally. Robot metrics are pooled over cameras per time already and
/// averaged over the times that have any.
#[must_use]
pub fn clip_value(sheet: &ScoreSheet, metric: Metric) -> Option<f64> {
    let images = |metric: ImageMetric, source: bool| {
        let group = sheet.images.iter().filter(|image| image.source_view == source);
        mean(&group.filter_map(|image| metric.of(image)).collect::<Vec<_>>())
    };
    match metric {
        Metric::Source(metric) => images(metric, true),
        Metric::Novel(metric) => images(metric, false),
        Metric::RobotEpe => mean(&sheet.tracks.iter().filter_map(|track| track.epe_mm).collect::<Vec<_>>()),
        Metric::RobotDepth => mean(
            &sheet
                .robot_depth
                .iter()
                .filter_map(|depth| depth.robot_depth_mm)
                .collect::<Vec<_>>(),
        ),
        Metric::CrossView => mean(&sheet.cross_view.iter().filter_map(|own| own.psnr).collect::<Vec<_>>()),
        Metric::CrossViewShown => mean(&sheet.cross_view.iter().map(|own| 100.0 * own.shown).collect::<Vec<_>>()),
    }
}

/// A mean over clips with the number of clips that have a value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Mean; every clip has equal weight.
    pub mean: f64,
    /// Clips with a value.
    pub clips: usize,
}

/// Two sheets claim the same place.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there are two score sheets of method `{method}`, setting `{setting}`, clip `{clip}`")]
pub struct DuplicateSheet {
    /// Method label.
    pub method: String,
    /// Setting.
    pub setting: String,
    /// Clip.
    pub clip: String,
}

/// Score sheets by setting, method and clip.
#[derive(Debug, Clone, Default)]
pub struct SheetSet<'a> {
    by_method: BTreeMap<(&'a str, &'a str), BTreeMap<&'a str, &'a ScoreSheet>>,
}

impl<'a> SheetSet<'a> {
    /// Sorts the sheets.
    ///
    /// # Errors
    /// When two sheets have the same setting, method and clip.
    pub fn new(sheets: impl IntoIterator<Item = &'a ScoreSheet>) -> Result<Self, DuplicateSheet> {
        let mut set = Self::default();
        for sheet in sheets {
            let clips = set.by_method.entry((&sheet.setting, &sheet.method)).or_default();
            if clips.insert(&sheet.clip_id, sheet).is_some() {
                return Err(DuplicateSheet {
                    method: sheet.method.clone(),
                    setting: sheet.setting.clone(),
                    clip: sheet.clip_id.to_string(),
                });
            }
        }
        Ok(set)
    }

    /// Settings that have sheets, ascending.
    #[must_use]
    pub fn settings(&self) -> BTreeSet<&'a str> {
        self.by_method.keys().map(|(setting, _)| *setting).collect()
    }

    /// Methods that have sheets in a setting, ascending.
    #[must_use]
    pub fn methods(&self, setting: &str) -> Vec<&'a str> {
        self.by_method
            .keys()
            .filter(|(own, _)| *own == setting)
            .map(|(_, method)| *method)
            .collect()
    }

    /// The sheets of a method in a setting, clips ascending.
    pub fn sheets(&self, setting: &str, method: &str) -> impl Iterator<Item = &'a ScoreSheet> + use<'a> {
        self.by_method
            .get(&(setting, method))
            .cloned()
            .unwrap_or_default()
            .into_values()
    }

    /// The first `count` clip names of a setting, byte-wise ascending over all methods; all of them for `None`.
    #[must_use]
    pub fn clips(&self, setting: &str, count: Option<usize>) -> BTreeSet<&'a str> {
        let own = self.by_method.iter().filter(|((own, _), _)| *own == setting);
        let names: BTreeSet<&str> = own.flat_map(|(_, clips)| clips.keys().copied()).collect();
        names.into_iter().take(count.unwrap_or(usize::MAX)).collect()
    }

    /// Values of a metric by clip, for the clips of `among` that have one.
    #[must_use]
    pub fn values(
        &self,
        setting: &str,
        method: &str,
        metric: Metric,
        among: &BTreeSet<&str>,
    ) -> BTreeMap<&'a str, f64> {
        let sheets = self
            .sheets(setting, method)
            .filter(|sheet| among.contains(sheet.clip_id.as_str()));
        sheets
            .filter_map(|sheet| Some((sheet.clip_id.as_str(), clip_value(sheet, metric)?)))
            .collect()
    }
}

/// Mean of per-clip values.
#[must_use]
pub fn summarise(values: &[f64]) -> Option<Summary> {
    Some(Summary {
        mean: mean(values)?,
        clips: values.len(),
    })
}

/// Mean of per-clip values with its bootstrap interval.
#[must_use]
pub fn summarise_with_interval(values: &[f64]) -> Option<(Summary, Interval)> {
    Some((summarise(values)?, bootstrap_interval(values)?))
}
