//! Checks of values from outside. Each failure is one sentence with file and row.

use std::collections::BTreeMap;
use std::path::Path;

use rogs_geometry::{Base, Camera, Pose};
use rogs_schemas::{Intrinsics, RigidPose, WrittenPose};
use rogs_worker::{StageError, StageResult};

use crate::fault::wrong;
use crate::source::States;

/// A rigid pose in any form that poses are written in; rotations printed with few digits are made orthonormal.
pub(crate) fn rigid_pose(written: &WrittenPose, what: &str, path: &Path) -> StageResult<RigidPose> {
    /// No camera of a table-top robot is further away, metres.
    const FAR: f64 = 20.0;
    /// What a camera 1 to 5 m away has in centimetres, and one 0.1 to 0.5 m away in millimetres.
    const EITHER: std::ops::Range<f64> = 100.0..500.0;
    let empty = match written {
        WrittenPose::Matrix(rows) => rows[..3].iter().flatten().all(|&entry| entry == 0.0),
        WrittenPose::Euler(six) => six.iter().all(|&entry| entry == 0.0),
        WrittenPose::Quaternion(_, xyzw) => xyzw.iter().all(|&entry| entry == 0.0),
    };
    if empty {
        return Err(wrong(path, format!("{what} is all zeros: it was never filled in"))
            .with_hint("give a calibration file with the camera's pose, see docs/calibration-format.md"));
    }
    let pose: Pose<Base, Camera> =
        Pose::from_written(written).map_err(|error| wrong(path, format!("{what} is not rigid: {error}")))?;
    if let WrittenPose::Euler([_, _, _, angles @ ..]) = written
        && angles
            .iter()
            .any(|angle| angle.abs() > 2.0 * std::f64::consts::PI + 1e-3)
    {
        return Err(wrong(path, format!("{what} has the angles {angles:?}"))
            .with_hint("roll, pitch and yaw are radians; were these degrees?"));
    }
    let distance = pose.translation.length();
    if distance > FAR {
        let unit = match distance {
            _ if EITHER.contains(&distance) => "millimetres or centimetres",
            _ if distance < EITHER.start => "centimetres",
            _ => "millimetres",
        };
        return Err(wrong(path, format!("{what} has a translation of {distance:.1} m"))
            .with_hint(format!("translations are metres; were these {unit}?")));
    }
    Ok(pose.to_rigid())
}

/// A rigid pose from `x, y, z` (metres) and the Euler angles of the DROID logs (radians).
pub(crate) fn euler_pose(values: &[f64; 6], what: &str, path: &Path) -> StageResult<RigidPose> {
    rigid_pose(&WrittenPose::Euler(*values), what, path)
}

/// Intrinsics that a camera with images of this size can have.
pub(crate) fn intrinsics(intrinsics: Intrinsics, size: (u32, u32), what: &str, path: &Path) -> StageResult<Intrinsics> {
    let Intrinsics { fx, fy, cx, cy } = intrinsics;
    if ![fx, fy, cx, cy].iter().all(|value| value.is_finite()) {
        return Err(wrong(
            path,
            format!("the intrinsics of {what} are not finite: fx {fx} fy {fy} cx {cx} cy {cy}"),
        ));
    }
    if fx <= 0.0 || fy <= 0.0 {
        return Err(wrong(
            path,
            format!("the focal lengths of {what} are {fx} and {fy}, they must be above 0"),
        ));
    }
    let (width, height) = (f64::from(size.0), f64::from(size.1));
    if !(0.0..=width).contains(&cx) || !(0.0..=height).contains(&cy) {
        let text = format!("the principal point ({cx}, {cy}) of {what} lies outside its {width}x{height} image");
        return Err(wrong(path, text).with_hint("intrinsics must belong to the recorded image size"));
    }
    Ok(intrinsics)
}

