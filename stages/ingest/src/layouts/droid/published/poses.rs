//! Published poses of external cameras, with the numbers of their quality, and hand-eyes by robot.

use std::collections::BTreeMap;

use rogs_geometry::{Camera, Link, Pose};
use rogs_schemas::{RigidPose, WrittenPose};
use rogs_worker::StageResult;
use serde_json::Value;

use super::tables::{Tables, Wanted};
use crate::checks;
use crate::params::Quality;

/// Extrinsics files, the better one first.
pub(super) const POSES: [&str; 2] = ["cam2base_extrinsic_superset.json", "cam2base_extrinsics.json"];
pub(super) const HAND_EYES: &str = "gripper2wrist_transforms.json";
/// Poses of one external camera in the other.
pub(super) const BETWEEN: &str = "cam2cam_extrinsics.json";
/// Why poses between cameras calibrate nothing here.
pub(super) const NOT_TO_BASE: &str = "it has poses of one external camera in the other, and none in the robot's base";
/// Numbers of a calibration's quality that are kept at most.
const MAX_NUMBERS: usize = 16;

/// Camera-to-base pose of the left eye of an external camera: the first one whose quality is as asked.
pub(super) fn of_camera(
    tables: &Tables,
    uuid: &str,
    serial: &str,
    asked: &BTreeMap<String, Quality>,
) -> StageResult<Poses> {
    let mut found = Poses::default();
    for name in POSES {
        let Some((_, entry)) = tables.find(name, Wanted::Key(uuid))? else {
            continue;
        };
        let keys = [serial.to_owned(), format!("{serial}_left")];
        let Some(value) = keys.iter().find_map(|key| entry.get(key)) else {
            continue;
        };
        let what = format!("the pose of camera {serial} of `{uuid}`");
        let written = WrittenPose::from_json(value.get("extrinsics").unwrap_or(value))
            .map_err(|expected| tables.wrong(name, format!("{what} is not a pose")).with_hint(expected))?;
        let pose = checks::rigid_pose(&written, &what, &tables.path(name))?;
        let quality = quality(&entry, value, serial);
        match asked.iter().find_map(|(key, asked)| asked.misses(key, &quality)) {
            Some(why) => found
                .refused
                .push(format!("the pose of camera {serial} in `{name}` is not taken: {why}")),
            None => {
                let numbers: Vec<String> = quality
                    .iter()
                    .map(|(key, number)| format!(", {key} {number}"))
                    .collect();
                found.taken = Some((pose, format!("{name}{}", numbers.concat())));
                break;
            }
        }
    }
    Ok(found)
}

/// What is to be said of an external camera whose pose is not there, but that stands in the file of poses between
/// cameras.
pub(super) fn only_between_cameras(tables: &Tables, uuid: &str, serial: &str) -> StageResult<Option<String>> {
    let found = tables.find(BETWEEN, Wanted::Key(uuid))?;
    let named = found.is_some_and(|(_, entry)| entry.to_string().contains(serial));
    Ok(named.then(|| format!("`{BETWEEN}` has camera {serial}, but is not read: {NOT_TO_BASE}")))
}

/// Hand-eye by the serial of the robot, else by that of the wrist camera, and what it was found by.
pub(super) fn hand_eye(
    tables: &Tables,
    robot: Option<&str>,
    wrist: &str,
) -> StageResult<Option<(Pose<Link, Camera>, String)>> {
    let by_camera = |value: &Value| value.get("wrist_cam_serial").and_then(Value::as_str) == Some(wrist);
    let by_robot = match robot {
        Some(robot) => tables.find(HAND_EYES, Wanted::Key(robot))?,
        None => None,
    };
    let (found, by) = match by_robot {
        Some(found) => (Some(found), format!("robot {}", robot.unwrap_or_default())),
        None => (
            tables.find(HAND_EYES, Wanted::Fits(&by_camera))?,
            format!("wrist camera {wrist}"),
        ),
    };
    let Some((_, entry)) = found else { return Ok(None) };
    let what = format!("the hand-eye of {by}");
    let written = WrittenPose::from_json(entry.get("mean_mat").unwrap_or(&Value::Null)).map_err(|expected| {
        tables
            .wrong(HAND_EYES, format!("{what} has no pose `mean_mat`"))
            .with_hint(expected)
    })?;
    // The file maps points of the flange to the camera.
    let camera_from_link: Pose<Camera, Link> = Pose::from_written(&written)
        .map_err(|error| tables.wrong(HAND_EYES, format!("{what} is not rigid: {error}")))?;
    Ok(Some((camera_from_link.inverse().orthonormalized(), by)))
}

