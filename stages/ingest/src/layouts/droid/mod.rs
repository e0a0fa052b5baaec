//! Raw DROID episodes (`docs/spec/data.md` section 2.1): `metadata_UUID.json`, `trajectory.h5` and
//! `recordings/MP4/SERIAL.mp4` (left eye) and `SERIAL-stereo.mp4` (both), in trees `LAB/{success,failure}/DATE/TIME/`.

mod cameras;
mod clock;
mod eyes;
mod lenses;
mod metadata;
mod mounts;
mod panda;
mod published;
mod refused;
mod trajectory;
mod tree;
mod zed;

use std::path::Path;

use rogs_geometry::{Base, Link, Pose};
use rogs_worker::{StageError, StageResult};

pub use self::published::look_up_published;
pub(crate) use self::refused::refusal;
pub(crate) use self::tree::{episodes, is_episode};

use self::cameras::{Builder, Found};
use self::clock::{CameraTime, Clock};
use self::metadata::{CAMERAS, Metadata};
use self::published::{Calibrations, Published};
use self::trajectory::Trajectory;
use self::tree::RELEASE;
use crate::checks;
use crate::fault::wrong;
use crate::params::Params;
use crate::source::{Source, States};

/// Name of the layout, as the clip keeps it.
pub(crate) const LAYOUT: &str = "droid-raw";
/// The gripper may be this far outside [0, 1]: its width is measured.
const GRIPPER_TOLERANCE: f64 = 0.02;
/// Joints and logged flange agree within this, millimetres; DROID's own agree to 3e-5.
const FLANGE_TOLERANCE: f64 = 1.0;

/// Opens an episode; `calibration` is a file of ours or a folder of published ones.
pub(crate) fn open(root: &Path, calibration: Option<&Path>, params: &Params) -> StageResult<Source> {
    let calibrations = Calibrations::open(calibration)?;
    let published = calibrations.published.as_ref();
    let (metadata, uuid) = identify(root, published)?;
    let path = root.join(tree::TRAJECTORY);
    if !path.is_file() {
        return Err(wrong(&path, "this raw DROID episode has no joint states").with_hint(RELEASE));
    }
    let mut trajectory = Trajectory::open(&path)?;
    let mut warnings = Vec::new();
    if let Some(published) = published {
        let own = root.canonicalize().ok().and_then(|root| tree::place(&root));
        let place = own.or_else(|| tree::place_within(metadata.hdf5_path.as_deref()?));
        if let Some(kept) = published.kept(place.as_deref())? {
            for (step, idle) in trajectory.idle.iter_mut().enumerate() {
                *idle |= !kept.iter().any(|[start, end]| (start..end).contains(&&step));
            }
        }
    }
    if let Some(length) = metadata
        .trajectory_length
        .filter(|&length| length != trajectory.steps as u64)
    {
        warnings.push(format!(
            "the metadata announces {length} steps, `{}` has {}",
            path.display(),
            trajectory.steps
        ));
    }
    let serials = serials(&metadata, &uuid, published, &trajectory, &mut warnings)?;
    let flanges = flanges(&trajectory, &mut warnings);
    let found = cameras::find_cameras(root, &serials, &trajectory, &mut warnings)?;
    let clock = match_clocks(&found, &trajectory, params, &mut warnings)?;
    let mut notes = Vec::new();
    let mut built = Builder {
        uuid: &uuid,
        path: &path,
        metadata: &metadata,
        calibrations: &calibrations,
        flanges: &flanges.poses,
        params: &params.droid,
        notes: &mut notes,
        warnings: &mut warnings,
    };
    built.check_serials(&found)?;
    let (mut cameras, mut rights) = (Vec::new(), Vec::new());
    for (camera, frames) in found.into_iter().zip(clock.frames) {
        if let Some((left, right)) = built.camera(camera, frames)? {
            cameras.push(left);
            rights.extend(right);
        }
    }
    if cameras.is_empty() {
        return Err(wrong(&path, "no camera of the episode has both images and a pose")
            .with_hint("docs/droid.md says which calibrations were published, and how to give them"));
    }
    cameras.extend(rights);
    notes.push(flanges.note);
    notes.push(clock.note);
    notes.retain(|note| !note.is_empty());
    let states = states(&trajectory, &clock.states, params, &mut warnings)?;
    let task = metadata.current_task.filter(|task| !task.trim().is_empty());
    let task = match (task, published) {
        (Some(task), _) => task,
        (None, Some(published)) => published.task(&uuid)?.unwrap_or_default(),
        (None, None) => String::new(),
    };
    Ok(Source {
        episode_id: uuid,
        layout: LAYOUT,
        task,
        calibration_note: notes.join("; "),
        fps: clock.fps,
        frame_count: states.gripper.len() as u32,
        cameras,
        states,
        tracks: None,
        cameras_chosen: false,
        warnings,
    })
}

