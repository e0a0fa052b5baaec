//! Calibration files: intrinsics and poses for layouts that have none (`docs/calibration-format.md`).

use std::collections::BTreeMap;
use std::path::Path;

use rogs_schemas::episode::PixelCentres;
use rogs_schemas::{Intrinsics, RigidPose, WrittenPose};
use rogs_worker::StageResult;
use serde::Deserialize;
use serde_json::{Map, Value};

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
    #[serde(flatten)]
    rest: Map<String, Value>,
}

#[derive(Debug, Clone, Deserialize)]
struct Entry {
    intrinsic: [[f64; 3]; 3],
    #[serde(default)]
    camera_to_base: Option<Value>,
    /// Link of a hand-eye camera; `mount` is the older name, where `fixed` means none.
    #[serde(default)]
    link: Option<String>,
    #[serde(default)]
    mount: Option<String>,
    #[serde(default, alias = "camera_to_link8")]
    camera_to_link: Option<Value>,
    #[serde(flatten)]
    rest: Map<String, Value>,
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
        let file: File = rogs_schemas::json::read(&text).map_err(|error| {
            wrong(path, format!("not a calibration file: {error}")).with_hint("docs/calibration-format.md shows one")
        })?;
        let of_entries = file
            .cameras
            .iter()
            .map(|(name, entry)| (format!("camera `{name}`"), &entry.rest));
        for (place, rest) in of_entries.chain([("the file".to_owned(), &file.rest)]) {
            if let Some(key) = distortion(rest) {
                let what =
                    format!("{place} has lens distortion in `{key}` that is not 0, and images are taken as free of it");
                return Err(wrong(path, what).with_hint(
                    "rectify images and intrinsics first (e.g. `cv2.undistort`); remove the entry where they are rectified",
                ));
            }
            if let Some((key, what, hint)) = rest.iter().find_map(|(key, value)| contradicts(key, value)) {
                return Err(wrong(path, format!("{place} says by `{key}` that {what}")).with_hint(hint));
            }
        }
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
            (Some(pose), None, _) => {
                let what = format!("`camera_to_base` of `{name}`");
                Some(SourceMount::Fixed(pose_of(pose, &what, path)?))
            }
            (None, Some(pose), Some(link)) => {
                let what = format!("`camera_to_link` of `{name}`");
                Some(SourceMount::HandEye {
                    link: link.clone(),
                    link_from_camera: pose_of(pose, &what, path)?,
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

/// Names under which calibration tools write lens distortion, beside those that begin with `dist` or contain `distortion`.
const COEFFICIENTS: [&str; 13] = [
    "d",
    "k1",
    "k2",
    "k3",
    "k4",
    "k5",
    "k6",
    "p1",
    "p2",
    "xi",
    "radial",
    "tangential",
    "coeffs",
];

/// The key of lens distortion that is not 0, if there is one.
fn distortion(rest: &Map<String, Value>) -> Option<&str> {
    fn is_zero(value: &Value) -> bool {
        match value {
            Value::Number(number) => number.as_f64() == Some(0.0),
            Value::Array(values) => values.iter().all(is_zero),
            Value::Object(values) => values.values().all(is_zero),
            // The name of a model says nothing without its coefficients.
            Value::Null | Value::Bool(_) | Value::String(_) => true,
        }
    }
    let is_distortion = |name: &str| {
        let name = name.to_lowercase();
        name.starts_with("dist") || name.contains("distortion") || COEFFICIENTS.contains(&name.as_str())
    };
    let found = |(name, value): &(&String, &Value)| is_distortion(name) && !is_zero(value);
    rest.iter().find(found).map(|(name, _)| name.as_str())
}

/// What an entry says against how the file is read: the entry, that, and what to do. Other entries that are not read (names
/// of models, dates, errors, serials) say nothing about what the numbers mean.
fn contradicts<'a>(key: &'a str, value: &Value) -> Option<(&'a str, String, &'static str)> {
    /// How words begin that name lenses which are no pinholes.
    const LENSES: [&str; 9] = [
        "fisheye",
        "equidistant",
        "kannala",
        "omnidir",
        "mei",
        "sphere",
        "spherical",
        "eucm",
        "equirect",
    ];
    const AXES: [&str; 5] = ["opengl", "blender", "nerf", "unity", "unreal"];
    const METRES: [&str; 5] = ["m", "meter", "meters", "metre", "metres"];
    let name = key.to_lowercase();
    let word = value.as_str().map(|word| word.trim().to_lowercase());
    let says = |words: &[&str]| {
        word.as_ref()
            .is_some_and(|word| words.iter().any(|part| word.contains(part)))
    };
    let shown = || word.as_deref().unwrap_or_default().to_owned();
    let is = |names: &[&str]| names.contains(&name.as_str());
    if (name.contains("model") || is(&["lens", "projection", "camera_type"])) && says(&LENSES) {
        let what = format!("its lens is `{}`, and images are taken as those of a pinhole", shown());
        return Some((key, what, "undistort images and intrinsics to a pinhole first"));
    }
    if is(&["rectified", "is_rectified", "undistorted"]) && value.as_bool() == Some(false) {
        return Some((
            key,
            "its images are not rectified".to_owned(),
            "rectify images and intrinsics first",
        ));
    }
    if is(&["unit", "units", "length_unit", "translation_unit", "translation_units"])
        && word.as_ref().is_some_and(|word| !METRES.contains(&word.as_str()))
    {
        let what = format!("its lengths are in `{}`, and poses are read in metres", shown());
        return Some((key, what, "write translations in metres"));
    }
    if (name.contains("convention") || is(&["coordinate_system", "axes", "camera_axes"])) && says(&AXES) {
        let what = format!("its axes are those of `{}`", shown());
        let hint =
            "cameras look along +z, with x to the right and y down: turn poses by diag(1, -1, -1) from the right";
        return Some((key, what, hint));
    }
    if name == "skew" && value.as_f64().is_some_and(|skew| skew != 0.0) {
        return Some((
            key,
            "its pixels are skewed".to_owned(),
            "rectify images and intrinsics first",
        ));
    }
    None
}

/// A pose in any form.
fn pose_of(value: &Value, what: &str, path: &Path) -> StageResult<RigidPose> {
    let written = WrittenPose::from_json(value)
        .map_err(|expected| wrong(path, format!("{what}: not a pose")).with_hint(expected))?;
    checks::rigid_pose(&written, what, path)
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;

    fn read(camera: &str, head: &str) -> Result<Calibration, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("calibration.json");
        let text = format!(
            r#"{{"image_size": [4, 4], {head} "cameras": {{"a": {{"intrinsic": [[1, 0, 2], [0, 1, 2], [0, 0, 1]], {camera}}}}}}}"#
        );
        std::fs::write(&path, text).unwrap();
        Calibration::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn distortion_under_any_usual_name_is_refused_unless_it_is_zero() {
        for name in [
            "distortion",
            "dist_coeffs",
            "distCoeffs",
            "distortion_coefficients",
            "distortion_coeffs",
            "D",
            "k1",
            "p2",
            "xi",
            "radial_distortion",
            "dist",
        ] {
            for (value, refused) in [
                ("[-0.31, 0.1, 0, 0]", true),
                ("-0.31", true),
                ("{\"k1\": -0.31}", true),
                ("[[0.0, 0.1]]", true),
                ("[0, 0.0]", false),
                ("0", false),
                ("null", false),
                ("\"plumb_bob\"", false),
            ] {
                let entry = read(&format!("\"{name}\": {value}"), "");
                let whole = read("\"status\": \"\"", &format!("\"{name}\": {value},"));
                for read in [entry, whole] {
                    assert_eq!(read.is_err(), refused, "{name} {value}");
                    assert!(
                        read.err()
                            .is_none_or(|error| error.contains("lens distortion") && error.contains(name))
                    );
                }
            }
        }
        assert!(read("\"note\": [1, 2], \"serial\": 7", "\"rms\": 0.3,").is_ok());
    }

    #[test]
    fn what_a_file_says_against_how_it_is_read_is_refused() {
        for (entry, refused) in [
            ("\"camera_model\": \"KANNALA_BRANDT8\"", "pinhole"),
            ("\"distortion_model\": \"equidistant\"", "pinhole"),
            ("\"camera_model\": \"OPENCV_FISHEYE\"", "pinhole"),
            ("\"camera_model\": \"OmniVision OV9782\"", ""),
            ("\"model\": \"PINHOLE\"", ""),
            ("\"distortion_model\": \"plumb_bob\"", ""),
            ("\"rectified\": false", "not rectified"),
            ("\"rectified\": true", ""),
            ("\"units\": \"mm\"", "in `mm`"),
            ("\"units\": \"Meters\"", ""),
            ("\"convention\": \"OpenGL\"", "axes are those of `opengl`"),
            ("\"convention\": \"opencv\"", ""),
            ("\"skew\": 0.3", "skewed"),
            ("\"skew\": 0.0", ""),
            ("\"note\": \"fisheye mounts\"", ""),
        ] {
            for read in [read(entry, ""), read("\"status\": \"\"", &format!("{entry},"))] {
                let said = read.err().unwrap_or_default();
                assert_eq!(said.is_empty(), refused.is_empty(), "{entry}: {said}");
                assert!(said.contains(refused), "{entry}: {said}");
            }
        }
    }

    #[test]
    fn a_pose_that_is_none_names_the_camera_and_the_forms() {
        let calibration = read("\"camera_to_base\": [1, 2, 3]", "").unwrap();
        let error = calibration.camera(&["a"], (4, 4)).err().unwrap();
        assert!(error.message.contains("`camera_to_base` of `a`: not a pose"), "{error}");
        assert!(error.hint.unwrap().contains("3x4"));
        let calibration = read("\"camera_to_base\": [0.1, 0.2, 0.3, 0, 0, 1.5]", "").unwrap();
        assert!(calibration.camera(&["a"], (4, 4)).unwrap().unwrap().mount.is_some());
    }
}
