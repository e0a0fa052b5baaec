//! What the benches of this crate share.
#![allow(dead_code, unused_imports, reason = "each bench uses a part")]

#[path = "../../../../tests/support/bench.rs"]
mod bench;

use std::path::PathBuf;

pub(crate) use bench::{peak_memory_mib, processor_seconds, run_peer, seconds};

/// The Panda's URDF among the reference data.
pub(crate) fn panda() -> Option<PathBuf> {
    let urdf = rogs_needs::shared!("data/robots/panda_robotiq_2f85/franka_panda_robotiq_2f85.urdf");
    if !urdf.exists() {
        println!(
            "skipped: `{}` is absent; set ROGS_SHARED to the folder of reference data",
            urdf.display()
        );
        return None;
    }
    Some(urdf)
}