/// Frames of an episode as its metadata say; idle steps that are left out shorten it.
pub(crate) fn frames(root: &Path) -> Option<u64> {
    metadata::read(root).ok()??.trajectory_length
}

/// Metadata and uuid of an episode; without metadata, by its place in the published table.
fn identify(root: &Path, published: Option<&Published>) -> StageResult<(Metadata, String)> {
    let metadata = metadata::read(root)?;
    let by_place = match (&metadata, published) {
        (None, Some(published)) => published.uuid_of(root)?,
        _ => None,
    };
    let metadata = metadata.unwrap_or_default();
    let Some(uuid) = metadata.uuid.clone().or(by_place) else {
        return Err(wrong(
            root,
            "this raw DROID episode has no `metadata_*.json`: serials and poses of its cameras are unknown",
        )
        .with_hint(format!(
            "{RELEASE}; or give the published `episode_id_to_path.json`, `camera_serials.json` and extrinsics as \
                 calibration folder (docs/droid.md)"
        )));
    };
    Ok((metadata, checks::episode_id(&uuid, root)?))
}

/// Serials of wrist, ext1 and ext2.
fn serials(
    metadata: &Metadata,
    uuid: &str,
    published: Option<&Published>,
    trajectory: &Trajectory,
    warnings: &mut Vec<String>,
) -> StageResult<[Option<String>; 3]> {
    let own = [
        &metadata.wrist_cam_serial,
        &metadata.ext1_cam_serial,
        &metadata.ext2_cam_serial,
    ];
    let own = own.map(|serial| serial.as_ref().and_then(metadata::Serial::text));
    let later = match published {
        Some(published) => published.serials(uuid)?.unwrap_or_default(),
        None => Default::default(),
    };
    let mut serials = own.clone();
    for ((id, serial), later) in CAMERAS.into_iter().zip(&mut serials).zip(later) {
        match (serial.as_deref(), later) {
            (None, later) => *serial = later,
            (Some(own), Some(later)) if own != later => warnings.push(format!(
                "the serial of camera `{id}` is {own} in the metadata and {later} in the published table: the metadata's is taken"
            )),
            _ => {}
        }
    }
    for (id, serial) in CAMERAS.into_iter().zip(&serials) {
        let Some(serial) = serial else { continue };
        let kind = trajectory.camera(serial)?.kind;
        if kind.is_some_and(|kind| (kind == 0) != (id == "wrist")) {
            let text = format!(
                "camera `{id}` has the serial {serial}, which is {} in `{}`: the serials are swapped",
                if kind == Some(0) {
                    "the wrist camera"
                } else {
                    "an external camera"
                },
                trajectory.path().display()
            );
            return Err(StageError::bad_input(text).with_hint("correct the serials in the metadata"));
        }
    }
    if let [_, Some(ext1), Some(ext2)] = &serials
        && ext1 > ext2
    {
        warnings.push(format!(
            "ext1 ({ext1}) and ext2 ({ext2}) are not in the order of their serials, as DROID has them: are they swapped?"
        ));
    }
    Ok(serials)
}

/// Flange poses and how well they agree with the joints.
struct Flanges {
    poses: Vec<Pose<Base, Link>>,
    note: String,
}

