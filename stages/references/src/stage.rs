//! The stage.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_r4c::Record;
use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::references::References;
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::{Context, Stage, StageResult};

use crate::build::build;
use crate::params::Params;

/// `references`: depth from stereo pairs and robot tracks from kinematics, where a clip has none.
#[derive(Debug)]
pub struct ReferencesStage {
    params: Params,
}

impl Stage for ReferencesStage {
    const NAME: &'static str = "references";
    const SUMMARY: &'static str =
        "Makes the references that a clip lacks: depth by stereo, robot tracks by kinematics.";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = References::SCHEMA;
    type Params = Params;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
        ]
    }

    fn load(params: &Params, _inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        params.check()?;
        Ok(Self { params: params.clone() })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let (clip, robot) = context.timed("read", |context| {
            StageResult::Ok((context.read::<Clip>("clip")?, context.read::<RobotMaps>("robot")?))
        })?;
        let references = build(&clip, &robot, &self.params, context)?;
        context.write(&references)
    }
}
