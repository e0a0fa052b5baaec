//! `UUID_cameras.json`: poses of the external cameras as PointWorld has optimised them.

use std::collections::BTreeMap;
use std::path::Path;

use rogs_schemas::records::clip::CameraRole;
use rogs_schemas::{RigidPose, WrittenPose};
use rogs_worker::StageResult;
use serde::Deserialize;
use serde_json::Value;

use super::{base_from_camera, camera_of, near, same_episode, serials};
use crate::fault::{read_text, wrong};
use crate::params::PointWorldParams;
use crate::source::{Source, SourceMount};

/// Longest file, bytes.
const MAX_JSON: u64 = 4 << 20;

#[derive(Deserialize)]
struct File {
    uuid: String,
    optimization_success: bool,
    #[serde(default)]
    optimization_summary: Option<Summary>,
    /// Cameras by serial, and keys that are not read (`scene_path`).
    #[serde(flatten)]
    others: BTreeMap<String, Value>,
}

#[derive(Deserialize)]
struct Summary {
    final_loss: f64,
}

/// Refined poses by serial, base-to-camera, once they pass the gate.
pub(super) fn join(path: &Path, source: &mut Source, params: &PointWorldParams) -> StageResult<()> {
    if !params.refined_poses {
        return Ok(());
    }
    let text = read_text(path, MAX_JSON)?;
    let file: File = rogs_schemas::json::read(&text)
        .map_err(|error| wrong(path, format!("it is not a PointWorld camera file: {error}")))?;
    same_episode(&file.uuid, source, path)?;
    let loss = file.optimization_summary.map(|summary| summary.final_loss);
    let loss = loss.ok_or_else(|| wrong(path, "it has no `optimization_summary.final_loss`"))?;
    if !file.optimization_success || !loss.is_finite() || loss >= params.max_loss {
        let ended = if file.optimization_success {
            "with"
        } else {
            "without success, with"
        };
        let text = format!(
            "the optimisation ended {ended} a loss of {loss}; below {} is taken",
            params.max_loss
        );
        return Err(wrong(path, text).with_hint(
            "leave the episode out; or set `pointworld.max_loss`, or `pointworld.refined_poses = false` for the episode's own poses",
        ));
    }
    let measured: Vec<Option<RigidPose>> = (source.cameras.iter())
        .map(|camera| match &camera.mount {
            SourceMount::Fixed(pose) if camera.role == CameraRole::Source => Some(*pose),
            _ => None,
        })
        .collect();
    let mut moved = 0;
    for (serial, camera) in &file.others {
        let Some(matrix) = camera.get("optimized_extrinsics") else {
            continue;
        };
        let what = format!("`optimized_extrinsics` of `{serial}`");
        let written = WrittenPose::from_json(matrix)
            .map_err(|expected| wrong(path, format!("{what}: not a pose")).with_hint(expected))?;
        let Some(index) = camera_of(source, serial) else {
            let known = serials(source);
            source.warnings.push(format!(
                "`{}` has a camera `{serial}` that the episode does not have (it has {known})",
                path.display()
            ));
            continue;
        };
        let own = &source.cameras[index].mount;
        if matches!(own, SourceMount::HandEye { .. }) {
            continue; // moves with the robot: one pose says nothing
        }
        let pose = base_from_camera(&written, &what, own, path)?;
        if let Some(other) = stands_at(&measured, index, &pose) {
            let other = &source.cameras[other];
            let other = other.serial.as_deref().unwrap_or(&other.id);
            let text = format!("{what} stands where the episode has `{other}`, far from where it has `{serial}`");
            return Err(
                wrong(path, text).with_hint("are the serials of two cameras exchanged, here or in the episode?")
            );
        }
        let right = source.cameras.iter().position(|camera| {
            let partner = camera.partner.as_deref();
            partner == Some(source.cameras[index].id.as_str())
        });
        if let Some(right) = right {
            follow(source, (index, right), pose)?;
        }
        source.cameras[index].mount = SourceMount::Fixed(pose);
        moved += 1;
    }
    if moved == 0 {
        return Err(wrong(
            path,
            format!(
                "it has no `optimized_extrinsics` of a fixed camera of the episode ({})",
                serials(source)
            ),
        ));
    }
    let note = format!("poses of {moved} external cameras refined by PointWorld (loss {loss})");
    source.calibration_note = match source.calibration_note.as_str() {
        "" => note,
        own => format!("{own}; {note}"),
    };
    Ok(())
}

/// The other camera that a refined pose fits, where it does not fit its own.
fn stands_at(measured: &[Option<RigidPose>], own: usize, refined: &RigidPose) -> Option<usize> {
    let fits = |pose: &Option<RigidPose>| pose.as_ref().is_some_and(|pose| near(refined, pose));
    if measured[own].is_none() || fits(&measured[own]) {
        return None;
    }
    measured.iter().position(fits)
}

/// Moves the right eye of a pair with its left eye.
fn follow(source: &mut Source, (left, right): (usize, usize), refined: RigidPose) -> StageResult<()> {
    use rogs_geometry::{Base, Camera, Pose};
    let (SourceMount::Fixed(old), SourceMount::Fixed(eye)) =
        (&source.cameras[left].mount, &source.cameras[right].mount)
    else {
        return Ok(());
    };
    let pose = |pose: &RigidPose| {
        Pose::<Base, Camera>::from_rigid(pose).map_err(|error| rogs_worker::StageError::bad_input(error.to_string()))
    };
    let (old, eye, new) = (pose(old)?, pose(eye)?, pose(&refined)?);
    let left_from_right: Pose<Camera, Camera> = old.inverse() * eye;
    source.cameras[right].mount = SourceMount::Fixed((new * left_from_right).to_rigid());
    Ok(())
}
