//! The stages this program carries inside: `rogs stage NAME one|worker|describe ...`.

use std::ffi::OsString;
use std::process::ExitCode;

use rogs_worker::{Stage, stage_main_from};

type StageMain = fn(Vec<OsString>) -> ExitCode;

/// Every stage, in pipeline order.
const STAGES: [(&str, StageMain); 6] = [
    (rogs_ingest::Ingest::NAME, ingest),
    (
        rogs_robot_maps::RobotMapsStage::NAME,
        stage_main_from::<rogs_robot_maps::RobotMapsStage>,
    ),
    (
        rogs_conditioning::ConditioningStage::NAME,
        stage_main_from::<rogs_conditioning::ConditioningStage>,
    ),
    (rogs_lift::Lift::NAME, stage_main_from::<rogs_lift::Lift>),
    (rogs_refine::Refine::NAME, stage_main_from::<rogs_refine::Refine>),
    (rogs_score::Score::NAME, stage_main_from::<rogs_score::Score>),
];

/// Runs the stage `name` with the arguments of its own program.
pub(crate) fn run(name: &str, arguments: Vec<OsString>) -> ExitCode {
    match STAGES.iter().find(|(stage, _)| *stage == name) {
        Some((_, main)) => main(arguments),
        None => {
            let names: Vec<&str> = STAGES.iter().map(|(stage, _)| *stage).collect();
            eprintln!("error: there is no stage `{name}`; stages are {}", names.join(", "));
            ExitCode::from(2)
        }
    }
}

/// Ingest has one face more: `list ROOT`.
fn ingest(arguments: Vec<OsString>) -> ExitCode {
    rogs_ingest::list_main(&arguments).unwrap_or_else(|| stage_main_from::<rogs_ingest::Ingest>(arguments))
}
