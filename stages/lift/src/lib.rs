//! Lift (Stage 1): clip, robot maps and conditioning to a time-queryable field.
//!
//! The network sees all source views of a clip at once; the field has one Gaussian per source pixel. Robot pixels are
//! anchored on the mesh, their motion is conditioned on forward kinematics, and the field is stored at every time that the
//! clip asks for. [`FieldQuery`] answers other times. Interventions of the paper's ablations are parameters
//! ([`LiftParams`]).

mod lifting;
mod model;
mod params;
mod query;
mod rgb;
mod source;

use std::collections::BTreeMap;
use std::path::PathBuf;

pub use lifting::MotionOptions;
pub use model::{Model, load_model};
pub use params::{CrossCamera, LiftParams, QueryState, RobotMotion};
pub use query::FieldQuery;
use rogs_networks::Error;
use rogs_networks::stage1::Encoded;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::record::{Record, SchemaId};
use rogs_schemas::records::clip::{Clip, time_of_frame};
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::field::{Field, TimeSlice};
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::{Context, Stage, StageError, StageResult};
pub use source::RobotAtTime;

use crate::lifting::{Anchor, Base, Branch, MotionHeads, lift_base};
use crate::source::Source;

/// The stage: one loaded network, clip after clip.
pub struct Lift {
    params: LiftParams,
    model: Model,
}

impl Stage for Lift {
    const NAME: &'static str = "lift";
    const SUMMARY: &'static str = "Lifts the source views of a clip to a time-queryable Gaussian field (Stage 1)";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = <Field as Record>::SCHEMA;
    type Params = LiftParams;

    fn inputs() -> Vec<InputDescription> {
        let input = |role: &str, kind: &str, required: bool| InputDescription {
            role: role.into(),
            required,
            kind: kind.into(),
        };
        vec![
            input("clip", Clip::SCHEMA.name, true),
            input("robot", RobotMaps::SCHEMA.name, true),
            input("conditioning", Conditioning::SCHEMA.name, true),
            input("weights", "file", false),
        ]
    }

    fn load(params: &LiftParams, inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        params.validate()?;
        let weights = inputs.get("weights").map(PathBuf::as_path);
        Ok(Self {
            params: params.clone(),
            model: load_model(params, weights)?,
        })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        if !self.model.info.trained {
            context.warn(format!(
                "THE STAGE-1 WEIGHTS ARE NOT TRAINED ({}): depth, colour and motion of this field are not predictions",
                self.model.info.description
            ));
        }
        let clip: Clip = context.read("clip")?;
        let robot: RobotMaps = context.read("robot")?;
        let conditioning: Conditioning = context.read("conditioning")?;
        let mut warnings = Vec::new();
        let mut phase = |name: &str, fraction: f64, work: Work<'_>| {
            context.progress(fraction, name);
            context.timed(name, |_| work());
        };
        let field = lift_clip(
            &self.model,
            &self.params,
            &clip,
            &robot,
            &conditioning,
            &mut phase,
            &mut warnings,
        )?;
        warnings.into_iter().for_each(|warning| context.warn(warning));
        context.timed("write", |context| context.write(&field))
    }
}

/// A phase of lifting, to be run by whoever observes it.
pub type Work<'w> = &'w mut dyn FnMut();

