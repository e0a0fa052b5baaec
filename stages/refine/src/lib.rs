//! Refine (Stage 2): displacement-preserving refinement by rendering feedback.
//!
//! The Stage-1 field is rendered at each source time from the source cameras, a frozen encoder says where the renders
//! differ from the observations, what it says is pooled onto the Gaussians of that source time by their contributions,
//! and a recurrent point network turns it into corrections. A correction has no time: it is added to the field at all
//! query times alike, so that the displacement of a Gaussian between any two times stays that of Stage 1, bit for bit.
//! The output holds nothing else than the corrections.
//!
//! Seeded weights are untrained; as its last layer starts at zero, the correction is then
//! exactly zero. Outputs and warnings say so.

mod bundled;
mod params;
mod recurrence;
mod refinement;
mod resume;
mod source_time;
#[cfg(feature = "training")]
pub mod training;
mod weights;

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

pub use bundled::{BUILTIN, CI_WEIGHTS};
pub use params::{MOST_UPDATES, RefineParams};
pub use recurrence::ClipInputs;
pub use refinement::refine;
pub use weights::{LoadedRefiner, load_refiner};

/// The stage.
pub struct Refine {
    params: RefineParams,
    network: LoadedRefiner,
    weights: Option<PathBuf>,
}

impl Stage for Refine {
    const NAME: &'static str = "refine";
    const SUMMARY: &'static str = "Stage 2: correct the field by rendering feedback, keeping all displacements";
    const VERSION: u32 = 2;
    const OUTPUT: SchemaId = Refinement::SCHEMA;
    type Params = RefineParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::required("field", Field::SCHEMA.name),
            InputDescription::optional("weights", "file"),
            InputDescription::optional("resume", Refinement::SCHEMA.name),
        ]
    }

    fn load(params: &RefineParams, inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        let weights = inputs.get("weights").cloned();
        let network = load_refiner(params, weights.as_deref())?;
        Ok(Self {
            params: params.clone(),
            network,
            weights,
        })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let weights = context.optional_input("weights").map(PathBuf::from);
        if weights != self.weights {
            self.network = load_refiner(&self.params, weights.as_deref())?;
            self.weights = weights;
        }
        for warning in &self.network.warnings {
            context.warn(warning.clone());
        }
        let clip: Clip = context.read("clip")?;
        let robot: RobotMaps = context.read("robot")?;
        let field: Field = context.read("field")?;
        let resume: Option<Refinement> = match context.optional_input("resume") {
            Some(_) => Some(context.read("resume")?),
            None => None,
        };
        let field_key = context
            .input_key("field")
            .ok_or_else(|| StageError::internal("the job does not name the field's key"))?;
        let inputs = ClipInputs {
            clip: &clip,
            robot: &robot,
            field: &field,
            field_key,
            resume: resume.as_ref(),
        };
        let refinement = context.timed("refine", |context| refine(inputs, &self.network, &self.params, context))?;
        context.write(&refinement)
    }
}
