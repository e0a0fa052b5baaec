//! Inverse kinematics by damped least squares.

use glam::DVec3;
use rogs_geometry::{Base, Pose};

use super::{ARM_JOINTS, ARM_LIMITS, HOME, Robot};
use crate::frame::BodyFrame;
use crate::math::rotation_vector;

const MAX_STEPS: usize = 120;
const DAMPING: f64 = 0.02;
/// Metres that a radian of orientation error counts as.
const RADIAN: f64 = 0.25;

/// Joint positions that bring the flange to `target`, started at `start`; `None` when 0.1 mm and 0.5 mrad are not
/// reached inside the joint limits. Slack in the elbow is pulled towards the home posture.
pub(crate) fn solve_tool(
    robot: &Robot,
    target: &Pose<Base, BodyFrame>,
    start: [f64; ARM_JOINTS],
) -> Option<[f64; ARM_JOINTS]> {
    let mut joints = start;
    for _ in 0..MAX_STEPS {
        let (flange, jacobian) = jacobian(robot, &joints);
        let shift = target.translation - flange.translation;
        let turn = rotation_vector(&(target.rotation * flange.rotation.transpose()));
        if shift.length() < 1e-5 && turn.length() < 5e-5 {
            return within_limits(&joints).then_some(joints);
        }
        let shift = shift.clamp_length_max(0.1);
        let turn = turn.clamp_length_max(0.3) * RADIAN;
        let error = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
        let step = damped_step(&jacobian, &error, &joints);
        for (k, joint) in joints.iter_mut().enumerate() {
            *joint = (*joint + step[k]).clamp(ARM_LIMITS[k][0] + 1e-4, ARM_LIMITS[k][1] - 1e-4);
        }
    }
    let flange = robot.flange(&joints);
    let shift = (target.translation - flange.translation).length();
    let turn = rotation_vector(&(target.rotation * flange.rotation.transpose())).length();
    (shift < 1e-4 && turn < 5e-4 && within_limits(&joints)).then_some(joints)
}

fn within_limits(joints: &[f64; ARM_JOINTS]) -> bool {
    joints
        .iter()
        .zip(ARM_LIMITS)
        .all(|(joint, [low, high])| (low..=high).contains(joint))
}

/// Flange pose and the six rows of its Jacobian (linear, then angular times [`RADIAN`]).
fn jacobian(robot: &Robot, joints: &[f64; ARM_JOINTS]) -> (Pose<Base, BodyFrame>, [[f64; ARM_JOINTS]; 6]) {
    let poses = robot.arm(joints);
    let flange = poses[super::FLANGE_LINK];
    let mut rows = [[0.0; ARM_JOINTS]; 6];
    for joint in 0..ARM_JOINTS {
        let axis = poses[joint + 1].rotation.z_axis;
        let linear: DVec3 = axis.cross(flange.translation - poses[joint + 1].translation);
        for k in 0..3 {
            rows[k][joint] = linear[k];
            rows[k + 3][joint] = axis[k] * RADIAN;
        }
    }
    (flange, rows)
}

/// J^T (J J^T + damping^2)^-1 e, plus a small pull to the home posture in the null space.
fn damped_step(jacobian: &[[f64; ARM_JOINTS]; 6], error: &[f64; 6], joints: &[f64; ARM_JOINTS]) -> [f64; ARM_JOINTS] {
    let mut pull = [0.0; ARM_JOINTS];
    for k in 0..ARM_JOINTS {
        pull[k] = 0.02 * (HOME[k] - joints[k]);
    }
    // (I - J+ J) pull = pull - J+ (J pull): solve for e - J pull and add the pull.
    let mut rest = *error;
    for (row, value) in jacobian.iter().zip(&mut rest) {
        *value -= row.iter().zip(&pull).map(|(a, b)| a * b).sum::<f64>();
    }
    let mut system = [[0.0; 7]; 6];
    for i in 0..6 {
        for j in 0..6 {
            system[i][j] = jacobian[i].iter().zip(&jacobian[j]).map(|(a, b)| a * b).sum();
        }
        system[i][i] += DAMPING * DAMPING;
        system[i][6] = rest[i];
    }
    let solution = solve(system);
    let mut step = pull;
    for (k, value) in step.iter_mut().enumerate() {
        *value += (0..6).map(|i| jacobian[i][k] * solution[i]).sum::<f64>();
    }
    step
}

/// Gaussian elimination of a positive definite system.
fn solve(mut system: [[f64; 7]; 6]) -> [f64; 6] {
    for pivot in 0..6 {
        for row in pivot + 1..6 {
            let factor = system[row][pivot] / system[pivot][pivot];
            for column in pivot..7 {
                system[row][column] -= factor * system[pivot][column];
            }
        }
    }
    let mut x = [0.0; 6];
    for row in (0..6).rev() {
        let known: f64 = (row + 1..6).map(|column| system[row][column] * x[column]).sum();
        x[row] = (system[row][6] - known) / system[row][row];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{rot_x, rot_z};

    #[test]
    fn targets_over_the_table_are_reached() {
        let robot = Robot::new();
        let mut joints = HOME;
        for (x, y, yaw) in [(0.5, 0.1, 0.3), (0.6, -0.25, -0.5), (0.4, 0.25, 0.8)] {
            let down = rot_z(yaw) * rot_x(std::f64::consts::PI);
            let target = Pose::new(down, DVec3::new(x, y, 0.25));
            joints = solve_tool(&robot, &target, joints).unwrap();
            let reached = robot.flange(&joints);
            assert!((reached.translation - target.translation).length() < 1e-4);
            assert!(rotation_vector(&(target.rotation * reached.rotation.transpose())).length() < 5e-4);
        }
        let far = Pose::new(rot_x(std::f64::consts::PI), DVec3::new(1.5, 0.0, 0.3));
        assert!(solve_tool(&robot, &far, HOME).is_none());
    }
}