/// Lifts one clip. `phase` is called with the name of each phase and the fraction done before it, and must run the work it
/// is given; `warnings` collects what a person should know.
///
/// # Errors
/// When the inputs do not fit each other or the network.
pub fn lift_clip(
    model: &Model,
    params: &LiftParams,
    clip: &Clip,
    robot: &RobotMaps,
    conditioning: &Conditioning,
    phase: &mut dyn FnMut(&str, f64, Work<'_>),
    warnings: &mut Vec<String>,
) -> StageResult<Field> {
    params.validate()?;
    let mut run = Phases { phase };
    let source = Source::new(clip, robot, conditioning, params)?;
    let network = &model.network;
    let (frames, images) = source.frames(params, network.parameters.device());
    let encoded = run.phase("encode", 0.0, || network.encode(&frames))?;
    drop(frames);
    let base = run.phase("base heads", 0.3, || {
        lift_base(network, &encoded, &images, &source, params)
    })?;
    drop(images);
    let heads = MotionHeads::load(network, source.views.len()).map_err(stage_error)?;
    if params.fk_conditioning && !heads.has_fk_branch() {
        warnings.push("the weights have no FK-conditioning branch: motion is the visual displacement alone".into());
    }
    let slices = lift_slices(&mut run, &heads, &encoded, &base, &source, params)?;
    let keep = params.keeps_query_state(&model.info.configuration);
    let query_state = if keep {
        query::keep(&encoded).map_err(stage_error)?
    } else {
        Vec::new()
    };
    Ok(Field {
        clip_id: clip.clip_id.clone(),
        frame_count: clip.frame_count() as u32,
        height: clip.height,
        width: clip.width,
        views: source.views.iter().map(|view| view.view).collect(),
        recon_from_base: robot.recon_from_base,
        weights: model.info.clone(),
        position_m: base.position_m,
        base_raw: base.raw,
        support: base.support,
        link: base.link,
        scale_cap_iu: base.scale_cap_iu,
        slices,
        query_state,
    })
}

/// The field at every time that the clip asks for.
fn lift_slices(
    run: &mut Phases<'_>,
    heads: &MotionHeads,
    encoded: &Encoded,
    base: &Base,
    source: &Source<'_>,
    params: &LiftParams,
) -> StageResult<Vec<TimeSlice>> {
    // Kinematic transport of a field without anchoring follows the mask of the maps.
    let masked = if params.anchoring {
        Vec::new()
    } else {
        robot_links(source)
    };
    let anchor = Anchor {
        base_raw: &base.raw,
        link: if params.anchoring { &base.link } else { &masked },
    };
    let options = MotionOptions {
        gates: params.gates(),
        robot_motion: params.robot_motion,
    };
    let branch = if params.fk_conditioning {
        Branch::Maps
    } else {
        Branch::Zeros
    };
    let needs_robot = params.fk_conditioning || params.robot_motion == RobotMotion::Kinematics;
    let (area, frames) = (source.area(), source.clip.field_frames());
    let mut slices = Vec::with_capacity(frames.len());
    for (done, &frame) in frames.iter().enumerate() {
        let mut robot = Vec::with_capacity(source.views.len());
        for view in 0..source.views.len() {
            let positions = (!params.anchoring).then(|| &base.position_m[view * area * 3..][..area * 3]);
            robot.push(if needs_robot {
                Some(source.robot_at(view, frame, positions)?)
            } else {
                None
            });
        }
        let time = time_of_frame(frame, source.clip.frame_count());
        let fraction = 0.45 + 0.5 * done as f64 / frames.len() as f64;
        slices.push(run.phase("motion heads", fraction, || {
            heads.slice(encoded, &anchor, time, options, &robot, branch)
        })?);
    }
    Ok(slices)
}

/// Runs fallible phases through an observer of infallible ones.
struct Phases<'p> {
    phase: &'p mut dyn FnMut(&str, f64, Work<'_>),
}

impl Phases<'_> {
    fn phase<T>(
        &mut self,
        name: &str,
        fraction: f64,
        work: impl FnOnce() -> rogs_networks::Result<T>,
    ) -> StageResult<T> {
        let (mut work, mut result) = (Some(work), None);
        (self.phase)(name, fraction, &mut || result = work.take().map(|work| work()));
        let skipped = || StageError::internal(format!("the phase `{name}` was not run"));
        result.ok_or_else(skipped)?.map_err(stage_error)
    }
}

/// Link of every source pixel with valid support, whether anchored or not.
fn robot_links(source: &Source<'_>) -> Vec<u8> {
    let link = |map: &rogs_schemas::records::robot::RobotMap, pixel: usize| {
        source::mesh_depth_m(map, pixel).map_or(rogs_schemas::records::robot::NO_LINK, |_| map.link[pixel])
    };
    source
        .views
        .iter()
        .flat_map(|view| (0..source.area()).map(move |pixel| link(view.map, pixel)))
        .collect()
}

/// A network error as a failure of the stage.
pub(crate) fn stage_error(error: Error) -> StageError {
    match error {
        Error::Io { .. } => StageError::io(error.to_string()),
        Error::BadConfiguration(_) => StageError::bad_params(error.to_string()),
        _ => StageError::bad_input(error.to_string()),
    }
}