/// Finite joints and a gripper in [0, 1] with a tolerance of 1e-6; `row_name` is what a row is called in the file.
pub(crate) fn states(states: &States, row_name: &str, path: &Path) -> StageResult<()> {
    /// No revolute joint turns this far, radians; degrees do.
    const DEGREES: f64 = 4.0 * std::f64::consts::PI;
    let joints = states.joint_names.len();
    if joints == 0 {
        return Err(wrong(path, "there are no joints"));
    }
    for (row, values) in states.positions.chunks_exact(joints).enumerate() {
        for (name, &value) in states.joint_names.iter().zip(values) {
            if !value.is_finite() {
                return Err(wrong(path, format!("joint `{name}` is {value} at {row_name} {row}")));
            }
            if value.abs() > DEGREES {
                let text = format!("joint `{name}` is {value} at {row_name} {row}");
                return Err(wrong(path, text).with_hint(
                    "joint positions are radians; were these degrees? `ingest.states.unit = \"degrees\"` in the manifest converts \
                     them, `ingest.states.gripper_range = [100, 0]` a gripper in percent (entry `gripper.pos` of SO-100 and \
                     SO-101)",
                ));
            }
        }
    }
    for (row, &value) in states.gripper.iter().enumerate() {
        if !(-1e-6..=1.0 + 1e-6).contains(&value) {
            let text = format!("the gripper is {value} at {row_name} {row}, it must be in 0 (open) to 1 (closed)");
            return Err(wrong(path, text).with_hint(
                "under [ingest.states] of the manifest, gripper_range = [OPEN, CLOSED] says which values of the data mean \
                 open and closed, e.g. [100, 0] for percent of opening",
            ));
        }
    }
    Ok(())
}

/// What is odd about intrinsics of images of this size, though a camera may have them.
pub(crate) fn odd_intrinsics(Intrinsics { fx, cx, cy, .. }: Intrinsics, size: (u32, u32)) -> Option<String> {
    /// The principal point of a lens lies near the middle; by this share of half the image it may be off.
    const OFF: f64 = 0.3;
    let middle = (f64::from(size.0) / 2.0, f64::from(size.1) / 2.0);
    if cx <= 1.5 && cy <= 1.5 && fx < 4.0 && middle.0 > 4.0 {
        return Some("its intrinsics are a few pixels: were they divided by the image's size?".to_owned());
    }
    let off = (cx / middle.0 - 1.0).abs().max((cy / middle.1 - 1.0).abs());
    (off > OFF).then(|| {
        format!(
            "its principal point ({cx:.1}, {cy:.1}) lies far from the middle of its {}x{} images: do its intrinsics belong \
             to images of another size?",
            size.0, size.1
        )
    })
}

