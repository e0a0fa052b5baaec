//! Where the shared reference data lie.
#![allow(dead_code, reason = "each test uses a part")]

use std::path::{Path, PathBuf};

/// A path under the shared folder (`ROGS_SHARED`, or `shared` beside the workspace); `None`, with the reason printed,
/// when it is absent.
pub(crate) fn shared(path: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let root = std::env::var_os("ROGS_SHARED").map_or(beside, PathBuf::from);
    let full = root.join(path);
    if !full.exists() {
        eprintln!(
            "skipped: `{}` is absent; set ROGS_SHARED to the folder of reference data",
            full.display()
        );
        return None;
    }
    Some(full)
}

/// The Panda with the Robotiq gripper.
pub(crate) fn panda() -> Option<rogs_robot::RobotModel> {
    let urdf = shared("data/robots/panda_robotiq_2f85/franka_panda_robotiq_2f85.urdf")?;
    Some(rogs_robot::RobotModel::load(&urdf).unwrap())
}
