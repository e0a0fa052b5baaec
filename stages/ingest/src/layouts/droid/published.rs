//! Calibrations that were published after the data: a folder with the files of the annotation release, factory
//! calibrations of the cameras (`SNserial.conf`), and hand-eyes by robot. All are joined by the episode's uuid or by serial.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use rogs_geometry::{Camera, Link, Pose};
use rogs_schemas::{Intrinsics, RigidPose};
use rogs_worker::{StageError, StageResult};
use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, Visitor};
use serde_json::Value;

use super::metadata::{Metadata, Serial};
use super::{tree, zed};
use crate::calibration::Calibration;
use crate::checks;
use crate::fault::{io_error, wrong};
use crate::params::Quality;

/// Extrinsics files, the better one first.
const POSES: [&str; 2] = ["cam2base_extrinsic_superset.json", "cam2base_extrinsics.json"];
const INTRINSICS: &str = "intrinsics.json";
const SERIALS: &str = "camera_serials.json";
const PLACES: &str = "episode_id_to_path.json";
const LANGUAGE: &str = "droid_language_annotations.json";
const HAND_EYES: &str = "gripper2wrist_transforms.json";
/// Poses of one external camera in the other.
const BETWEEN: &str = "cam2cam_extrinsics.json";
/// Steps that are not idle, by `FOLDER--FILE` of an episode: `[[start, end), ...]`. The version is in the name.
const KEPT: &str = "keep_ranges";
/// Numbers of a calibration's quality that are kept at most.
const MAX_NUMBERS: usize = 16;

/// What calibrates an episode besides its own files.
pub(super) struct Calibrations {
    /// Our own calibration file.
    pub(super) own: Option<Calibration>,
    /// A folder of published files.
    pub(super) published: Option<Published>,
}

impl Calibrations {
    /// `path` is a file of ours or a folder of published ones.
    pub(super) fn open(path: Option<&Path>) -> StageResult<Self> {
        let mut all = Self {
            own: None,
            published: None,
        };
        match path {
            Some(path) if path.is_dir() => all.published = Some(Published::open(path)?),
            Some(path) => {
                let own = Calibration::read(path).map_err(|error| {
                    error.with_hint(
                        "give a file as docs/calibration-format.md has it, or the folder that holds published files of \
                         DROID (docs/droid.md)",
                    )
                })?;
                all.own = Some(own);
            }
            None => {}
        }
        Ok(all)
    }
}

/// A folder of calibrations.
#[derive(Debug)]
pub(super) struct Published {
    folder: PathBuf,
}

impl Published {
    /// Checks that a folder holds something that is known.
    pub(super) fn open(folder: &Path) -> StageResult<Self> {
        let published = Self {
            folder: folder.to_owned(),
        };
        let known = POSES
            .into_iter()
            .chain([INTRINSICS, SERIALS, PLACES, LANGUAGE, HAND_EYES]);
        let any = known.into_iter().any(|name| folder.join(name).is_file());
        let conf = |name: &str| name.starts_with("SN") && name.ends_with(".conf");
        if any || names(folder)?.iter().any(|name| conf(name) || is_kept(name)) {
            return Ok(published);
        }
        if folder.join(BETWEEN).is_file() {
            return Err(
                wrong(&folder.join(BETWEEN), NOT_TO_BASE).with_hint(format!("add {} and {}", POSES[0], POSES[1]))
            );
        }
        Err(StageError::bad_input(format!(
            "`{}` holds no calibration of DROID that is known",
            folder.display()
        ))
        .with_hint("docs/droid.md names the files"))
    }

    /// The uuid of an episode by its place.
    pub(super) fn uuid_of(&self, root: &Path) -> StageResult<Option<String>> {
        let Some(place) = root.canonicalize().ok().and_then(|root| tree::place(&root)) else {
            return Ok(None);
        };
        let here = |value: &Value| {
            let path = value.as_str().map(|text| PathBuf::from(text.trim_end_matches('/')));
            path.and_then(|path| tree::place(&path)).as_ref() == Some(&place)
        };
        let found = self.find(PLACES, Wanted::Fits(&here))?;
        Ok(found.map(|(uuid, _)| uuid))
    }

