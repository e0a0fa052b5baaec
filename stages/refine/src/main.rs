//! The stage program `rogs-refine`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_refine::Refine>()
}
