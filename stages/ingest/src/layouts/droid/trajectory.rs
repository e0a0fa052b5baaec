//! `trajectory.h5` of a raw DROID episode: one row a step (`docs/spec/data.md` section 2.1).

use std::path::Path;

use rogs_arrays::{ANY, Hdf5Dataset, Hdf5File};
use rogs_geometry::{Base, Link, Pose};
use rogs_worker::StageResult;

use super::panda;
use crate::fault::{unreadable, wrong};

/// Most steps of an episode.
const MAX_STEPS: usize = 1 << 20;

/// An open trajectory with the states of the robot.
pub(super) struct Trajectory {
    file: Hdf5File,
    /// Rows.
    pub(super) steps: usize,
    /// `[T]`
    pub(super) joints: Vec<[f64; panda::JOINTS]>,
    /// `[T]`
    pub(super) gripper: Vec<f64>,
    /// Logged pose of the flange; `None` when it was never filled in. `[T]`
    pub(super) flange: Option<Vec<Pose<Base, Link>>>,
    /// When the state was read, milliseconds. `[T]`
    pub(super) state_ms: Option<Vec<f64>>,
    /// Steps in which nobody moved the robot. `[T]`
    pub(super) idle: Vec<bool>,
}

/// What the trajectory says about one camera.
#[derive(Debug, Default)]
pub(super) struct CameraLog {
    /// 0 for the wrist camera, another number for an external one.
    pub(super) kind: Option<i64>,
    /// When each image was taken, milliseconds. `[T]`
    pub(super) capture_ms: Option<Vec<f64>>,
    /// Camera to base of the left eye at every step; `None` when it was never filled in. `[T]`
    pub(super) left: Option<Vec<[f64; 6]>>,
    /// The same of the right eye.
    pub(super) right: Option<Vec<[f64; 6]>>,
    /// Camera to flange of the left eye of the wrist camera.
    pub(super) gripper_offset: Option<[f64; 6]>,
    /// fx, fy, cx, cy of the left eye with integer pixel centres.
    pub(super) left_lens: Option<[f64; 4]>,
    /// There are intrinsics, and they are all zeros.
    pub(super) zero_lens: bool,
}

impl Trajectory {
    /// Opens a file and reads the states.
    pub(super) fn open(path: &Path) -> StageResult<Self> {
        let file = Hdf5File::open(path).map_err(|error| {
            unreadable(error).with_hint("fetch the file again: its size in the release is that of a whole one")
        })?;
        let joints = {
            let dataset = file
                .need("observation/robot_state/joint_positions")
                .map_err(unreadable)?;
            dataset.expect_shape(&[ANY, panda::JOINTS]).map_err(unreadable)?;
            let values = dataset.read::<f64>().map_err(unreadable)?;
            values.as_chunks::<{ panda::JOINTS }>().0.to_vec()
        };
        let steps = joints.len();
        if !(1..=MAX_STEPS).contains(&steps) {
            return Err(wrong(path, format!("a trajectory of {steps} steps is impossible")));
        }
        let gripper = column(&file, "observation/robot_state/gripper_position", steps)?;
        let gripper = gripper.ok_or_else(|| wrong(path, "it has no `observation/robot_state/gripper_position`"))?;
        let flange = sixes(&file, "observation/robot_state/cartesian_position", steps)?;
        let pose = |[x, y, z, a, b, c]: &[f64; 6]| Pose::from_xyz_euler([*x, *y, *z], [*a, *b, *c]);
        let state_ms = state_times(&file, steps)?;
        let idle = idle_steps(&file, steps)?;
        Ok(Self {
            steps,
            joints,
            gripper,
            flange: flange.map(|sixes| sixes.iter().map(pose).collect()),
            state_ms,
            idle,
            file,
        })
    }

    /// Where it lies.
    pub(super) fn path(&self) -> &Path {
        self.file.path()
    }

    /// What it says about a camera.
    pub(super) fn camera(&self, serial: &str) -> StageResult<CameraLog> {
        let (file, steps) = (&self.file, self.steps);
        let pose = |name: &str| sixes(file, &format!("observation/camera_extrinsics/{serial}_{name}"), steps);
        let offset = pose("left_gripper_offset")?;
        let lens = lens(file, &format!("observation/camera_intrinsics/{serial}_left"), steps)?;
        let mut capture_ms = None;
        for key in ["estimated_capture", "frame_received", "read_end", "read_start"] {
            capture_ms = times(file, &format!("observation/timestamp/cameras/{serial}_{key}"), steps)?;
            if capture_ms.is_some() {
                break;
            }
        }
        let kind = column(file, &format!("observation/camera_type/{serial}"), steps)?;
        Ok(CameraLog {
            kind: kind.and_then(|kinds| Some(*kinds.first()? as i64)),
            capture_ms,
            left: pose("left")?,
            right: pose("right")?,
            gripper_offset: offset.and_then(|offsets| offsets.first().copied()),
            left_lens: lens.filter(|lens| lens.iter().any(|&number| number != 0.0)),
            zero_lens: lens.is_some_and(|lens| lens.iter().all(|&number| number == 0.0)),
        })
    }
}

