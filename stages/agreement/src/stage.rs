//! The stage.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_r4c::Record;
use rogs_r4c::source::ROBOT_MODEL;
use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::agreement::Agreements;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::{Context, Stage, StageError, StageResult};

use crate::build::{Robot, build};
use crate::params::Params;

/// `agreement`: whether the robot lies on the images, and which mistake explains that it does not.
#[derive(Debug)]
pub struct AgreementStage {
    params: Params,
    robot: Robot,
}

impl Stage for AgreementStage {
    const NAME: &'static str = "agreement";
    const SUMMARY: &'static str =
        "Measures whether the drawn robot lies on the images, and says which mistake explains that it does not.";
    const VERSION: u32 = 2;
    const OUTPUT: SchemaId = Agreements::SCHEMA;
    type Params = Params;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::required(ROBOT_MODEL, "file"),
        ]
    }

    fn load(params: &Params, inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        let missing = || StageError::bad_params(format!("the job names no input `{ROBOT_MODEL}`"));
        let urdf = inputs.get(ROBOT_MODEL).ok_or_else(missing)?;
        Ok(Self {
            params: params.clone(),
            robot: Robot::load(urdf, &params.robot)?,
        })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let (clip, robot) = context.timed("read", |context| {
            StageResult::Ok((context.read::<Clip>("clip")?, context.read::<RobotMaps>("robot")?))
        })?;
        let agreements = build(&clip, &robot, &self.robot, &self.params, context)?;
        context.write(&agreements)
    }
}