/// The logged poses of the flange, checked against the joints; by kinematics where there are none or they do not fit.
fn flanges(trajectory: &Trajectory, warnings: &mut Vec<String>) -> Flanges {
    let by_joints: Vec<_> = trajectory.joints.iter().map(panda::base_from_flange).collect();
    let Some(logged) = &trajectory.flange else {
        warnings.push(format!(
            "`{}` has no pose of the flange (`cartesian_position`): it follows from the joints",
            trajectory.path().display()
        ));
        return Flanges {
            poses: by_joints,
            note: String::new(),
        };
    };
    let off = |(a, b): (&Pose<Base, Link>, &Pose<Base, Link>)| 1000.0 * (a.translation - b.translation).length();
    let most = logged.iter().zip(&by_joints).map(off).fold(0.0, f64::max);
    let note = format!("logged flange and joints agree to {most:.5} mm");
    if most > FLANGE_TOLERANCE {
        warnings.push(format!(
            "`{}`: the logged pose of the flange and the joints differ by up to {most:.1} mm: the joints are taken",
            trajectory.path().display()
        ));
        return Flanges {
            poses: by_joints,
            note: format!("logged flange and joints differ by up to {most:.1} mm"),
        };
    }
    Flanges {
        poses: logged.clone(),
        note,
    }
}

/// Matches frames of videos and rows of the trajectory.
fn match_clocks(
    found: &[Found],
    trajectory: &Trajectory,
    params: &Params,
    warnings: &mut Vec<String>,
) -> StageResult<Clock> {
    let steps = trajectory.steps;
    let mut times = Vec::new();
    for camera in found {
        let frames = camera.eyes.frames as usize;
        if frames.abs_diff(steps) > 1 {
            let text =
                format!("it has {frames} frames, the trajectory {steps} steps: which image is which step is unknown");
            return Err(wrong(&camera.eyes.left.path, text)
                .with_hint("both are of one recording in the raw release; rows of idle steps must not be cut out"));
        }
        if frames != steps {
            warnings.push(format!(
                "camera `{}` ({}) has {frames} images for {steps} steps: the last {} is not used",
                camera.id,
                camera.serial,
                if frames < steps { "step" } else { "image" }
            ));
        }
        times.push(CameraTime {
            id: camera.id,
            frames: frames.min(steps),
            header_fps: camera.eyes.left.info.fps,
            capture_ms: camera.log.capture_ms.as_deref(),
        });
    }
    let state_ms = trajectory.state_ms.as_deref();
    let mut clock = clock::matched(&times, state_ms, &trajectory.idle, params.droid.idle, trajectory.path())?;
    warnings.append(&mut clock.warnings);
    Ok(clock)
}

/// Joints and gripper at every frame.
fn states(trajectory: &Trajectory, rows: &[usize], params: &Params, warnings: &mut Vec<String>) -> StageResult<States> {
    let path = trajectory.path();
    let columns = &params.states;
    if !columns.joints.is_empty() || columns.gripper.is_some() {
        return Err(
            StageError::bad_params("raw DROID episodes name their states themselves")
                .with_hint("leave `joints` and `gripper` out of [ingest.states]"),
        );
    }
    let names = match columns.joint_names.len() {
        0 => (1..=panda::JOINTS).map(|joint| format!("panda_joint{joint}")).collect(),
        panda::JOINTS => columns.joint_names.clone(),
        count => {
            return Err(StageError::bad_params(format!(
                "`joint_names` has {count} names, the arm {} joints",
                panda::JOINTS
            )));
        }
    };
    let mut states = States {
        joint_names: names,
        positions: rows.iter().flat_map(|&row| trajectory.joints[row]).collect(),
        gripper: rows.iter().map(|&row| trajectory.gripper[row]).collect(),
    };
    columns.convert(&mut states);
    let mut outside = 0;
    for value in &mut states.gripper {
        if (-GRIPPER_TOLERANCE..=1.0 + GRIPPER_TOLERANCE).contains(value) {
            outside += usize::from(!(-1e-6..=1.0 + 1e-6).contains(value));
            *value = value.clamp(0.0, 1.0);
        }
    }
    if outside > 0 {
        warnings.push(format!(
            "the gripper is up to {GRIPPER_TOLERANCE} outside 0 to 1 at {outside} of {} frames: set to the nearest end",
            rows.len()
        ));
    }
    checks::states(&states, "frame", path)?;
    Ok(states)
}
