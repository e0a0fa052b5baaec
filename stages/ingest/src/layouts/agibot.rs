//! AgiBot samples as Genie Envisioner keeps them (`docs/spec/data.md` section 7): PNG frames of a head camera and of one
//! camera a hand, `intrinsic_VIEW.npy`, a camera-to-base pose a step in `extrinsic_VIEW.npy`, and `actions.npy` with the
//! poses of both hands. There are no joints of the arms: each hand is a body that floats, with six joints of its own.

use std::f64::consts::TAU;
use std::path::Path;

use glam::{DQuat, DVec3, EulerRot};
use rogs_arrays::{ANY, NpyFile, Png};
use rogs_schemas::records::clip::CameraRole;
use rogs_schemas::{Intrinsics, RigidPose, WrittenPose};
use rogs_worker::{StageError, StageResult};

use crate::calibration::Calibration;
use crate::checks;
use crate::fault::{io_error, unreadable, wrong};
use crate::images::FrameSource;
use crate::params::StateColumns;
use crate::source::{Source, SourceCamera, SourceMount, States};

/// Name of the layout, as the clip keeps it.
pub(crate) const LAYOUT: &str = "agibot";
const ACTIONS: &str = "actions.npy";
/// Views in the order of a clip.
const VIEWS: [&str; 3] = ["hand_left", "hand_right", "head"];
const HANDS: [&str; 2] = ["left", "right"];
/// Numbers of `actions.npy` a step and hand: xyz, quaternion xyzw, gripper.
const PER_HAND: usize = 8;
/// Joints that stand for a hand: `R = Rz(yaw) Ry(pitch) Rx(roll)`, metres and radians; then its gripper, 0 to 1.
const JOINTS: [&str; 7] = ["x", "y", "z", "yaw", "pitch", "roll", "gripper"];
/// Gripper values that mean open and closed, as the images of the samples show; values lie up to 4 % beyond.
const GRIPPER: [f64; 2] = [35.0, 120.0];
const BEYOND: f64 = 0.05;
/// Frames per second of AgiBot's recordings; the samples do not say.
const FPS: f64 = 30.0;
/// A camera further from its hand is not on it, metres; the samples have 0.07 to 0.09.
const REACH: f64 = 0.35;
/// Most steps of a sample.
const MAX_STEPS: usize = 1 << 20;
/// Where camera parameters come from.
const WAY: &str = "take the sample with its camera parameters (Genie Envisioner's samples have `intrinsic_VIEW.npy` and \
                   `extrinsic_VIEW.npy`), or give a calibration file (docs/calibration-format.md)";

/// Whether a folder is a sample.
pub(crate) fn is_sample(root: &Path) -> bool {
    root.join(ACTIONS).is_file() && VIEWS.iter().any(|view| images(root, view).is_dir())
}

fn images(root: &Path, view: &str) -> std::path::PathBuf {
    root.join(format!("{view}_color"))
}

/// Frames of a sample, for the list.
pub(crate) fn frames(root: &Path) -> Option<u64> {
    let view = VIEWS.iter().find(|view| images(root, view).is_dir())?;
    count(&images(root, view)).ok().map(u64::from)
}

/// The error for AgiBot World as it was released, which is another form; `None` for all other folders.
pub(crate) fn refusal(root: &Path) -> Option<StageError> {
    let parts = ["observations", "proprio_stats"];
    parts.iter().all(|part| root.join(part).is_dir()).then(|| {
        StageError::bad_input(format!(
            "`{}` is AgiBot World as released, which is not read",
            root.display()
        ))
        .with_hint("convert its episodes to episode folders (docs/episode-format.md), poses from `parameters`")
    })
}

