//! `metadata_UUID.json` of a raw DROID episode.

use std::path::Path;

use rogs_worker::StageResult;
use serde::Deserialize;

use super::tree;
use crate::fault::{read_text, wrong};

/// The cameras of an episode, in the order of a clip.
pub(super) const CAMERAS: [&str; 3] = ["wrist", "ext1", "ext2"];
/// Longest metadata file, bytes.
const MAX_JSON: u64 = 1 << 20;

/// What is read of the metadata. Everything may be missing: older releases lack some keys.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Metadata {
    pub(super) uuid: Option<String>,
    pub(super) current_task: Option<String>,
    pub(super) robot_serial: Option<String>,
    /// `LAB/OUTCOME/DATE/TIME/trajectory.h5`.
    pub(super) hdf5_path: Option<String>,
    pub(super) trajectory_length: Option<u64>,
    pub(super) wrist_cam_serial: Option<Serial>,
    pub(super) ext1_cam_serial: Option<Serial>,
    pub(super) ext2_cam_serial: Option<Serial>,
    /// `[x, y, z, a, b, c]` of the left eye at step 0, camera to base.
    pub(super) wrist_cam_extrinsics: Option<Vec<f64>>,
    pub(super) ext1_cam_extrinsics: Option<Vec<f64>>,
    pub(super) ext2_cam_extrinsics: Option<Vec<f64>>,
}

/// A serial number; some writers have it as a number.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
pub(super) enum Serial {
    Text(String),
    Number(u64),
}

impl Serial {
    /// The serial as it is in file names; `None` when it cannot be one.
    pub(super) fn text(&self) -> Option<String> {
        let text = match self {
            Self::Text(text) => text.trim().to_owned(),
            Self::Number(number) => number.to_string(),
        };
        let plain = !text.is_empty() && text.len() <= 32 && text.bytes().all(|byte| byte.is_ascii_alphanumeric());
        plain.then_some(text)
    }
}

/// Reads the metadata of an episode's folder, if it is there.
pub(super) fn read(root: &Path) -> StageResult<Option<Metadata>> {
    let Some(name) = tree::metadata_name(root) else {
        return Ok(None);
    };
    let path = root.join(&name);
    let text = read_text(&path, MAX_JSON)?;
    let mut metadata: Metadata = rogs_schemas::json::read(&text).map_err(|error| {
        let error = wrong(&path, format!("not the metadata of a DROID episode: {error}"));
        if text.contains("NaN") {
            error.with_hint("Python's `NaN` is not a number: give that camera another calibration")
        } else {
            error
        }
    })?;
    let named = tree::uuid_of(&name).unwrap_or_default();
    match &metadata.uuid {
        Some(uuid) if uuid != named => {
            return Err(wrong(&path, format!("its `uuid` is `{uuid}`, its name says `{named}`")));
        }
        Some(_) => {}
        None => metadata.uuid = Some(named.to_owned()),
    }
    Ok(Some(metadata))
}