/// What is odd about states that are possible: values of another unit that stay within bounds.
pub(crate) fn odd_states(states: &States, gripper_range_is_said: bool) -> Vec<String> {
    /// Widest gap of a gripper's fingers in metres.
    const WIDEST_M: f64 = 0.11;
    /// Half a turn, converted to radians twice.
    const HALF_A_TURN: f64 = std::f64::consts::PI * std::f64::consts::PI / 180.0;
    /// Fewer joints may stand at 0.
    const MANY: usize = 4;
    let mut odd = Vec::new();
    let range = |values: &[f64]| {
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        (least, values.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    };
    let (least, most) = range(&states.gripper);
    if !gripper_range_is_said && least >= 0.0 && most <= WIDEST_M && most - least > 0.01 {
        odd.push(format!(
            "the gripper goes from {least:.3} to {most:.3}, of 0 (open) to 1 (closed): is it the gap of the fingers in \
             metres? `gripper_range = [{most:.2}, 0]` under [ingest.states]"
        ));
    }
    let (least, most) = range(&states.positions);
    let farthest = most.max(-least);
    if states.joint_names.len() >= MANY && (1e-4..HALF_A_TURN).contains(&farthest) {
        odd.push(format!(
            "no joint is further than {farthest:.4} rad from 0: were the positions converted from degrees twice?"
        ));
    }
    odd
}

/// Ascending times in seconds that step as the frame rate says; gaps warn, since frames are taken as even in time.
pub(crate) fn times(times: &[f64], fps: f64, path: &Path) -> StageResult<Option<String>> {
    /// The usual step may differ from the frame rate's by this share: recorders do not keep time exactly.
    const TOLERANCE: f64 = 0.1;
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let gap = steps.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
    let gap = gap.map(|(before, &step)| (before + 1, step));
    steps.sort_by(f64::total_cmp);
    let (Some(&usual), Some((row, longest))) = (steps.get(steps.len() / 2), gap) else {
        return Ok(None);
    };
    let expected = 1.0 / fps;
    let ratio = usual / expected;
    if (ratio - 1.0).abs() > TOLERANCE {
        let near = |factor: f64| (ratio / factor - 1.0).abs() <= TOLERANCE;
        let hint = match () {
            () if near(1e3) => "times are seconds; were these milliseconds?",
            () if near(1e6) => "times are seconds; were these microseconds?",
            () if near(1e9) => "times are seconds; were these nanoseconds?",
            () if (usual - 1.0).abs() < 1e-6 => "times are seconds; were these numbers of frames?",
            () if (usual / fps - 1.0).abs() <= TOLERANCE => {
                "`fps` is frames a second; was this the seconds of a frame?"
            }
            () => "correct `fps` or the times",
        };
        let text = format!("the times step by {usual}, but {fps} frames a second step by {expected:.4} s");
        return Err(wrong(path, text).with_hint(hint));
    }
    let gaps = steps.iter().filter(|&&step| step > 1.5 * expected).count();
    let places = if gaps == 1 {
        "1 place"
    } else {
        &format!("{gaps} places")
    };
    Ok((gaps > 0).then(|| {
        format!(
            "`{}`: frames are missing at {places}, the longest gap is {longest:.3} s before row {row}; the clip takes \
             frames as even in time",
            path.display()
        )
    }))
}

/// An episode id from a file: not empty, not absurdly long, no control characters.
pub(crate) fn episode_id(id: &str, path: &Path) -> StageResult<String> {
    if id.is_empty() || id.len() > 128 || id.chars().any(char::is_control) {
        return Err(wrong(
            path,
            format!("the episode id {id:?} must have 1 to 128 bytes and no control characters"),
        ));
    }
    Ok(id.to_owned())
}

/// Fails where two cameras have one name but for capitals: files that are named by camera would be one file on disks that
/// do not tell capitals.
pub(crate) fn names_apart<'a>(names: impl Iterator<Item = &'a str>) -> StageResult<()> {
    let mut taken: BTreeMap<String, &str> = BTreeMap::new();
    for name in names {
        if let Some(other) = taken.insert(name.to_lowercase(), name) {
            let text = format!("the cameras `{other}` and `{name}` differ in capitals alone");
            return Err(StageError::bad_input(text)
                .with_hint("rename one, or name them with `cameras` in [ingest]: files are named by camera"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_that_differ_in_capitals_alone_are_refused() {
        assert!(names_apart(["wrist", "top", "top_2"].into_iter()).is_ok());
        for pair in [["top", "Top"], ["ÜBER", "über"], ["a", "a"]] {
            let error = names_apart(pair.into_iter()).unwrap_err();
            assert!(error.message.contains("differ in capitals alone"), "{error}");
            assert!(pair.iter().all(|name| error.message.contains(name)), "{error}");
        }
    }

    #[test]
    fn poses_that_are_not_rigid_are_refused() {
        let path = Path::new("episode.json");
        let turned = [
            [0.0, -1.0, 0.0, 0.1],
            [1.0, 0.0, 0.0, 0.2],
            [0.0, 0.0, 1.0, 0.3],
            [0.0, 0.0, 0.0, 1.0],
        ];
        assert_eq!(
            rigid_pose(&WrittenPose::Matrix(turned), "pose", path)
                .unwrap()
                .translation,
            [0.1, 0.2, 0.3]
        );
        let change = |row: usize, column: usize, value: f64| {
            let mut matrix = turned;
            matrix[row][column] = value;
            rigid_pose(&WrittenPose::Matrix(matrix), "pose of `ext1`", path)
                .unwrap_err()
                .message
        };
        assert!(change(2, 2, -1.0).contains("reflection"));
        assert!(change(2, 2, 1.1).contains("not rigid"));
        assert!(change(3, 0, 0.1).contains("last row"));
        assert!(change(0, 3, f64::NAN).contains("not finite"));
        assert!(change(0, 3, 450.0).contains("450.0 m"));
        assert!(
            rigid_pose(&WrittenPose::Matrix([[0.0; 4]; 4]), "pose", path)
                .unwrap_err()
                .message
                .contains("all zeros")
        );
        assert!(
            euler_pose(&[0.0; 6], "pose", path)
                .unwrap_err()
                .message
                .contains("all zeros")
        );
    }

    #[test]
    fn poses_of_other_units_name_the_unit() {
        let path = Path::new("episode.json");
        let at = |metres: f64, unit: f64| {
            let pose = WrittenPose::Euler([metres * unit, 0.0, 0.0, 0.0, 0.0, 1.5]);
            rigid_pose(&pose, "pose", path).unwrap_err().hint.unwrap()
        };
        assert!(at(0.9, 1000.0).contains("millimetres?"));
        assert!(at(0.9, 100.0).contains("these centimetres?"));
        assert!(at(0.25, 1000.0).contains("millimetres or centimetres"));
        let degrees = WrittenPose::Euler([0.4, 0.0, 0.5, 180.0, 0.0, 90.0]);
        let error = rigid_pose(&degrees, "pose of `ext1`", path).unwrap_err();
        assert!(error.message.contains("pose of `ext1`") && error.hint.unwrap().contains("degrees"));
        let turned = WrittenPose::Euler([0.4, 0.0, 0.5, -3.2, 0.0, 6.2]);
        assert!(rigid_pose(&turned, "pose", path).is_ok());
    }

    #[test]
    fn possible_numbers_of_another_unit_are_odd() {
        let size = (56, 42);
        let camera = |fx: f64, cx: f64, cy: f64| odd_intrinsics(Intrinsics { fx, fy: fx, cx, cy }, size);
        assert_eq!(camera(34.0, 27.9, 21.3), None);
        assert_eq!(camera(34.0, 33.0, 17.0), None);
        assert!(camera(17.0, 14.0, 10.6).unwrap().contains("another size"));
        assert!(camera(34.0, 27.9, 41.0).unwrap().contains("another size"));
        assert!(camera(0.6, 0.5, 0.5).unwrap().contains("divided by the image's size"));
        let states = |scale: f64, gripper: [f64; 2]| States {
            joint_names: ["a", "b", "c", "d"].map(str::to_owned).to_vec(),
            positions: [0.3, -1.2, 0.5, 2.0].map(|value: f64| value * scale).to_vec(),
            gripper: gripper.to_vec(),
        };
        let odd = |states: &States| odd_states(states, false);
        assert!(odd(&states(1.0, [0.0, 1.0])).is_empty());
        assert!(odd(&states(1.0, [0.0, 0.0])).is_empty(), "a gripper that does not move");
        assert!(odd(&states(0.0, [0.0, 1.0])).is_empty(), "a robot that stands at 0");
        let metres = states(1.0, [0.08, 0.01]);
        assert!(odd(&metres)[0].contains("gripper_range = [0.08, 0]"));
        assert!(odd_states(&metres, true).is_empty());
        assert!(odd(&states(1f64.to_radians(), [0.0, 1.0]))[0].contains("degrees twice"));
    }

    #[test]
    fn states_name_the_row() {
        let good = States {
            joint_names: vec!["a".into(), "b".into()],
            positions: vec![0.0; 6],
            gripper: vec![0.0, 1.0, 0.5],
        };
        let path = Path::new("joints.csv");
        assert!(states(&good, "row", path).is_ok());
        let mut bad = good.clone();
        bad.positions[3] = f64::NAN;
        assert_eq!(
            states(&bad, "row", path).unwrap_err().message,
            "`joints.csv`: joint `b` is NaN at row 1"
        );
        let mut bad = good.clone();
        bad.positions[4] = 90.0;
        assert!(states(&bad, "row", path).unwrap_err().hint.unwrap().contains("degrees"));
        let mut bad = good;
        bad.gripper[2] = 1.00001;
        assert!(
            states(&bad, "row", path)
                .unwrap_err()
                .message
                .contains("gripper is 1.00001 at row 2")
        );
    }

    #[test]
    fn times_are_seconds_and_gaps_are_told() {
        let path = Path::new("joints.csv");
        let every = |step: f64| (0..20).map(|row| f64::from(row) * step).collect::<Vec<_>>();
        assert_eq!(times(&every(1.0 / 15.0), 15.0, path).unwrap(), None);
        assert_eq!(times(&[], 15.0, path).unwrap(), None);
        assert_eq!(times(&[3.0], 15.0, path).unwrap(), None);
        for (step, hint) in [
            (66.7, "milliseconds"),
            (66_667.0, "microseconds"),
            (66_666_667.0, "nanoseconds"),
            (0.1, "correct `fps`"),
            (1.0, "numbers of frames"),
        ] {
            let error = times(&every(step), 15.0, path).unwrap_err();
            assert!(error.message.contains("the times step by"), "{error}");
            assert!(error.hint.as_deref().unwrap().contains(hint), "{error:?}");
        }
        let error = times(&every(1.0 / 15.0), 1.0 / 15.0, path).unwrap_err();
        assert!(error.hint.unwrap().contains("the seconds of a frame"));
        let mut gap = every(1.0 / 15.0);
        gap.remove(7);
        let told = times(&gap, 15.0, path).unwrap().unwrap();
        assert!(
            told.contains("1 place, the longest gap is 0.133 s before row 7"),
            "{told}"
        );
    }
}