/// Opens a sample.
pub(crate) fn open(root: &Path, calibration: Option<&Calibration>, choice: &StateColumns) -> StageResult<Source> {
    let name = root.canonicalize().map_err(|error| io_error(root, &error))?;
    let name = name.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let path = root.join(ACTIONS);
    let (actions, steps) = actions(&path)?;
    let views: Vec<&str> = VIEWS.into_iter().filter(|view| images(root, view).is_dir()).collect();
    let mut warnings = Vec::new();
    for view in VIEWS.iter().filter(|view| !views.contains(view)) {
        warnings.push(format!(
            "camera `{view}` is left out: there is no folder `{view}_color`"
        ));
    }
    let mut counts = views.iter().map(|view| Ok((*view, count(&images(root, view))?)));
    let counts: Vec<(&str, u32)> = counts.by_ref().collect::<StageResult<_>>()?;
    let Some(&(first, frame_count)) = counts.first() else {
        return Err(wrong(root, "it has no folder of images, e.g. `head_color`"));
    };
    if let Some((view, other)) = counts.iter().find(|(_, count)| *count != frame_count) {
        let what = format!("`{first}_color` has {frame_count} images, `{view}_color` {other}");
        return Err(wrong(root, what));
    }
    if frame_count == 0 || frame_count as usize > steps {
        let what = format!("it has {steps} steps for {frame_count} images");
        return Err(wrong(&path, what).with_hint("every image `K.png` needs its step K"));
    }
    if (frame_count as usize) < steps {
        warnings.push(format!(
            "`{}` has {steps} steps for {frame_count} images: image K is taken with step K, which the sample does not say",
            path.display()
        ));
    }
    warnings.push(format!(
        "the sample does not say its frame rate: {FPS} frames per second are taken"
    ));
    let hands = hands(&actions, frame_count as usize, &path)?;
    let cameras = views
        .iter()
        .map(|view| camera(root, view, &hands, (frame_count, steps), calibration));
    let cameras = cameras.collect::<StageResult<_>>()?;
    let states = states(&hands, choice, &path, &mut warnings)?;
    Ok(Source {
        episode_id: checks::episode_id(&name, root)?,
        layout: LAYOUT,
        task: String::new(),
        calibration_note: calibration.map_or_else(
            || "published with the sample (intrinsic and extrinsic arrays)".to_owned(),
            Calibration::note,
        ),
        fps: FPS,
        frame_count,
        cameras,
        states,
        tracks: None,
        cameras_chosen: false,
        warnings,
    })
}

/// The numbers of the actions, and how many steps there are.
fn actions(path: &Path) -> StageResult<(Vec<f64>, usize)> {
    let mut array = NpyFile::open(path).map_err(unreadable)?;
    array.expect_shape(&[ANY, HANDS.len() * PER_HAND]).map_err(|error| {
        unreadable(error)
            .with_hint("expected a step a row: xyz, quaternion xyzw and gripper of the left and the right hand")
    })?;
    array.expect_floats().map_err(unreadable)?;
    let steps = array.shape()[0];
    if steps > MAX_STEPS {
        return Err(wrong(path, format!("{steps} steps are impossible")));
    }
    Ok((array.all().map_err(unreadable)?, steps))
}

/// One hand at one step.
#[derive(Debug, Clone, Copy)]
struct Hand {
    position: DVec3,
    rotation: DQuat,
    gripper: f64,
}

/// Both hands at every frame.
fn hands(actions: &[f64], frames: usize, path: &Path) -> StageResult<Vec<[Hand; 2]>> {
    let hand = |step: usize, index: usize, values: &[f64]| {
        let what = |text: &str| wrong(path, format!("the {} hand has {text} at step {step}", HANDS[index]));
        let [x, y, z, qx, qy, qz, qw, gripper] = *values else {
            return Err(what("other than eight numbers"));
        };
        if !values.iter().all(|value| value.is_finite()) {
            return Err(what("a number that is not finite"));
        }
        let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
        if (rotation.length() - 1.0).abs() > 0.01 {
            return Err(what(&format!("a quaternion of length {:.3}, not 1", rotation.length())));
        }
        Ok(Hand {
            position: DVec3::new(x, y, z),
            rotation: rotation.normalize(),
            gripper,
        })
    };
    let rows = actions.chunks_exact(HANDS.len() * PER_HAND).take(frames).enumerate();
    rows.map(|(step, row)| Ok([hand(step, 0, &row[..PER_HAND])?, hand(step, 1, &row[PER_HAND..])?]))
        .collect()
}

