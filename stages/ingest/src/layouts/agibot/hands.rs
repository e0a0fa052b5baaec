//! The hands of a sample: `actions.npy`, and what of it becomes states.

use std::f64::consts::TAU;
use std::path::Path;

use glam::{DQuat, DVec3, EulerRot};
use rogs_arrays::{ANY, NpyFile};
use rogs_worker::{StageError, StageResult};

use super::MAX_STEPS;
use crate::checks;
use crate::fault::{unreadable, wrong};
use crate::params::StateColumns;
use crate::source::States;

pub(super) const HANDS: [&str; 2] = ["left", "right"];
/// Numbers of `actions.npy` a step and hand: xyz, quaternion xyzw, gripper.
const PER_HAND: usize = 8;
/// Joints that stand for a hand: `R = Rz(yaw) Ry(pitch) Rx(roll)`, metres and radians; then its gripper, 0 to 1.
const JOINTS: [&str; 7] = ["x", "y", "z", "yaw", "pitch", "roll", "gripper"];
/// Gripper values that mean open and closed, as the images of the samples show; values lie up to 4 % beyond.
const GRIPPER: [f64; 2] = [35.0, 120.0];
const BEYOND: f64 = 0.05;

/// The numbers of the actions, and how many steps there are.
pub(super) fn actions(path: &Path) -> StageResult<(Vec<f64>, usize)> {
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
pub(super) struct Hand {
    pub(super) position: DVec3,
    pub(super) rotation: DQuat,
    pub(super) gripper: f64,
}

/// Both hands at every frame.
pub(super) fn hands(actions: &[f64], frames: usize, path: &Path) -> StageResult<Vec<[Hand; 2]>> {
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

/// Both hands as joints, and the gripper of one of them.
pub(super) fn states(
    hands: &[[Hand; 2]],
    choice: &StateColumns,
    path: &Path,
    warnings: &mut Vec<String>,
) -> StageResult<States> {
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

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in super::super) fn hand(yaw: f64, gripper: f64) -> Hand {
        Hand {
            position: DVec3::new(0.6, 0.3, 0.8),
            rotation: DQuat::from_euler(EulerRot::ZYX, yaw, 0.2, -0.4),
            gripper,
        }
    }

    fn read(hands: &[[Hand; 2]], choice: &StateColumns) -> StageResult<States> {
        states(hands, choice, Path::new("actions.npy"), &mut Vec::new())
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
    fn hands_must_have_unit_quaternions_and_finite_numbers() {
        let mut row = vec![
            0.5, 0.1, 0.8, 0.0, 0.0, 0.0, 1.0, 40.0, 0.5, -0.1, 0.8, 0.0, 0.0, 0.0, 1.0, 40.0,
        ];
        let path = Path::new("actions.npy");
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
