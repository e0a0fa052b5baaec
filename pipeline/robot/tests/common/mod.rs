//! Reference data.
#![allow(dead_code, reason = "each test uses a part")]

use rogs_needs::shared;

/// The Panda with the Robotiq gripper; tests that call it need `shared`.
pub(crate) fn panda() -> rogs_robot::RobotModel {
    let urdf = shared!("data/robots/panda_robotiq_2f85/franka_panda_robotiq_2f85.urdf");
    rogs_robot::RobotModel::load(&urdf).unwrap()
}