/// A camera with its images, lens and pose at every frame.
fn camera(
    root: &Path,
    view: &str,
    hands: &[[Hand; 2]],
    (frames, steps): (u32, usize),
    calibration: Option<&Calibration>,
) -> StageResult<SourceCamera> {
    let folder = images(root, view);
    let first = Png::open(&folder.join("0.png")).map_err(unreadable)?;
    let size = (first.width, first.height);
    let given = match calibration {
        Some(calibration) => calibration.camera(&[view], size)?,
        None => None,
    };
    let (own_lens, own_mount) = given.map_or((None, None), |given| (Some(given.intrinsics), given.mount));
    let missing =
        |path: &Path, what: &str| wrong(path, format!("the {what} of camera `{view}` is missing")).with_hint(WAY);
    let intrinsics = match own_lens {
        Some(lens) => lens,
        None => {
            let path = root.join(format!("intrinsic_{view}.npy"));
            if !path.is_file() {
                return Err(missing(&path, "calibration (intrinsics)"));
            }
            lens(&path, size, view)?
        }
    };
    let mount = match own_mount {
        Some(mount) => mount,
        None => {
            let path = root.join(format!("extrinsic_{view}.npy"));
            if !path.is_file() {
                return Err(missing(&path, "calibration (camera-to-base poses)"));
            }
            let poses = poses(&path, frames as usize, steps)?;
            if let Some(hand) = HANDS.iter().position(|hand| view == format!("hand_{hand}")) {
                check_direction(&path, view, &poses, hands.iter().map(|hands| hands[hand]))?;
            }
            SourceMount::Trajectory(poses)
        }
    };
    Ok(SourceCamera {
        id: view.to_owned(),
        serial: None,
        role: CameraRole::Source,
        partner: None,
        width: size.0,
        height: size.1,
        intrinsics,
        pixel_shift: 0.5,
        mount,
        images: Some(FrameSource::Numbered(folder)),
        times_ms: None,
        depth: None,
    })
}

/// A `.npy` file of floating-point numbers of this shape.
fn floats(path: &Path, shape: &[usize]) -> StageResult<Vec<f64>> {
    let mut array = NpyFile::open(path).map_err(unreadable)?;
    array.expect_shape(shape).map_err(unreadable)?;
    array.expect_floats().map_err(unreadable)?;
    array.all().map_err(unreadable)
}

/// Intrinsics for images of the given size; the file has integer pixel centres.
fn lens(path: &Path, size: (u32, u32), view: &str) -> StageResult<Intrinsics> {
    let matrix = floats(path, &[3, 3])?;
    let [fx, skew, cx, below, fy, cy, 0.0, 0.0, 1.0] = matrix[..] else {
        return Err(wrong(path, "its last row is not 0, 0, 1: no camera matrix"));
    };
    if skew != 0.0 || below != 0.0 {
        return Err(wrong(path, "it has more than fx, fy, cx, cy"));
    }
    let intrinsics = Intrinsics {
        fx,
        fy,
        cx: cx + 0.5,
        cy: cy + 0.5,
    };
    checks::intrinsics(intrinsics, size, &format!("camera `{view}`"), path)
}

/// Camera-to-base poses of the frames; the file has one for every step of the actions.
fn poses(path: &Path, frames: usize, steps: usize) -> StageResult<Vec<RigidPose>> {
    let matrices = floats(path, &[steps, 4, 4])?;
    let pose = |(step, matrix): (usize, &[f64; 16])| {
        let rows = std::array::from_fn(|row| std::array::from_fn(|column| matrix[4 * row + column]));
        checks::rigid_pose(&WrittenPose::Matrix(rows), &format!("the pose at step {step}"), path)
    };
    matrices
        .as_chunks::<16>()
        .0
        .iter()
        .enumerate()
        .take(frames)
        .map(pose)
        .collect()
}

