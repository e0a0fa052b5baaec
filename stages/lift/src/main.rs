//! The stage program `rogs-lift`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_lift::Lift>()
}
