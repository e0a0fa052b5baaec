//! The program `rogs-score`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_score::Score>()
}