/// A camera on a hand stays near it; one whose poses map base to camera does not.
fn check_direction(path: &Path, view: &str, poses: &[RigidPose], hands: impl Iterator<Item = Hand>) -> StageResult<()> {
    for (step, (pose, hand)) in poses.iter().zip(hands).enumerate() {
        let centre = DVec3::from_array(pose.translation);
        let off = centre.distance(hand.position);
        if off <= REACH {
            continue;
        }
        let [a, b, c, d, e, f, g, h, i] = pose.rotation;
        let back = |x: f64, y: f64, z: f64| -(x * centre.x + y * centre.y + z * centre.z);
        let inverse = DVec3::new(back(a, d, g), back(b, e, h), back(c, f, i));
        let text = format!("camera `{view}` is {off:.2} m from its hand at step {step}");
        return Err(if inverse.distance(hand.position) <= REACH {
            wrong(
                path,
                format!("{text}: the poses map base to camera, camera to base is expected"),
            )
            .with_hint("invert the matrices")
        } else {
            wrong(path, text).with_hint("are the poses in metres, and those of this hand's camera?")
        });
    }
    Ok(())
}

/// Both hands as joints, and the gripper of one of them.
fn states(hands: &[[Hand; 2]], choice: &StateColumns, path: &Path, warnings: &mut Vec<String>) -> StageResult<States> {
    if !choice.joints.is_empty() {
        return Err(
            StageError::bad_params("AgiBot samples have no joints of their arms to choose from")
                .with_hint("leave `joints` out of [ingest.states]"),
        );
    }
    let gripper = match choice.gripper.as_deref() {
        None => {
            warnings.push(
                "the gripper of the clip is that of the left hand: `gripper` in [ingest.states] may say `right`".into(),
            );
            0
        }
        Some(hand) => HANDS.iter().position(|known| hand == *known).ok_or_else(|| {
            StageError::bad_params(format!(
                "invalid gripper `{hand}`: expected `left` or `right` (AgiBot sample)"
            ))
        })?,
    };
    let own = || {
        HANDS
            .iter()
            .flat_map(|hand| JOINTS.map(|joint| format!("{hand}_hand_{joint}")))
            .collect()
    };
    let joint_names: Vec<String> = match choice.joint_names.len() {
        0 => own(),
        count if count == HANDS.len() * JOINTS.len() => choice.joint_names.clone(),
        count => {
            let expected = HANDS.len() * JOINTS.len();
            return Err(StageError::bad_params(format!(
                "`joint_names` has {count} names, two hands {expected} joints"
            )));
        }
    };
    let [open, closed] = choice.gripper_range.unwrap_or(GRIPPER);
    let closing = |hand: &Hand| {
        let share = (hand.gripper - open) / (closed - open);
        let share = if (-BEYOND..=1.0 + BEYOND).contains(&share) {
            share.clamp(0.0, 1.0)
        } else {
            share
        };
        if choice.invert_gripper { 1.0 - share } else { share }
    };
    let mut states = States {
        joint_names,
        positions: Vec::with_capacity(hands.len() * HANDS.len() * JOINTS.len()),
        gripper: hands.iter().map(|hands| closing(&hands[gripper])).collect(),
    };
    let mut before = [[0.0; 3]; 2];
    for hands in hands {
        for (hand, before) in hands.iter().zip(&mut before) {
            let (yaw, pitch, roll) = hand.rotation.to_euler(EulerRot::ZYX);
            // Angles go on where they were: they jump by a turn at the ends of their range.
            for (angle, before) in [yaw, pitch, roll].into_iter().zip(before.iter_mut()) {
                *before = angle + TAU * ((*before - angle) / TAU).round();
            }
            states.positions.extend(hand.position.to_array());
            states.positions.extend(*before);
            states.positions.push(closing(hand));
        }
    }
    checks::states(&states, "step", path)?;
    Ok(states)
}

