//! Calibrations that were published after the data: a folder with the files of the annotation release, factory
//! calibrations of the cameras (`SNserial.conf`), and hand-eyes by robot. All are joined by the episode's uuid or by serial.

mod intrinsics;
mod kept;
mod poses;
mod tables;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_geometry::{Camera, Link, Pose};
use rogs_worker::{StageError, StageResult};
use serde_json::Value;

use self::intrinsics::INTRINSICS;
pub(super) use self::intrinsics::Lens;
pub(super) use self::poses::Poses;
use self::poses::{BETWEEN, HAND_EYES, NOT_TO_BASE, POSES};
use self::tables::{Tables, Wanted};
use super::metadata::{Metadata, Serial};
use super::{tree, zed};
use crate::calibration::Calibration;
use crate::fault::wrong;
use crate::params::Quality;

const SERIALS: &str = "camera_serials.json";
const PLACES: &str = "episode_id_to_path.json";
const LANGUAGE: &str = "droid_language_annotations.json";

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

/// Looks an episode up in every file of a folder of published calibrations, by a uuid and the serial of a camera. Ingest
/// does so for the cameras whose videos are there; this is for the fuzz target, which has none.
///
/// # Errors
/// When a file is no table, or its entry of the episode is wrong.
pub fn look_up_published(folder: &Path, uuid: &str, serial: &str) -> StageResult<()> {
    let published = Published::open(folder)?;
    let asked = BTreeMap::new();
    let place = format!("LAB/success/2023-07-07/{uuid}");
    // One wrong file does not keep the others from being read.
    let all = [
        published.uuid_of(folder).map(drop),
        published.serials(uuid).map(drop),
        published.pose(uuid, serial, &asked).map(drop),
        published.only_between_cameras(uuid, serial).map(drop),
        published.kept(Some(&place)).map(drop),
        published.intrinsics(uuid, serial).map(drop),
        published.factory(serial).map(drop),
        published.hand_eye(Some(serial), serial).map(drop),
        published.task(uuid).map(drop),
    ];
    all.into_iter().collect()
}

/// A folder of calibrations.
#[derive(Debug)]
pub(super) struct Published {
    tables: Tables,
}

impl Published {
    /// Checks that a folder holds something that is known.
    pub(super) fn open(folder: &Path) -> StageResult<Self> {
        let published = Self {
            tables: Tables::of(folder),
        };
        let known = POSES
            .into_iter()
            .chain([INTRINSICS, SERIALS, PLACES, LANGUAGE, HAND_EYES]);
        let any = known.into_iter().any(|name| folder.join(name).is_file());
        let conf = |name: &str| name.starts_with("SN") && name.ends_with(".conf");
        if any
            || published
                .tables
                .names()?
                .iter()
                .any(|name| conf(name) || kept::is_kept(name))
        {
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
        let found = self.tables.find(PLACES, Wanted::Fits(&here))?;
        Ok(found.map(|(uuid, _)| uuid))
    }

    /// Serials of the wrist camera and the two external ones.
    pub(super) fn serials(&self, uuid: &str) -> StageResult<Option<[Option<String>; 3]>> {
        let Some((_, entry)) = self.tables.find(SERIALS, Wanted::Key(uuid))? else {
            return Ok(None);
        };
        let entry: Metadata = serde_json::from_value(entry).map_err(|error| {
            self.tables
                .wrong(SERIALS, format!("the serials of `{uuid}` are not readable: {error}"))
        })?;
        let text = |serial: Option<Serial>| serial.and_then(|serial| serial.text());
        Ok(Some(
            [entry.wrist_cam_serial, entry.ext1_cam_serial, entry.ext2_cam_serial].map(text),
        ))
    }

    /// Camera-to-base pose of the left eye of an external camera: the first one whose quality is as asked.
    pub(super) fn pose(&self, uuid: &str, serial: &str, asked: &BTreeMap<String, Quality>) -> StageResult<Poses> {
        poses::of_camera(&self.tables, uuid, serial, asked)
    }

    /// What is to be said of an external camera whose pose is not there, but that stands in the file of poses between
    /// cameras.
    pub(super) fn only_between_cameras(&self, uuid: &str, serial: &str) -> StageResult<Option<String>> {
        poses::only_between_cameras(&self.tables, uuid, serial)
    }

    /// Steps of an episode that are not idle, as intervals that end before their second number; `None` where it is not
    /// listed.
    pub(super) fn kept(&self, place: Option<&str>) -> StageResult<Option<Vec<[usize; 2]>>> {
        kept::find(&self.tables, place)
    }

    /// Intrinsics of a camera with integer pixel centres, and the image size that they belong to. `None` also for those
    /// that are all zeros; the text says so then.
    pub(super) fn intrinsics(&self, uuid: &str, serial: &str) -> StageResult<Option<Result<Lens, String>>> {
        intrinsics::find(&self.tables, uuid, serial)
    }

    /// Factory calibration of a camera.
    pub(super) fn factory(&self, serial: &str) -> StageResult<Option<zed::Factory>> {
        let path = self.tables.path(&format!("SN{serial}.conf"));
        path.is_file().then(|| zed::read(&path)).transpose()
    }

    /// Hand-eye by the serial of the robot, else by that of the wrist camera, and what it was found by.
    pub(super) fn hand_eye(
        &self,
        robot: Option<&str>,
        wrist: &str,
    ) -> StageResult<Option<(Pose<Link, Camera>, String)>> {
        poses::hand_eye(&self.tables, robot, wrist)
    }

    /// The first language instruction.
    pub(super) fn task(&self, uuid: &str) -> StageResult<Option<String>> {
        let found = self.tables.find(LANGUAGE, Wanted::Key(uuid))?;
        let text = found.and_then(|(_, entry)| Some(entry.get("language_instruction1")?.as_str()?.to_owned()));
        Ok(text.filter(|text| !text.trim().is_empty()))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

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
}