/// The values of a column with one number a step, or the same number for all of them; `None` when there is none.
fn column(file: &Hdf5File, name: &str, steps: usize) -> StageResult<Option<Vec<f64>>> {
    let Some(dataset) = file.dataset(name).map_err(unreadable)? else {
        return Ok(None);
    };
    let values = dataset.read::<f64>().map_err(unreadable)?;
    match (dataset.shape(), &values[..]) {
        ([], [single]) => Ok(Some(vec![*single; steps])),
        ([rows] | [rows, 1], _) if *rows == steps => Ok(Some(values)),
        _ => Err(rows_differ(file, &dataset, steps)),
    }
}

/// The same for times in milliseconds; those that were never filled in count as missing.
fn times(file: &Hdf5File, name: &str, steps: usize) -> StageResult<Option<Vec<f64>>> {
    let values = column(file, name, steps)?;
    Ok(values.filter(|times| times.iter().all(|time| time.is_finite()) && times.iter().any(|&time| time != 0.0)))
}

/// The middle of reading the robot's state.
fn state_times(file: &Hdf5File, steps: usize) -> StageResult<Option<Vec<f64>>> {
    let of = |key: &str| times(file, &format!("observation/timestamp/robot_state/{key}"), steps);
    Ok(match (of("read_start")?, of("read_end")?) {
        (Some(start), Some(end)) => Some(start.iter().zip(&end).map(|(a, b)| (a + b) / 2.0).collect()),
        (one, other) => one.or(other),
    })
}

/// Steps that loaders leave out: nobody moved the robot, or the action was skipped.
fn idle_steps(file: &Hdf5File, steps: usize) -> StageResult<Vec<bool>> {
    let moved = column(file, "observation/controller_info/movement_enabled", steps)?;
    let skipped = column(file, "observation/timestamp/skip_action", steps)?;
    let at = |column: &Option<Vec<f64>>, step: usize, usual: f64| column.as_ref().map_or(usual, |column| column[step]);
    Ok((0..steps)
        .map(|step| at(&moved, step, 1.0) == 0.0 || at(&skipped, step, 0.0) != 0.0)
        .collect())
}

/// 6-vectors, one a step or one for all; `None` when there are none, or all are zeros.
fn sixes(file: &Hdf5File, name: &str, steps: usize) -> StageResult<Option<Vec<[f64; 6]>>> {
    let Some(dataset) = file.dataset(name).map_err(unreadable)? else {
        return Ok(None);
    };
    let values = dataset.read::<f64>().map_err(unreadable)?;
    let rows = values.as_chunks::<6>().0.to_vec();
    let rows = match dataset.shape() {
        [6] => vec![rows[0]; steps],
        [count, 6] if *count == steps => rows,
        _ => return Err(rows_differ(file, &dataset, steps)),
    };
    if let Some(row) = rows.iter().position(|row| row.iter().any(|value| !value.is_finite())) {
        return Err(wrong(file.path(), format!("`{name}` is not finite at step {row}")));
    }
    Ok(Some(rows).filter(|rows| rows.iter().flatten().any(|&value| value != 0.0)))
}

/// fx, fy, cx, cy of a 3x3 matrix, one a step or one for all.
fn lens(file: &Hdf5File, name: &str, steps: usize) -> StageResult<Option<[f64; 4]>> {
    let Some(dataset) = file.dataset(name).map_err(unreadable)? else {
        return Ok(None);
    };
    let matrix: Vec<f64> = match dataset.shape() {
        [3, 3] => dataset.read().map_err(unreadable)?,
        [count, 3, 3] if *count == steps => dataset.read_rows(0..1).map_err(unreadable)?,
        _ => return Err(rows_differ(file, &dataset, steps)),
    };
    match matrix[..] {
        [fx, skew, cx, below, fy, cy, ..] if skew == 0.0 && below == 0.0 => Ok(Some([fx, fy, cx, cy])),
        _ => Err(wrong(file.path(), format!("`{name}` has more than fx, fy, cx, cy"))),
    }
}

fn rows_differ(file: &Hdf5File, dataset: &Hdf5Dataset<'_>, steps: usize) -> rogs_worker::StageError {
    let text = format!(
        "`{}` has the shape {:?}, the trajectory has {steps} steps",
        dataset.name(),
        dataset.shape()
    );
    wrong(file.path(), text)
}
