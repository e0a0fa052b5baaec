//! Fit: the Gaussians of one clip optimised against its source images.
//!
//! The fit starts from a field of Stage 1, or from one with the corrections of Stage 2, and makes a field of the same
//! Gaussians. Those of the robot move as they did: their displacements stay bit for bit (or follow the links, where that is
//! asked for). What the field hardly moves is one static background for all times; what else moves, moves by a few
//! shared rigid motions. All source cameras are fitted together, and source images are the only supervision; the
//! formulas are those of `docs/spec/fit.md`.

mod fitting;
mod params;
mod scene;
mod source_time;
mod start;

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_r4c::Record;
use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::{Context, Stage, StageError, StageResult};

pub use fitting::{ClipInputs, Fitting, fit};
pub use params::{FitParams, Rates, RobotMotion, StartFrom};

/// The stage.
pub struct Fit {
    params: FitParams,
}

impl Stage for Fit {
    const NAME: &'static str = "fit";
    const SUMMARY: &'static str = "Fit: optimise the field of one clip against its source images";
    const VERSION: u32 = 2;
    const OUTPUT: SchemaId = Field::SCHEMA;
    type Params = FitParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::required("field", Field::SCHEMA.name),
            InputDescription::optional("refinement", Refinement::SCHEMA.name),
        ]
    }

    fn load(params: &FitParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        params.check()?;
        Ok(Self { params: params.clone() })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        let robot: RobotMaps = context.read("robot")?;
        let field: Field = context.read("field")?;
        let refinement: Option<Refinement> = match (self.params.start, context.optional_input("refinement")) {
            (StartFrom::Refined, Some(_)) => Some(context.read("refinement")?),
            (StartFrom::Refined, None) => {
                return Err(
                    StageError::bad_input("there are no corrections of Stage 2 to start from")
                        .with_hint("give `refinement`, or set `start = \"lifted\"`"),
                );
            }
            (StartFrom::Lifted, _) => None,
        };
        if let (Some(refinement), Some(key)) = (&refinement, context.input_key("field")) {
            let checked = refinement.check_corrects(key);
            checked.map_err(|what| StageError::bad_input(what).with_hint("give the field that `refine` was run on"))?;
        }
        let inputs = ClipInputs {
            clip: &clip,
            robot: &robot,
            field: &field,
            refinement: refinement.as_ref(),
        };
        let kept = context.kept();
        let fitted = context.timed("fit", |context| fit(inputs, &self.params, kept.as_ref(), context))?;
        context.write(&fitted)
    }
}
