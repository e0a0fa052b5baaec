//! Caches of PointWorld (`docs/spec/data.md` section 3) as references of an episode that another layout reads: refined
//! camera poses, stereo depth, and tracks of scene points. An episode and its files share a uuid, cameras a serial.

mod cameras;
mod clips;
mod depth;
mod flows;
mod index;
mod tar;

use std::path::{Path, PathBuf};

use rogs_geometry::{Base, Camera, Pose};
use rogs_schemas::records::clip::CameraRole;
use rogs_schemas::{RigidPose, WrittenPose};
use rogs_worker::StageResult;

pub(crate) use self::depth::read_cached;
pub(crate) use self::index::refusal;
pub use self::index::{ReferenceFiles, list_references};
use crate::assemble;
use crate::fault::wrong;
use crate::params::Params;
use crate::source::{Source, SourceCamera, SourceMount};

/// Roles of the stage's inputs: refined cameras, depth, flows.
pub(crate) const ROLES: [&str; 3] = ["pointworld-cameras", "pointworld-depth", "pointworld-flows"];

/// Names of a file of each role, after the uuid.
const ENDINGS: [&[&str]; 3] = [&["_cameras.json"], &["_depth.h5"], &["_flows.h5"]];

/// The files of an episode, by role.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PointWorldFiles {
    /// Refined cameras, JSON.
    pub cameras: Option<PathBuf>,
    /// Stereo depth, HDF5.
    pub depth: Option<PathBuf>,
    /// Tracks, HDF5 or a WebDataset shard (`.tar`).
    pub flows: Option<PathBuf>,
}

impl PointWorldFiles {
    /// The files that `input` has by role.
    pub(crate) fn by_role(input: impl Fn(&str) -> Option<PathBuf>) -> Self {
        let [cameras, depth, flows] = ROLES.map(input);
        Self { cameras, depth, flows }
    }

    fn any(&self) -> bool {
        self.cameras.is_some() || self.depth.is_some() || self.flows.is_some()
    }

    /// Adds what they know to an episode. The parameters that come back start the clip where it started without them.
    pub(crate) fn join(&self, source: &mut Source, params: &Params) -> StageResult<Params> {
        let mut params = params.clone();
        if !self.any() {
            return Ok(params);
        }
        if let Some(path) = &self.cameras {
            cameras::join(path, source, &params.pointworld)?;
        }
        if let Some(path) = &self.depth {
            depth::join(path, source, params.pointworld.tolerance_ms)?;
        }
        if let Some(path) = &self.flows {
            // Tracks of an own episode say where a clip starts; these lie everywhere in the episode.
            let interval = assemble::interval(source, &params)?;
            params.start_frame = Some(interval.start);
            flows::join(path, source, interval, &params.pointworld)?;
        }
        Ok(params)
    }
}

/// The role of a file of a cache, and the uuid that it belongs to; `None` for other files.
pub(crate) fn role_of(name: &str) -> Option<(&'static str, &str)> {
    let ends = |endings: &&[&str]| endings.iter().find_map(|ending| name.strip_suffix(ending));
    let found = ROLES
        .into_iter()
        .zip(&ENDINGS)
        .find_map(|(role, endings)| Some((role, ends(endings)?)));
    found.filter(|(_, uuid)| !uuid.is_empty() && !uuid.starts_with('.'))
}

/// Every uuid that a file names must be the episode's.
fn same_episode(found: &str, source: &Source, path: &Path) -> StageResult<()> {
    if found == source.episode_id {
        return Ok(());
    }
    Err(wrong(
        path,
        format!("it is of episode `{found}`, not of `{}`", source.episode_id),
    ))
}

/// The external input camera of a serial; where the layout knows no serials, cameras go by their names.
fn camera_of(source: &Source, serial: &str) -> Option<usize> {
    let named = |camera: &SourceCamera| camera.serial.as_deref().unwrap_or(&camera.id) == serial;
    source
        .cameras
        .iter()
        .position(|camera| camera.role == CameraRole::Source && named(camera))
}

