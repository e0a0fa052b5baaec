//! The stages this program carries inside: `rogs stage NAME one|worker|describe ...`.

use std::ffi::OsString;
use std::process::ExitCode;

use rogs_orchestrator::stage::StageId;
use rogs_worker::stage_main_from;

use crate::output;

/// Runs the stage `name` with the arguments of its own program.
pub(crate) fn run(name: &str, arguments: Vec<OsString>) -> ExitCode {
    let Ok(stage) = name.parse() else {
        let names: Vec<&str> = StageId::ALL.iter().map(|stage| stage.name()).collect();
        output::note(&format!(
            "error: there is no stage `{name}`; stages are {}",
            names.join(", ")
        ));
        return ExitCode::from(2);
    };
    match stage {
        // Ingest has one face more: `list ROOT`.
        StageId::Ingest => {
            rogs_ingest::list_main(&arguments).unwrap_or_else(|| stage_main_from::<rogs_ingest::Ingest>(arguments))
        }
        StageId::RobotMaps => stage_main_from::<rogs_robot_maps::RobotMapsStage>(arguments),
        StageId::Conditioning => stage_main_from::<rogs_conditioning::ConditioningStage>(arguments),
        StageId::Agreement => stage_main_from::<rogs_agreement_stage::AgreementStage>(arguments),
        StageId::References => stage_main_from::<rogs_references::ReferencesStage>(arguments),
        StageId::Lift => stage_main_from::<rogs_lift::Lift>(arguments),
        StageId::Lift4dgt => stage_main_from::<rogs_lift_4dgt::Lift4dgt>(arguments),
        StageId::LiftSom => stage_main_from::<rogs_lift_som::LiftSom>(arguments),
        StageId::Refine => stage_main_from::<rogs_refine::Refine>(arguments),
        StageId::Fit => stage_main_from::<rogs_fit::Fit>(arguments),
        StageId::Score => stage_main_from::<rogs_score::Score>(arguments),
    }
}

#[cfg(test)]
mod tests {
    use rogs_worker::Stage;

    use super::*;

    /// The orchestrator's table and the stages agree on names, roles and parameters.
    fn agrees<S: Stage>(id: StageId) {
        assert_eq!(S::NAME, id.name());
        let spec = id.spec();
        let (mut known, mut described): (Vec<&str>, Vec<String>) = (
            spec.inputs.iter().map(|input| input.role).collect(),
            S::inputs().into_iter().map(|input| input.role).collect(),
        );
        known.sort_unstable();
        described.sort_unstable();
        assert_eq!(known, described, "inputs of {id}");
        let defaults = serde_json::to_value(S::Params::default()).unwrap();
        let schema = rogs_worker::describe::<S>(&serde_json::Value::Null)
            .unwrap()
            .params_schema;
        for (name, _) in spec.filled {
            assert!(
                schema["properties"].get(name).is_some(),
                "{id} has no parameter `{name}`"
            );
        }
        let deciding = spec.inputs.iter().filter_map(|input| Some(input.when.as_ref()?.param));
        let unless = spec.outputs.iter().filter_map(|output| output.unless);
        let interval = spec.interval.iter().flat_map(|own| [own.start, own.frames, own.step]);
        for name in deciding.chain(unless).chain(spec.selector).chain(interval) {
            assert!(defaults.get(name).is_some(), "{id} has no parameter `{name}`");
        }
    }

    #[test]
    fn the_table_of_the_orchestrator_is_that_of_the_stages() {
        for &id in StageId::ALL {
            match id {
                StageId::Ingest => agrees::<rogs_ingest::Ingest>(id),
                StageId::RobotMaps => agrees::<rogs_robot_maps::RobotMapsStage>(id),
                StageId::Conditioning => agrees::<rogs_conditioning::ConditioningStage>(id),
                StageId::Agreement => agrees::<rogs_agreement_stage::AgreementStage>(id),
                StageId::References => agrees::<rogs_references::ReferencesStage>(id),
                StageId::Lift => agrees::<rogs_lift::Lift>(id),
                StageId::Lift4dgt => agrees::<rogs_lift_4dgt::Lift4dgt>(id),
                StageId::LiftSom => agrees::<rogs_lift_som::LiftSom>(id),
                StageId::Refine => agrees::<rogs_refine::Refine>(id),
                StageId::Fit => agrees::<rogs_fit::Fit>(id),
                StageId::Score => agrees::<rogs_score::Score>(id),
            }
        }
    }
}
