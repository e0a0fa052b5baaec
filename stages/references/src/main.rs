//! The stage program `rogs-references`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_references::ReferencesStage>()
}
