//! End-effector actions as an action-conditioned world model takes them (`docs/spec/data.md` section 6): how a link moves
//! from one frame to the next, seen from itself.

use glam::{DMat3, DVec3};

use crate::pose::{Frame, Link, Pose};

/// One step: the pose of the tool at its end, seen from the tool at its start, and the gripper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Action {
    /// Translation, metres.
    pub translation_m: [f64; 3],
    /// First and second column of the rotation matrix.
    pub rot6d: [f64; 6],
    /// 1 open, 0 closed.
    pub gripper: f64,
}

/// Turns the axes of `panda_link8` into those that actions are told in: `Rz(90 degrees)`, on the right.
const TOOL_FROM_LINK: DMat3 = DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z);

/// The pose that actions move: a link's pose with its axes turned by 90 degrees about its own z.
#[must_use]
pub fn tool_pose<A: Frame>(base_from_link: &Pose<A, Link>) -> Pose<A, Link> {
    Pose::new(base_from_link.rotation * TOOL_FROM_LINK, base_from_link.translation)
}

/// The actions between the poses of a link at consecutive frames: `T_i^-1 T_(i+1)` of [`tool_pose`]. The gripper of a step
/// is `1 - gripper` at its end, `gripper` being 0 open, 1 closed. One action less than poses; `gripper [F]` is read from
/// its second entry on.
#[must_use]
pub fn actions<A: Frame>(base_from_link: &[Pose<A, Link>], gripper: &[f64]) -> Vec<Action> {
    let steps = base_from_link.windows(2).zip(gripper.iter().skip(1));
    steps
        .map(|(pair, gripper)| {
            let delta = tool_pose(&pair[0]).inverse() * tool_pose(&pair[1]);
            let (x, y) = (delta.rotation.x_axis, delta.rotation.y_axis);
            Action {
                translation_m: delta.translation.to_array(),
                rot6d: [x.x, x.y, x.z, y.x, y.y, y.z],
                gripper: 1.0 - gripper,
            }
        })
        .collect()
}

/// The poses of the link that follow from the first one by the actions, the first included: [`actions`] undone.
#[must_use]
pub fn follow<A: Frame>(base_from_link: &Pose<A, Link>, actions: &[Action]) -> Vec<Pose<A, Link>> {
    let mut tool = tool_pose(base_from_link);
    let mut poses = vec![*base_from_link];
    for action in actions {
        let [a, b, c, d, e, f] = action.rot6d;
        let (x, y) = (DVec3::new(a, b, c), DVec3::new(d, e, f));
        let delta: Pose<Link, Link> = Pose::new(
            DMat3::from_cols(x, y, x.cross(y)),
            DVec3::from_array(action.translation_m),
        );
        tool = tool * delta;
        poses.push(Pose::new(tool.rotation * TOOL_FROM_LINK.transpose(), tool.translation));
    }
    poses
}

impl Action {
    /// Translation, rot6d, gripper, as the model's arrays hold them.
    #[must_use]
    pub fn row(&self) -> [f64; 10] {
        let ([x, y, z], [a, b, c, d, e, f]) = (self.translation_m, self.rot6d);
        [x, y, z, a, b, c, d, e, f, self.gripper]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::Base;

    fn path() -> Vec<Pose<Base, Link>> {
        let pose = |step: i32| {
            let t = f64::from(step);
            Pose::from_xyz_euler([0.4 + 0.01 * t, -0.1, 0.3 - 0.02 * t], [3.1 + 0.05 * t, 0.2 * t, -0.3])
        };
        (0..17).map(pose).collect()
    }

    #[test]
    fn actions_lead_back_along_the_path() {
        let path = path();
        let gripper: Vec<f64> = (0..17).map(|step| f64::from(step) / 16.0).collect();
        let chunk = actions(&path, &gripper);
        assert_eq!(chunk.len(), 16);
        for (found, expected) in follow(&path[0], &chunk).iter().zip(&path) {
            assert!((found.translation - expected.translation).length() < 1e-12);
            assert!(
                (found.rotation - expected.rotation)
                    .to_cols_array()
                    .iter()
                    .all(|entry| entry.abs() < 1e-12)
            );
        }
        assert_eq!((chunk[0].gripper, chunk[15].gripper), (1.0 - 1.0 / 16.0, 0.0));
    }

    /// By hand: the link looks along the base's axes and moves along its x; the tool's x is the link's y, so the tool sees
    /// a move along its negative y.
    #[test]
    fn the_axes_are_turned_by_ninety_degrees() {
        let still = Pose::<Base, Link>::IDENTITY;
        let moved = Pose::from_translation(DVec3::new(0.25, 0.0, 0.0));
        let turned = Pose::from_xyz_euler([0.0; 3], [0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        let [forward, turn] = [moved, turned].map(|end| actions(&[still, end], &[0.0, 0.25])[0]);
        let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-15);
        assert!(
            close(&forward.row(), &[0.0, -0.25, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.75]),
            "{forward:?}"
        );
        // A turn about z looks the same from the turned axes: columns (0, 1, 0) and (-1, 0, 0), one behind the other.
        assert!(close(&turn.rot6d, &[0.0, 1.0, 0.0, -1.0, 0.0, 0.0]), "{turn:?}");
    }
}
