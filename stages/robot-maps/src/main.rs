//! The stage program `rogs-robot-maps`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_robot_maps::RobotMapsStage>()
}
