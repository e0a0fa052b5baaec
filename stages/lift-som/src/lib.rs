//! `lift-som`, the baseline Shape of Motion as a stage: clip, robot maps and sidecars to Gaussians that shared rigid motions
//! move (`docs/spec/baseline-som.md`).
//!
//! Every source camera is optimised by itself against its own images, the depth and the tracks that others estimated from
//! them, and the mask that the robot's mesh gives. The cameras' fields stand together in the robot's base frame. There is no
//! network in it. A killed job resumes from the last multiple of a hundred updates, with the same bytes.

mod initial;
mod losses;
mod motion;
mod observed;
mod params;
mod scene;
pub mod sidecars;
#[cfg(test)]
#[path = "../tests/support/mod.rs"]
mod support;
mod tracks_alone;
mod training;

use std::collections::BTreeMap;
use std::path::PathBuf;

pub use params::LiftSomParams;
use rogs_r4c::Record;
use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::motion_bases::MotionBasisField;
use rogs_schemas::records::references::References;
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::{Context, Stage, StageError, StageResult};
pub use training::{ClipInputs, reconstruct};

/// The stage.
pub struct LiftSom {
    params: LiftSomParams,
}

impl Stage for LiftSom {
    const NAME: &'static str = "lift-som";
    const SUMMARY: &'static str =
        "Optimises Gaussians for every source camera of a clip as the baseline Shape of Motion does.";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = MotionBasisField::SCHEMA;
    type Params = LiftSomParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::optional("references", References::SCHEMA.name),
            InputDescription::optional("sidecars", "folder"),
        ]
    }

    fn load(params: &LiftSomParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        params.validate()?;
        Ok(Self { params: params.clone() })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let mut clip: Clip = context.read("clip")?;
        let robot: RobotMaps = context.read("robot")?;
        if context.optional_input("references").is_some() {
            let references: References = context.read("references")?;
            references.complete(&mut clip).map_err(StageError::bad_input)?;
        }
        let Some(sidecars) = context.optional_input("sidecars").map(PathBuf::from) else {
            return Err(StageError::bad_input(format!("there are no sidecars of clip `{}`", clip.clip_id)).with_hint(
                "the folder that [sidecars] root names has none of this name; docs/sidecars.md says how they are made",
            ));
        };
        let kept = context.kept();
        let inputs = ClipInputs {
            clip: &clip,
            robot: &robot,
            sidecars: &sidecars,
        };
        let field = reconstruct(inputs, &self.params, kept, context)?;
        context.write(&field)
    }
}

/// What cannot happen with arrays that belong together.
fn internal(error: impl std::fmt::Display) -> StageError {
    StageError::internal(error.to_string())
}
