//! `lift-4dgt`, the baseline 4DGT as a stage: clip and robot maps to a field of Gaussians that move along polynomials of time
//! (`docs/spec/baseline-4dgt.md` section 10).
//!
//! Every source camera goes through the network by itself: its frames are resized with their intrinsics, its poses recentred
//! about their mean, and its Gaussians brought back to the robot's base, where the cameras' fields are joined. There is no
//! depth, no robot knowledge and no scale in it.

mod images;
mod lifting;
mod model;
mod params;

use std::collections::BTreeMap;
use std::path::PathBuf;

pub use lifting::lift_clip;
pub use model::{Model, load_model};
pub use params::{Configuration, InputFrames, Lift4dgtParams, OnlySeeded};
use rogs_r4c::Record;
use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::polynomial::PolynomialField;
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::{Context, Stage, StageResult};

/// The stage: one loaded network, clip after clip.
pub struct Lift4dgt {
    params: Lift4dgtParams,
    model: Model,
}

impl Stage for Lift4dgt {
    const NAME: &'static str = "lift-4dgt";
    const SUMMARY: &'static str =
        "Lifts every source camera of a clip by the baseline 4DGT, to one field in the base frame.";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = PolynomialField::SCHEMA;
    type Params = Lift4dgtParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::optional("weights", "file"),
            InputDescription::optional("encoder", "file"),
        ]
    }

    fn load(params: &Lift4dgtParams, inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        params.validate()?;
        let file = |role: &str| inputs.get(role).map(PathBuf::as_path);
        Ok(Self {
            params: params.clone(),
            model: load_model(params, file("weights"), file("encoder"))?,
        })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let untrained = self.model.weights.iter().filter(|info| !info.trained);
        for info in untrained {
            context.warn(format!(
                "THE WEIGHTS OF {} ARE NOT TRAINED ({}): this field is no prediction of 4DGT",
                info.configuration, info.description
            ));
        }
        let (clip, robot) = context.timed("read", |context| {
            StageResult::Ok((context.read::<Clip>("clip")?, context.read::<RobotMaps>("robot")?))
        })?;
        let field = lift_clip(&self.model, &self.params, &clip, &robot, context)?;
        context.timed("write", |context| context.write(&field))
    }
}