    /// Serials of the wrist camera and the two external ones.
    pub(super) fn serials(&self, uuid: &str) -> StageResult<Option<[Option<String>; 3]>> {
        let Some((_, entry)) = self.find(SERIALS, Wanted::Key(uuid))? else {
            return Ok(None);
        };
        let entry: Metadata = serde_json::from_value(entry)
            .map_err(|error| self.wrong(SERIALS, format!("the serials of `{uuid}` are not readable: {error}")))?;
        let text = |serial: Option<Serial>| serial.and_then(|serial| serial.text());
        Ok(Some(
            [entry.wrist_cam_serial, entry.ext1_cam_serial, entry.ext2_cam_serial].map(text),
        ))
    }

    /// Camera-to-base pose of the left eye of an external camera: the first one whose quality is as asked.
    pub(super) fn pose(&self, uuid: &str, serial: &str, asked: &BTreeMap<String, Quality>) -> StageResult<Poses> {
        let mut found = Poses::default();
        for name in POSES {
            let Some((_, entry)) = self.find(name, Wanted::Key(uuid))? else {
                continue;
            };
            let keys = [serial.to_owned(), format!("{serial}_left")];
            let Some(value) = keys.iter().find_map(|key| entry.get(key)) else {
                continue;
            };
            let numbers = numbers(value.get("extrinsics").unwrap_or(value));
            let what = format!("the pose of camera {serial} of `{uuid}`");
            let Some(Ok(six)) = numbers.map(<[f64; 6]>::try_from) else {
                return Err(self.wrong(name, format!("{what} is not a list of 6 numbers")));
            };
            let pose = checks::euler_pose(&six, &what, &self.folder.join(name))?;
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
    pub(super) fn only_between_cameras(&self, uuid: &str, serial: &str) -> StageResult<Option<String>> {
        let found = self.find(BETWEEN, Wanted::Key(uuid))?;
        let named = found.is_some_and(|(_, entry)| entry.to_string().contains(serial));
        Ok(named.then(|| format!("`{BETWEEN}` has camera {serial}, but is not read: {NOT_TO_BASE}")))
    }

    /// Steps of an episode that are not idle, as intervals that end before their second number; `None` where it is not
    /// listed.
    pub(super) fn kept(&self, place: Option<&str>) -> StageResult<Option<Vec<[usize; 2]>>> {
        let names = names(&self.folder)?;
        let (Some(place), Some(name)) = (place, names.iter().find(|name| is_kept(name))) else {
            return Ok(None);
        };
        let here = |key: &str| {
            let folder = key.split("--").next().unwrap_or(key);
            tree::place_within(folder).as_deref() == Some(place)
        };
        let Some((_, value)) = self.find(name, Wanted::Named(&here))? else {
            return Ok(None);
        };
        let pair = |pair: &Value| {
            let [start, end] = <[f64; 2]>::try_from(numbers(pair)?).ok()?;
            let whole = |number: f64| (0.0..1e9).contains(&number) && number.fract() == 0.0;
            (whole(start) && whole(end) && start <= end).then_some([start as usize, end as usize])
        };
        let ranges: Option<Vec<[usize; 2]>> = value.as_array().and_then(|pairs| pairs.iter().map(pair).collect());
        ranges
            .map(Some)
            .ok_or_else(|| self.wrong(name, format!("the entry of {place} is no list of [start, end)")))
    }

    /// Intrinsics of a camera with integer pixel centres, and the image size that they belong to. `None` also for those
    /// that are all zeros; the text says so then.
    pub(super) fn intrinsics(&self, uuid: &str, serial: &str) -> StageResult<Option<Result<Lens, String>>> {
        let Some((_, entry)) = self.find(INTRINSICS, Wanted::Key(uuid))? else {
            return Ok(None);
        };
        let keys = [serial.to_owned(), format!("{serial}_left")];
        let Some(value) = keys.iter().find_map(|key| entry.get(key)) else {
            return Ok(None);
        };
        match lens(value) {
            Ok(lens) => Ok(Some(Ok(lens))),
            Err(Fault::Zeros) => Ok(Some(Err(format!("`{INTRINSICS}` has zeros for camera {serial}")))),
            Err(Fault::Wrong(what)) => Err(self.wrong(INTRINSICS, format!("camera {serial} of `{uuid}`: {what}"))),
        }
    }

    /// Factory calibration of a camera.
    pub(super) fn factory(&self, serial: &str) -> StageResult<Option<zed::Factory>> {
        let path = self.folder.join(format!("SN{serial}.conf"));
        path.is_file().then(|| zed::read(&path)).transpose()
    }

    /// Hand-eye by the serial of the robot, else by that of the wrist camera, and what it was found by.
    pub(super) fn hand_eye(
        &self,
        robot: Option<&str>,
        wrist: &str,
    ) -> StageResult<Option<(Pose<Link, Camera>, String)>> {
        let by_camera = |value: &Value| value.get("wrist_cam_serial").and_then(Value::as_str) == Some(wrist);
        let by_robot = match robot {
            Some(robot) => self.find(HAND_EYES, Wanted::Key(robot))?,
            None => None,
        };
        let (found, by) = match by_robot {
            Some(found) => (Some(found), format!("robot {}", robot.unwrap_or_default())),
            None => (
                self.find(HAND_EYES, Wanted::Fits(&by_camera))?,
                format!("wrist camera {wrist}"),
            ),
        };
        let Some((_, entry)) = found else { return Ok(None) };
        let what = format!("the hand-eye of {by}");
        let rows = entry.get("mean_mat").and_then(Value::as_array);
        let flat: Option<Vec<f64>> = rows.map(|rows| rows.iter().filter_map(numbers).flatten().collect());
        let Some(Ok(flat)) = flat.map(<[f64; 16]>::try_from) else {
            return Err(self.wrong(HAND_EYES, format!("{what} has no 4x4 matrix `mean_mat`")));
        };
        // The file maps points of the flange to the camera.
        let camera_from_link: Pose<Camera, Link> = Pose::from_matrix4(&flat)
            .map_err(|error| self.wrong(HAND_EYES, format!("{what} is not rigid: {error}")))?;
        Ok(Some((camera_from_link.inverse().orthonormalized(), by)))
    }

    /// The first language instruction.
    pub(super) fn task(&self, uuid: &str) -> StageResult<Option<String>> {
        let found = self.find(LANGUAGE, Wanted::Key(uuid))?;
        let text = found.and_then(|(_, entry)| Some(entry.get("language_instruction1")?.as_str()?.to_owned()));
        Ok(text.filter(|text| !text.trim().is_empty()))
    }

    /// The first entry of a file that is wanted; nothing else of it is kept.
    fn find(&self, name: &str, wanted: Wanted<'_>) -> StageResult<Option<(String, Value)>> {
        let path = self.folder.join(name);
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(io_error(&path, &error)),
        };
        let mut json = serde_json::Deserializer::from_reader(BufReader::with_capacity(1 << 16, file));
        let found = wanted.deserialize(&mut json);
        found.map_err(|error| wrong(&path, format!("not a table by episode: {error}")))
    }

    fn wrong(&self, name: &str, what: String) -> StageError {
        wrong(&self.folder.join(name), what)
    }
}

/// Why poses between cameras calibrate nothing here.
const NOT_TO_BASE: &str = "it has poses of one external camera in the other, and none in the robot's base";

/// What is known of a camera's pose.
#[derive(Debug, Default)]
pub(super) struct Poses {
    /// The pose, with its file and the numbers of its quality in words.
    pub(super) taken: Option<(RigidPose, String)>,
    /// Poses that were not good enough, in words.
    pub(super) refused: Vec<String>,
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

/// Names in a folder.
fn names(folder: &Path) -> StageResult<Vec<String>> {
    let entries = std::fs::read_dir(folder).map_err(|error| io_error(folder, &error))?;
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .collect();
    names.sort();
    Ok(names)
}

/// `keep_ranges_1_0_1.json`
fn is_kept(name: &str) -> bool {
    name.starts_with(KEPT) && name.ends_with(".json")
}

/// Intrinsics and the width and height of the images they belong to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lens {
    pub(super) intrinsics: Intrinsics,
    pub(super) size: (u32, u32),
}

enum Fault {
    Zeros,
    Wrong(String),
}

/// `[fx, cx, fy, cy]`, or an object with these as `cameraMatrix` and `width` and `height`; or a 3x3 `cameraMatrix`.
fn lens(value: &Value) -> Result<Lens, Fault> {
    let wrong = |what: &str| Fault::Wrong(what.to_owned());
    let (matrix, size) = match value.get("cameraMatrix") {
        None => (value, zed::SIZE),
        Some(matrix) => {
            let side = |key: &str| match value.get(key) {
                None => Ok(None),
                Some(side) => match side.as_u64().and_then(|side| u32::try_from(side).ok()) {
                    Some(side) if (1..=8192).contains(&side) => Ok(Some(side)),
                    _ => Err(wrong(&format!("invalid `{key}`: expected the side of an image"))),
                },
            };
            let size = match (side("width")?, side("height")?) {
                (Some(width), Some(height)) => (width, height),
                (None, None) => zed::SIZE,
                _ => return Err(wrong("`width` and `height` belong together")),
            };
            (matrix, size)
        }
    };
    let rows: Option<Vec<Vec<f64>>> = matrix.as_array().and_then(|rows| rows.iter().map(numbers).collect());
    let four = match (numbers(matrix), rows.as_deref()) {
        (Some(four), _) => four,
        (None, Some([first, second, _])) if first.len() == 3 && second.len() == 3 => {
            vec![first[0], first[2], second[1], second[2]]
        }
        _ => return Err(wrong("its intrinsics are no list of numbers")),
    };
    let Ok([fx, cx, fy, cy]) = <[f64; 4]>::try_from(four) else {
        return Err(wrong("its intrinsics are not the four numbers fx, cx, fy, cy"));
    };
    if [fx, cx, fy, cy].iter().all(|&number| number == 0.0) {
        return Err(Fault::Zeros);
    }
    // Pixels are square before anybody resizes: fx and fy agree.
    if (fx / fy - 1.0).abs() > 0.1 && (fx / cx - 1.0).abs() < 0.05 {
        return Err(wrong(&format!(
            "[{fx}, {cx}, {fy}, {cy}] looks like fx, fy, cx, cy; the order of this file is fx, cx, fy, cy"
        )));
    }
    Ok(Lens {
        intrinsics: Intrinsics { fx, fy, cx, cy },
        size,
    })
}

fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(Value::as_f64).collect()
}

