//! The stage program `rogs-fit`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_fit::Fit>()
}