/// Names of the cameras, for messages.
fn serials(source: &Source) -> String {
    let name = |camera: &SourceCamera| camera.serial.clone().unwrap_or_else(|| camera.id.clone());
    source.cameras.iter().map(name).collect::<Vec<_>>().join(", ")
}

/// Camera-to-base of a base-to-camera pose, as PointWorld keeps poses. `own` is what the episode says of the camera: a
/// matrix that fits it only the other way round is refused.
fn base_from_camera(written: &WrittenPose, what: &str, own: &SourceMount, path: &Path) -> StageResult<RigidPose> {
    let stored = crate::checks::rigid_pose(written, what, path)?;
    let inverted = inverse(&stored, what, path)?;
    if let SourceMount::Fixed(own) = own
        && !near(&inverted, own)
        && near(&stored, own)
    {
        let text =
            format!("{what} is camera-to-base: it fits the episode's camera only so, PointWorld keeps base-to-camera");
        return Err(wrong(path, text).with_hint("invert the matrix"));
    }
    Ok(inverted)
}

fn inverse(pose: &RigidPose, what: &str, path: &Path) -> StageResult<RigidPose> {
    let pose: Pose<Camera, Base> =
        Pose::from_rigid(pose).map_err(|error| wrong(path, format!("{what} is not rigid: {error}")))?;
    Ok(pose.inverse().to_rigid())
}

/// Whether a pose may be the refined one of a measured one.
fn near(refined: &RigidPose, measured: &RigidPose) -> bool {
    /// Refined poses stay this near to measured ones, metres and radians.
    const NEAR: (f64, f64) = (0.3, 0.5);
    let (metres, radians) = difference(refined, measured);
    metres < NEAR.0 && radians < NEAR.1
}

/// Distance of centres, metres, and angle between axes, radians.
fn difference(a: &RigidPose, b: &RigidPose) -> (f64, f64) {
    let metres = (0..3)
        .map(|axis| (a.translation[axis] - b.translation[axis]).powi(2))
        .sum::<f64>()
        .sqrt();
    // Trace of the relative rotation.
    let trace: f64 = a.rotation.iter().zip(&b.rotation).map(|(a, b)| a * b).sum();
    (metres, ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos())
}

/// For every wanted time the entry of `times` that is nearest, when it is near enough.
fn nearest(times: &[f64], wanted: &[f64], tolerance: f64) -> Vec<Option<usize>> {
    let find = |&time: &f64| {
        let after = times.partition_point(|&other| other < time);
        let candidates = [after.checked_sub(1), Some(after)]
            .into_iter()
            .flatten()
            .filter(|&at| at < times.len());
        let best = candidates.min_by(|&a, &b| (times[a] - time).abs().total_cmp(&(times[b] - time).abs()));
        best.filter(|&at| (times[at] - time).abs() <= tolerance)
    };
    wanted.iter().map(find).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_told_by_their_names() {
        assert_eq!(role_of("LAB+a+2023_depth.h5"), Some(("pointworld-depth", "LAB+a+2023")));
        assert_eq!(role_of("x_cameras.json"), Some(("pointworld-cameras", "x")));
        assert_eq!(role_of("x_flows.h5"), Some(("pointworld-flows", "x")));
        for other in ["x.h5", "_depth.h5", "._x_depth.h5", "expert_confidence-seed=42.h5"] {
            assert_eq!(role_of(other), None, "{other}");
        }
    }

    #[test]
    fn the_nearest_time_counts_when_it_is_near_enough() {
        let times = [0.0, 66.0, 133.0];
        assert_eq!(
            nearest(&times, &[1.0, 50.0, 100.0, 150.0, 400.0], 20.0),
            [Some(0), Some(1), None, Some(2), None]
        );
        assert_eq!(nearest(&[], &[1.0], 20.0), [None]);
    }
}
