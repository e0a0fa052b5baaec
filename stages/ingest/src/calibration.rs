//! Calibration files: intrinsics and poses for layouts that have none (`docs/calibration-format.md`).

use std::collections::BTreeMap;
use std::path::Path;

use rogs_schemas::Intrinsics;
use rogs_schemas::episode::PixelCentres;
use rogs_worker::StageResult;
use serde::Deserialize;

use crate::checks;
use crate::fault::{read_text, wrong};
use crate::source::SourceMount;

/// Longest calibration file, bytes.
const MAX_FILE: u64 = 1 << 20;

/// A calibration file.
#[derive(Debug, Clone, Deserialize)]
struct File {
    image_size: [u32; 2],
    #[serde(default)]
    pixel_centres: PixelCentres,
    cameras: BTreeMap<String, Entry>,
    #[serde(default)]
    status: String,
}

#[derive(Debug, Clone, Deserialize)]
struct Entry {
    intrinsic: [[f64; 3]; 3],
    #[serde(default)]
    camera_to_base: Option<[[f64; 4]; 4]>,
    /// Link of a hand-eye camera; `mount` is the older name, where `fixed` means none.
    #[serde(default)]
    link: Option<String>,
    #[serde(default)]
    mount: Option<String>,
    #[serde(default, alias = "camera_to_link8")]
    camera_to_link: Option<[[f64; 4]; 4]>,
}

/// The calibration of some cameras.
#[derive(Debug, Clone)]
pub(crate) struct Calibration {
    path: std::path::PathBuf,
    file: File,
}

/// One camera's calibration for images of a given size, pixel centres at + 0.5.
pub(crate) struct Calibrated {
    pub(crate) intrinsics: Intrinsics,
    pub(crate) mount: Option<SourceMount>,
}

impl Calibration {
    /// Reads a file.
    pub(crate) fn read(path: &Path) -> StageResult<Self> {
        let text = read_text(path, MAX_FILE)?;
        let file = serde_json::from_str(&text).map_err(|error| {
            wrong(path, format!("not a calibration file: {error}")).with_hint("docs/calibration-format.md shows one")
        })?;
        Ok(Self {
            path: path.to_owned(),
            file,
        })
    }

    /// Names of the cameras in it.
    pub(crate) fn cameras(&self) -> Vec<&str> {
        self.file.cameras.keys().map(String::as_str).collect()
    }

    /// What the report says about it.
    pub(crate) fn note(&self) -> String {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        let status = &self.file.status;
        if status.is_empty() {
            name.into_owned()
        } else {
            format!("{name}: {status}")
        }
    }

    /// The calibration of a camera known under any of these names, for images of this size.
    pub(crate) fn camera(&self, names: &[&str], size: (u32, u32)) -> StageResult<Option<Calibrated>> {
        let Some((name, entry)) = names.iter().find_map(|name| self.file.cameras.get_key_value(*name)) else {
            return Ok(None);
        };
        let path = &self.path;
        let [[fx, skew, cx], [below, fy, cy], last] = entry.intrinsic;
        if skew != 0.0 || below != 0.0 || last != [0.0, 0.0, 1.0] {
            return Err(wrong(
                path,
                format!("the intrinsic matrix of `{name}` has more than fx, fy, cx, cy"),
            ));
        }
        let [width, height] = self.file.image_size;
        let what = format!("camera `{name}`");
        let shift = match self.file.pixel_centres {
            PixelCentres::Half => 0.0,
            PixelCentres::Integer => 0.5,
        };
        let recorded = Intrinsics {
            fx,
            fy,
            cx: cx + shift,
            cy: cy + shift,
        };
        let recorded = checks::intrinsics(recorded, (width, height), &what, path)?;
        let (sx, sy) = (
            f64::from(size.0) / f64::from(width),
            f64::from(size.1) / f64::from(height),
        );
        let intrinsics = Intrinsics {
            fx: recorded.fx * sx,
            fy: recorded.fy * sy,
            cx: recorded.cx * sx,
            cy: recorded.cy * sy,
        };
        Ok(Some(Calibrated {
            intrinsics,
            mount: self.mount(name, entry)?,
        }))
    }

    fn mount(&self, name: &str, entry: &Entry) -> StageResult<Option<SourceMount>> {
        let path = &self.path;
        let link = entry
            .link
            .as_ref()
            .or(entry.mount.as_ref().filter(|mount| *mount != "fixed"));
        Ok(match (&entry.camera_to_base, &entry.camera_to_link, link) {
            (Some(_), Some(_), _) => {
                return Err(wrong(
                    path,
                    format!("camera `{name}` has both `camera_to_base` and `camera_to_link`"),
                ));
            }
            (Some(matrix), None, _) => Some(SourceMount::Fixed(checks::rigid_pose(
                matrix,
                &format!("`camera_to_base` of `{name}`"),
                path,
            )?)),
            (None, Some(matrix), Some(link)) => {
                let what = format!("`camera_to_link` of `{name}`");
                Some(SourceMount::HandEye {
                    link: link.clone(),
                    link_from_camera: checks::rigid_pose(matrix, &what, path)?,
                })
            }
            (None, Some(_), None) => {
                return Err(wrong(
                    path,
                    format!("camera `{name}` has `camera_to_link` but no `link`"),
                ));
            }
            (None, None, _) => None,
        })
    }
}
