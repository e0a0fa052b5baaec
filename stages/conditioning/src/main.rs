//! The stage program `rogs-conditioning`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_conditioning::ConditioningStage>()
}
