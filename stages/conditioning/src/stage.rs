//! The stage.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_r4c::Record;
use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::{Context, Stage, StageError, StageResult};

use crate::build::{Params, build};

/// `conditioning`: how far forward kinematics moves every supported pixel.
#[derive(Debug)]
pub struct ConditioningStage {
    params: Params,
}

impl Stage for ConditioningStage {
    const NAME: &'static str = "conditioning";
    const SUMMARY: &'static str = "Makes the FK conditioning maps of every source view and query time.";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Conditioning::SCHEMA;
    type Params = Params;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
        ]
    }

    fn load(params: &Params, _inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        if !(params.prior_sigma_m.is_finite() && params.prior_sigma_m > 0.0) {
            return Err(StageError::bad_params(format!(
                "prior_sigma_m is {}, it must be a positive length",
                params.prior_sigma_m
            )));
        }
        Ok(Self { params: params.clone() })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let (clip, robot) = context.timed("read", |context| {
            StageResult::Ok((context.read::<Clip>("clip")?, context.read::<RobotMaps>("robot")?))
        })?;
        let conditioning = context.timed("maps", |_| build(&clip, &robot, &self.params))?;
        context.write(&conditioning)
    }
}
