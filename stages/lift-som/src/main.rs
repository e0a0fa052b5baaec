//! The stage program `rogs-lift-som`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_lift_som::LiftSom>()
}