/// PNG files `0.png`, `1.png`, ... of a folder, of which none may be missing.
fn count(folder: &Path) -> StageResult<u32> {
    let entries = std::fs::read_dir(folder).map_err(|error| io_error(folder, &error))?;
    let number = |entry: std::io::Result<std::fs::DirEntry>| {
        let name = entry.ok()?.file_name().into_string().ok()?;
        name.strip_suffix(".png")?.parse::<u32>().ok()
    };
    let numbers: Vec<u32> = entries.filter_map(number).take(MAX_STEPS).collect();
    let count = numbers.len() as u32;
    if numbers.iter().any(|&number| number >= count) {
        let what = format!("its {count} images are not numbered from `0.png` on without a gap");
        return Err(wrong(folder, what));
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hand(yaw: f64, gripper: f64) -> Hand {
        Hand {
            position: DVec3::new(0.6, 0.3, 0.8),
            rotation: DQuat::from_euler(EulerRot::ZYX, yaw, 0.2, -0.4),
            gripper,
        }
    }

    fn read(hands: &[[Hand; 2]], choice: &StateColumns) -> StageResult<States> {
        states(hands, choice, Path::new(ACTIONS), &mut Vec::new())
    }

    #[test]
    fn hands_become_joints_whose_angles_do_not_jump() {
        let rows: Vec<[Hand; 2]> = [3.0, 3.1, 3.2, 3.3]
            .map(|yaw| [hand(yaw, 36.0), hand(-yaw, 117.0)])
            .to_vec();
        let states = read(&rows, &StateColumns::default()).unwrap();
        assert_eq!(states.joint_names[3], "left_hand_yaw");
        assert_eq!(states.joint_names[13], "right_hand_gripper");
        for (row, yaw) in states.positions.chunks_exact(14).zip([3.0, 3.1, 3.2, 3.3]) {
            assert!((row[3] - yaw).abs() < 1e-9 && (row[10] + yaw).abs() < 1e-9, "{row:?}");
            assert!((row[4] - 0.2).abs() < 1e-9 && (row[5] + 0.4).abs() < 1e-9);
        }
        // 35 is open and 120 closed; the clip has the gripper of one hand.
        assert!((states.gripper[0] - 1.0 / 85.0).abs() < 1e-9);
        let right = StateColumns {
            gripper: Some("right".into()),
            ..StateColumns::default()
        };
        assert!((read(&rows, &right).unwrap().gripper[0] - 82.0 / 85.0).abs() < 1e-9);
        let third = StateColumns {
            gripper: Some("third".into()),
            ..StateColumns::default()
        };
        assert!(read(&rows, &third).unwrap_err().message.contains("`left` or `right`"));
        let far = [[hand(0.0, 300.0), hand(0.0, 40.0)]];
        assert!(
            read(&far, &StateColumns::default())
                .unwrap_err()
                .message
                .contains("the gripper is")
        );
    }

    #[test]
    fn poses_of_a_hand_camera_in_the_other_direction_are_told() {
        let path = Path::new("extrinsic_hand_left.npy");
        let turned = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let back = [0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let check = |rotation, translation| {
            let pose = RigidPose { rotation, translation };
            check_direction(path, "hand_left", &[pose], std::iter::once(hand(0.0, 40.0)))
        };
        assert!(check(turned, [0.6, 0.3, 0.72]).is_ok());
        // The inverse of that pose.
        let error = check(back, [-0.3, 0.6, -0.72]).unwrap_err();
        assert!(error.message.contains("map base to camera"), "{error}");
        let millimetres = check(turned, [60.0, 30.0, 72.0]).unwrap_err();
        assert!(millimetres.hint.unwrap().contains("metres"));
    }

    #[test]
    fn hands_must_have_unit_quaternions_and_finite_numbers() {
        let mut row = vec![
            0.5, 0.1, 0.8, 0.0, 0.0, 0.0, 1.0, 40.0, 0.5, -0.1, 0.8, 0.0, 0.0, 0.0, 1.0, 40.0,
        ];
        let path = Path::new(ACTIONS);
        assert!(hands(&row, 1, path).is_ok());
        row[14] = 2.0;
        assert!(
            hands(&row, 1, path)
                .unwrap_err()
                .message
                .contains("right hand has a quaternion of length 2.000")
        );
        row[14] = f64::NAN;
        assert!(
            hands(&row, 1, path)
                .unwrap_err()
                .message
                .contains("not finite at step 0")
        );
    }
}
