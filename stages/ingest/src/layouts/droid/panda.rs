//! Forward kinematics of the Panda arm to its flange, with the joint origins that its maker publishes: every robot of
//! DROID is one, and its logs can be checked without a URDF.

use rogs_geometry::{Base, Link, Pose};

use std::f64::consts::FRAC_PI_2;

/// Joints of the arm.
pub(super) const JOINTS: usize = 7;

/// Origin of every joint in the frame before it: xyz in metres, and the turn about x in radians.
const ORIGINS: [([f64; 3], f64); JOINTS] = [
    ([0.0, 0.0, 0.333], 0.0),
    ([0.0, 0.0, 0.0], -FRAC_PI_2),
    ([0.0, -0.316, 0.0], FRAC_PI_2),
    ([0.0825, 0.0, 0.0], FRAC_PI_2),
    ([-0.0825, 0.384, 0.0], -FRAC_PI_2),
    ([0.0, 0.0, 0.0], FRAC_PI_2),
    ([0.088, 0.0, 0.0], FRAC_PI_2),
];

/// The flange beyond the last joint, metres.
const FLANGE: [f64; 3] = [0.0, 0.0, 0.107];

/// Pose of the flange (`panda_link8`) in the base (`panda_link0`), joints in radians.
pub(super) fn base_from_flange(joints: &[f64; JOINTS]) -> Pose<Base, Link> {
    let mut pose: Pose<Base, Link> = Pose::IDENTITY;
    for ((xyz, turn), angle) in ORIGINS.into_iter().zip(joints) {
        let origin: Pose<Link, Link> = Pose::from_xyz_euler(xyz, [turn, 0.0, 0.0]);
        pose = pose * origin * Pose::from_xyz_euler([0.0; 3], [0.0, 0.0, *angle]);
    }
    pose * Pose::<Link, Link>::from_xyz_euler(FLANGE, [0.0; 3])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A state and the pose that the robot's controller logged for it (`docs/spec/data.md` section 0).
    #[rogs_needs::needs(shared)]
    #[test]
    fn recorded_states_give_the_recorded_poses() {
        let text = std::fs::read_to_string(rogs_needs::shared!("data/robots/fk_golden.json")).unwrap();
        let golden: serde_json::Value = serde_json::from_str(&text).unwrap();
        let states = golden["cases"].as_array().unwrap();
        assert!(states.len() >= 12);
        for state in states {
            let numbers = |key: &str| -> Vec<f64> {
                state[key]
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(|value| value.as_f64().unwrap())
                    .collect()
            };
            let joints: [f64; JOINTS] = numbers("joints")[..JOINTS].try_into().unwrap();
            let [x, y, z, a, b, c]: [f64; 6] = numbers("cartesian_position")[..6].try_into().unwrap();
            let recorded: Pose<Base, Link> = Pose::from_xyz_euler([x, y, z], [a, b, c]);
            let off = recorded.inverse() * base_from_flange(&joints);
            assert!(off.translation.length() < 1e-6, "{:?}", off.translation);
            assert!((off.rotation.x_axis.x - 1.0).abs() < 1e-9 && (off.rotation.y_axis.y - 1.0).abs() < 1e-9);
        }
    }
}