/// Which entry of a table is wanted.
enum Wanted<'a> {
    Key(&'a str),
    Named(&'a dyn Fn(&str) -> bool),
    Fits(&'a dyn Fn(&Value) -> bool),
}

impl<'de> DeserializeSeed<'de> for Wanted<'_> {
    type Value = Option<(String, Value)>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Wanted<'_> {
    type Value = Option<(String, Value)>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("an object by episode or serial")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut found = None;
        while let Some(key) = map.next_key::<String>()? {
            match self {
                Self::Key(wanted) if found.is_none() && key == wanted => found = Some((key, map.next_value()?)),
                Self::Named(fits) if found.is_none() && fits(&key) => found = Some((key, map.next_value()?)),
                Self::Fits(fits) if found.is_none() => {
                    let value = map.next_value()?;
                    found = fits(&value).then_some((key, value));
                }
                _ => {
                    let _: IgnoredAny = map.next_value()?;
                }
            }
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn of(value: Value) -> Result<Lens, String> {
        lens(&value).map_err(|fault| match fault {
            Fault::Zeros => "zeros".to_owned(),
            Fault::Wrong(what) => what,
        })
    }

    #[test]
    fn every_published_form_of_intrinsics_is_read() {
        let expected = Intrinsics {
            fx: 524.3,
            fy: 524.5,
            cx: 639.8,
            cy: 370.3,
        };
        let four = json!([524.3, 639.8, 524.5, 370.3]);
        assert_eq!(
            of(four.clone()).unwrap(),
            Lens {
                intrinsics: expected,
                size: (1280, 720)
            }
        );
        let object = of(json!({"cameraMatrix": four, "width": 640, "height": 360, "distCoeffs": [0]})).unwrap();
        assert_eq!(
            object,
            Lens {
                intrinsics: expected,
                size: (640, 360)
            }
        );
        let matrix = json!({"cameraMatrix": [[524.3, 0, 639.8], [0, 524.5, 370.3], [0, 0, 1]]});
        assert_eq!(of(matrix).unwrap().intrinsics, expected);
    }

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
        let published = Published::open(folder.path()).unwrap();
        let asked = |key: &str, min: Option<f64>, max: Option<f64>| {
            let asked = BTreeMap::from([(key.to_owned(), Quality { min, max })]);
            published.pose("LAB+a+1", "24400334", &asked).unwrap()
        };
        let none = published.pose("LAB+a+1", "24400334", &BTreeMap::new()).unwrap();
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

    #[test]
    fn ranges_that_are_kept_are_joined_by_place() {
        let folder = tempfile::tempdir().unwrap();
        let at = |time: &str| format!("gs://x/r2d2/LAB/success/2023-07-07/{time}");
        let key = |time: &str| format!("{}/recordings/MP4--{}/trajectory.h5", at(time), at(time));
        let table =
            json!({key("Fri_Jul__7_09:42:23_2023"): [[3, 40], [50, 61]], key("Fri_Jul__7_10:00:00_2023"): [[5, 2]]});
        rogs_files::write_bytes(
            &folder.path().join("keep_ranges_1_0_1.json"),
            table.to_string().as_bytes(),
        )
        .unwrap();
        let published = Published::open(folder.path()).unwrap();
        let kept = |place: &str| published.kept(Some(place));
        let here = "LAB/success/2023-07-07/Fri_Jul_7_09_42_23_2023";
        assert_eq!(kept(here).unwrap(), Some(vec![[3, 40], [50, 61]]));
        assert_eq!(kept("LAB/failure/2023-07-07/Fri_Jul_7_09_42_23_2023").unwrap(), None);
        let error = kept("LAB/success/2023-07-07/Fri_Jul_7_10_00_00_2023").unwrap_err();
        assert!(error.message.contains("no list of [start, end)"), "{error}");
    }

    #[test]
    fn poses_between_cameras_alone_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let table = json!({"LAB+a+1": {"24400334-22008760": [0.0]}}).to_string();
        rogs_files::write_bytes(&folder.path().join(BETWEEN), table.as_bytes()).unwrap();
        let error = Published::open(folder.path()).unwrap_err();
        assert!(
            error.message.contains(BETWEEN) && error.message.contains("none in the robot's base"),
            "{error}"
        );
        rogs_files::write_bytes(&folder.path().join(SERIALS), b"{}").unwrap();
        let published = Published::open(folder.path()).unwrap();
        assert!(published.only_between_cameras("LAB+a+1", "24400334").unwrap().is_some());
        assert!(published.only_between_cameras("LAB+a+1", "24400335").unwrap().is_none());
    }

    #[test]
    fn other_orders_and_zeros_are_told() {
        assert_eq!(of(json!([0, 0, 0, 0])).unwrap_err(), "zeros");
        assert!(
            of(json!([524.3, 524.5, 639.8, 370.3]))
                .unwrap_err()
                .contains("looks like fx, fy, cx, cy")
        );
        assert!(of(json!([1, 2, 3])).unwrap_err().contains("four numbers"));
        assert!(of(json!("x")).unwrap_err().contains("no list"));
        assert!(
            of(json!({"cameraMatrix": [1, 2, 3, 4], "width": 640}))
                .unwrap_err()
                .contains("belong together")
        );
    }
}
