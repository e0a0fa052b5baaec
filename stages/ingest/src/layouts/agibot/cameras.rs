//! The cameras of a sample: images, lens, and a pose a step.

use std::path::Path;

use glam::DVec3;
use rogs_arrays::{NpyFile, Png};
use rogs_schemas::records::clip::CameraRole;
use rogs_schemas::{Intrinsics, RigidPose, WrittenPose};
use rogs_worker::StageResult;

use super::hands::{HANDS, Hand};
use super::images;
use crate::calibration::Calibration;
use crate::checks;
use crate::fault::{unreadable, wrong};
use crate::images::FrameSource;
use crate::source::{SourceCamera, SourceMount};

/// A camera further from its hand is not on it, metres; the samples have 0.07 to 0.09.
const REACH: f64 = 0.35;
/// Where camera parameters come from.
const WAY: &str = "take the sample with its camera parameters (Genie Envisioner's samples have `intrinsic_VIEW.npy` and \
                   `extrinsic_VIEW.npy`), or give a calibration file (docs/calibration-format.md)";

/// A camera with its images, lens and pose at every frame.
pub(super) fn camera(
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

#[cfg(test)]
mod tests {
    use super::super::hands::tests::hand;
    use super::*;

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
}
