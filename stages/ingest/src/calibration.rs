//! Calibration files: intrinsics and poses for layouts that have none (`docs/calibration-format.md`).

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DMat3, DQuat};
use rogs_geometry::rotation_from_euler_xyz;
use rogs_schemas::Intrinsics;
use rogs_schemas::episode::PixelCentres;
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
        let file: File = serde_json::from_str(&text).map_err(|error| {
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
            (Some(matrix), None, _) => Some(SourceMount::Fixed(checks::rigid_pose(
                &matrix_of(matrix, &format!("`camera_to_base` of `{name}`"), path)?,
                &format!("`camera_to_base` of `{name}`"),
                path,
            )?)),
            (None, Some(matrix), Some(link)) => {
                let what = format!("`camera_to_link` of `{name}`");
                Some(SourceMount::HandEye {
                    link: link.clone(),
                    link_from_camera: checks::rigid_pose(&matrix_of(matrix, &what, path)?, &what, path)?,
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

/// The 4x4 matrix of a pose: four rows, the first three of them, six numbers `x y z roll pitch yaw` (metres, radians, as in
/// DROID), or an object of `translation` and `quaternion_xyzw` or `quaternion_wxyz`.
fn matrix_of(value: &Value, what: &str, path: &Path) -> StageResult<[[f64; 4]; 4]> {
    const LAST: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
    let numbers = |value: &Value| -> Option<Vec<f64>> { value.as_array()?.iter().map(Value::as_f64).collect() };
    let rows = || -> Option<Vec<[f64; 4]>> {
        value
            .as_array()?
            .iter()
            .map(|row| numbers(row)?.try_into().ok())
            .collect()
    };
    let from_parts = |rotation: DMat3, translation: &[f64]| {
        let row = |axis: usize| {
            let row = rotation.row(axis);
            [row.x, row.y, row.z, translation[axis]]
        };
        [row(0), row(1), row(2), LAST]
    };
    if let Some(rows) = rows() {
        match rows.as_slice() {
            [a, b, c] => return Ok([*a, *b, *c, LAST]),
            [a, b, c, d] => return Ok([*a, *b, *c, *d]),
            _ => {}
        }
    }
    if let Some([x, y, z, a, b, c]) = numbers(value).as_deref() {
        return Ok(from_parts(rotation_from_euler_xyz([*a, *b, *c]), &[*x, *y, *z]));
    }
    if let Some(translation) = value
        .get("translation")
        .and_then(numbers)
        .filter(|numbers| numbers.len() == 3)
    {
        let xyzw = value.get("quaternion_xyzw").and_then(numbers);
        let wxyz = value.get("quaternion_wxyz").and_then(numbers);
        let quaternion = match (xyzw.as_deref(), wxyz.as_deref()) {
            (Some(&[x, y, z, w]), None) | (None, Some(&[w, x, y, z])) => DQuat::from_xyzw(x, y, z, w),
            _ => DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0),
        };
        if (quaternion.length() - 1.0).abs() < 1e-3 {
            return Ok(from_parts(DMat3::from_quat(quaternion.normalize()), &translation));
        }
    }
    Err(wrong(path, format!("{what} is no pose")).with_hint(
        "expected a 4x4 or 3x4 matrix in rows, `[x, y, z, roll, pitch, yaw]`, or `translation` with a unit \
         `quaternion_xyzw` or `quaternion_wxyz`",
    ))
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
    fn poses_come_in_every_usual_form() {
        let pose = |text: &str| matrix_of(&serde_json::from_str(text).unwrap(), "pose", Path::new("c.json"));
        let expected = [
            [0.0, -1.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, 2.0],
            [0.0, 0.0, 1.0, 3.0],
            [0.0, 0.0, 0.0, 1.0],
        ];
        for text in [
            "[[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]",
            "[[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]]",
            "[1, 2, 3, 0, 0, 1.5707963267948966]",
            "{\"translation\": [1, 2, 3], \"quaternion_xyzw\": [0, 0, 0.7071067811865476, 0.7071067811865476]}",
            "{\"translation\": [1, 2, 3], \"quaternion_wxyz\": [0.7071067811865476, 0, 0, 0.7071067811865476]}",
        ] {
            let found = pose(text).unwrap();
            let same = found
                .iter()
                .flatten()
                .zip(expected.iter().flatten())
                .all(|(a, b)| (a - b).abs() < 1e-12);
            assert!(same, "{text}: {found:?}");
        }
        for text in [
            "[[1, 2], [3, 4]]",
            "[1, 2, 3]",
            "{\"translation\": [1, 2, 3]}",
            "7",
            "[[1, 0, 0, 0]]",
            "{\"translation\": [1, 2, 3], \"quaternion_xyzw\": [0, 0, 0, 2]}",
        ] {
            let error = pose(text).unwrap_err();
            assert!(
                error.message.contains("is no pose") && error.hint.unwrap().contains("3x4"),
                "{text}"
            );
        }
    }
}
