//! Intrinsics of a camera by what is there, each with its origin, and the distance of its eyes.

use std::path::Path;

use rogs_schemas::Intrinsics;
use rogs_worker::StageResult;

use super::published::{Lens, Published};
use super::trajectory::CameraLog;
use super::zed;
use crate::checks;

/// Intrinsics for the images of a video, pixel centres at + 0.5.
#[derive(Debug)]
pub(super) struct Lensed {
    pub(super) intrinsics: Intrinsics,
    /// For the report: `HDF5`, a file's name, `usual values of a ZED 2`.
    pub(super) origin: String,
    pub(super) warnings: Vec<String>,
}

/// A camera whose intrinsics are asked for.
pub(super) struct Asked<'a> {
    pub(super) id: &'a str,
    pub(super) serial: &'a str,
    pub(super) uuid: &'a str,
    pub(super) wrist: bool,
    /// Size of its images, one eye.
    pub(super) size: (u32, u32),
    /// The trajectory, for messages.
    pub(super) path: &'a Path,
}

/// The first that there is of: the HDF5, the published intrinsics, the factory calibration, usual values of the model.
pub(super) fn intrinsics(asked: &Asked<'_>, log: &CameraLog, published: Option<&Published>) -> StageResult<Lensed> {
    let Asked { id, serial, uuid, .. } = *asked;
    let mut warnings = Vec::new();
    if log.zero_lens {
        warnings.push(format!(
            "the HDF5 has zeros as intrinsics of camera `{id}` ({serial}): not used"
        ));
    }
    let later = match published {
        None => None,
        Some(published) => match published.intrinsics(uuid, serial)? {
            Some(Ok(lens)) => Some(lens),
            Some(Err(why)) => {
                warnings.push(format!("{why} (`{id}`): not used"));
                None
            }
            None => None,
        },
    };
    let own = log.left_lens.map(|[fx, fy, cx, cy]| Lens {
        intrinsics: Intrinsics { fx, fy, cx, cy },
        size: zed::SIZE,
    });
    if let (Some(own), Some(later)) = (&own, &later) {
        let scale = f64::from(own.size.0) / f64::from(later.size.0);
        let off = later.intrinsics.fx * scale / own.intrinsics.fx - 1.0;
        if off.abs() > 0.01 {
            warnings.push(format!(
                "the published focal length of camera `{id}` ({serial}) differs from the HDF5's by {:.1} %: the HDF5's \
                 is taken",
                100.0 * off
            ));
        }
    }
    let factory = match published {
        Some(published) if own.is_none() && later.is_none() => published.factory(serial)?,
        _ => None,
    };
    let (lens, origin) = match (own, later, factory) {
        (Some(own), _, _) => (own, "HDF5".to_owned()),
        (None, Some(later), _) => (later, "published (intrinsics.json)".to_owned()),
        (None, None, Some(factory)) => {
            warnings.push(format!(
                "intrinsics of camera `{id}` ({serial}) are those of the factory, before rectification: off by up to \
                 1.5 %; the SVO file or the published `intrinsics.json` has the right ones"
            ));
            (prior(factory), format!("factory (SN{serial}.conf)"))
        }
        (None, None, None) => {
            let model = if asked.wrist { "ZED Mini" } else { "ZED 2" };
            warnings.push(format!(
                "camera `{id}` ({serial}) has no intrinsics: usual values of a {model} are taken, off by some percent \
                 (one ZED Mini of 15 by 10 %); give the published `intrinsics.json` or `SN{serial}.conf` as calibration \
                 folder (docs/droid.md)"
            ));
            (prior(zed::usual(asked.wrist)), format!("usual values of a {model}"))
        }
    };
    let (sx, sy) = (
        f64::from(asked.size.0) / f64::from(lens.size.0),
        f64::from(asked.size.1) / f64::from(lens.size.1),
    );
    if (sx / sy - 1.0).abs() > 0.01 {
        warnings.push(format!(
            "images of camera `{id}` are {}x{}, its intrinsics belong to {}x{}: taken as stretched",
            asked.size.0, asked.size.1, lens.size.0, lens.size.1
        ));
    }
    let Intrinsics { fx, fy, cx, cy } = lens.intrinsics;
    let scaled = Intrinsics {
        fx: fx * sx,
        fy: fy * sy,
        cx: (cx + 0.5) * sx,
        cy: (cy + 0.5) * sy,
    };
    let what = format!("camera `{id}` ({serial}; {origin})");
    Ok(Lensed {
        intrinsics: checks::intrinsics(scaled, asked.size, &what, asked.path)?,
        origin,
        warnings,
    })
}

fn prior(factory: zed::Factory) -> Lens {
    Lens {
        intrinsics: factory.intrinsics,
        size: zed::SIZE,
    }
}

/// Distance of the eyes in metres, its origin, and a warning where it is a guess.
pub(super) fn baseline(
    asked: &Asked<'_>,
    measured: Option<f64>,
    published: Option<&Published>,
) -> StageResult<(f64, Option<String>)> {
    if let Some(metres) = measured {
        return Ok((metres, None));
    }
    let factory = match published {
        Some(published) => published.factory(asked.serial)?,
        None => None,
    };
    Ok(match factory {
        Some(factory) => (factory.baseline_m, None),
        None => {
            let metres = zed::usual(asked.wrist).baseline_m;
            let text = format!(
                "the eyes of camera `{}` ({}) are taken as {:.2} mm apart, as usual: the HDF5 has no pose of the right one",
                asked.id,
                asked.serial,
                1000.0 * metres
            );
            (metres, Some(text))
        }
    })
}
