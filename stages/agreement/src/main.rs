//! The stage program `rogs-agreement`.

use std::process::ExitCode;

fn main() -> ExitCode {
    rogs_worker::stage_main::<rogs_agreement_stage::AgreementStage>()
}
