//! The stage program `rogs-lift-4dgt`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_lift_4dgt::Lift4dgt>()
}