/// What is known of a camera's pose.
#[derive(Debug, Default)]
pub(in super::super) struct Poses {
    /// The pose, with its file and the numbers of its quality in words.
    pub(in super::super) taken: Option<(RigidPose, String)>,
    /// Poses that were not good enough, in words.
    pub(in super::super) refused: Vec<String>,
}

impl Quality {
    /// Why a calibration with these numbers is not as asked; `None` when it is.
    fn misses(&self, key: &str, numbers: &BTreeMap<String, f64>) -> Option<String> {
        let Some(&number) = numbers.get(key) else {
            let known: Vec<&str> = numbers.keys().map(String::as_str).collect();
            let known = if known.is_empty() {
                "no numbers of quality".to_owned()
            } else {
                known.join(", ")
            };
            return Some(format!("`quality.{key}` is asked for, and it has {known}"));
        };
        let at_least = self
            .min
            .filter(|&min| number < min)
            .map(|min| format!("{key} {number} is below {min}"));
        at_least.or_else(|| {
            self.max
                .filter(|&max| number > max)
                .map(|max| format!("{key} {number} is above {max}"))
        })
    }
}

/// The numbers beside a camera's pose: those of the episode, and those that name the camera or lie in its entry.
fn quality(episode: &Value, camera: &Value, serial: &str) -> BTreeMap<String, f64> {
    let mut found = BTreeMap::new();
    let fields = [episode, camera].into_iter().filter_map(Value::as_object).flatten();
    for (key, value) in fields {
        let Some(number) = value.as_f64() else { continue };
        let name = key.replace(serial, "").trim_matches(['_', '-', '+', ' ']).to_owned();
        // A serial that is still there is that of another camera.
        let other = name
            .split(|character: char| !character.is_ascii_digit())
            .any(|digits| digits.len() >= 6);
        if !name.is_empty() && !other && found.len() < MAX_NUMBERS {
            found.insert(name, number);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn numbers_of_quality_are_found_and_gate_a_pose() {
        let folder = tempfile::tempdir().unwrap();
        let six = [0.3, -0.6, 0.5, -2.0, 0.1, 2.5];
        let table = json!({"LAB+a+1": {
            "relative_path": "LAB/success", "24400334": six, "24400334_iou": 0.62, "22008760": six, "22008760_iou": 0.91,
            "loss": 0.25
        }});
        rogs_files::write_bytes(&folder.path().join(POSES[0]), table.to_string().as_bytes()).unwrap();
        let good = json!({"LAB+a+1": {"24400334": {"extrinsics": six, "iou": 0.83}}});
        rogs_files::write_bytes(&folder.path().join(POSES[1]), good.to_string().as_bytes()).unwrap();
        let tables = Tables::of(folder.path());
        let asked = |key: &str, min: Option<f64>, max: Option<f64>| {
            let asked = BTreeMap::from([(key.to_owned(), Quality { min, max })]);
            of_camera(&tables, "LAB+a+1", "24400334", &asked).unwrap()
        };
        let none = of_camera(&tables, "LAB+a+1", "24400334", &BTreeMap::new()).unwrap();
        assert_eq!(none.taken.unwrap().1, format!("{}, iou 0.62, loss 0.25", POSES[0]));
        // The better file's pose is not good enough, the other one's is.
        let better = asked("iou", Some(0.7), None);
        assert_eq!(better.taken.unwrap().1, format!("{}, iou 0.83", POSES[1]));
        assert!(
            better.refused[0].contains("iou 0.62 is below 0.7"),
            "{:?}",
            better.refused
        );
        assert!(asked("loss", None, Some(0.1)).taken.is_none());
        let unknown = asked("overlap", Some(0.1), None);
        assert!(
            unknown.taken.is_none() && unknown.refused[0].contains("it has iou, loss"),
            "{:?}",
            unknown.refused
        );
    }
}
