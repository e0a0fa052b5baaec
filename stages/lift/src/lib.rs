//! Lift (Stage 1): clip, robot maps and conditioning to a time-queryable field.
//!
//! The network sees all source views of a clip at once; the field has one Gaussian per source pixel. Robot pixels are
//! anchored on the mesh, their motion is conditioned on forward kinematics, and the field is stored at every time that the
//! clip asks for. [`FieldQuery`] answers other times. Interventions of the paper's ablations are parameters
//! ([`LiftParams`]).

mod bundled;
mod camera_wise;
pub mod latents;
mod lifting;
mod model;
mod params;
mod parity;
mod query;
mod rgb;
mod source;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub use bundled::{BUILTIN, BUILTIN_SCENES, BUILTIN_SIZE, COMPACT_WEIGHTS, builtin_of, sees_robot};
use burn::tensor::{Device, Tensor};
pub use lifting::MotionOptions;
pub use model::{Model, Models, load_builtin, load_model};
pub use params::{CrossCamera, LiftParams, ProductPrecision, QueryState, RobotMotion, TokenSource};
pub use query::FieldQuery;
use rogs_r4c::Record;
use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::{Clip, time_of_frame};
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::field::{Field, NamedArray, TimeSlice};
use rogs_schemas::records::references::References;
use rogs_schemas::records::robot::RobotMaps;
use rogs_stage1::{Encoded, SourceFrames, Stage1};
use rogs_tensors::Error;
use rogs_tensors::parameters::Parameters;
use rogs_worker::{Context, Observer, Stage, StageError, StageResult};
pub use source::RobotAtTime;

use crate::lifting::{Anchor, Base, Branch, MotionHeads, lift_base};
use crate::source::Source;

/// The stage: loaded networks, clip after clip.
pub struct Lift {
    params: LiftParams,
    models: Models,
    /// Weights of the latent adapter.
    adapter: Option<Parameters>,
}

impl Stage for Lift {
    const NAME: &'static str = "lift";
    const SUMMARY: &'static str = "Lifts the source views of a clip to a time-queryable Gaussian field (Stage 1)";
    const VERSION: u32 = 3;
    const OUTPUT: SchemaId = <Field as Record>::SCHEMA;
    type Params = LiftParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::required("conditioning", Conditioning::SCHEMA.name),
            InputDescription::optional("references", References::SCHEMA.name),
            InputDescription::optional("weights", "file"),
            InputDescription::optional("latents", "file"),
            InputDescription::optional("adapter", "file"),
        ]
    }

    fn load(params: &LiftParams, inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        params.validate()?;
        let weights = inputs.get("weights").map(PathBuf::as_path);
        let adapter = inputs.get("adapter");
        let mut models = Models::load(params, weights, adapter.is_some())?;
        let adapter = match adapter {
            Some(path) => {
                let (file, model) = (path.file_name().unwrap_or_default().to_string_lossy(), models.own_mut());
                model.info.description = format!("{}; latent adapter {file}", model.info.description);
                Some(latents::open_adapter(path, model.network.parameters.device())?)
            }
            None => None,
        };
        Ok(Self {
            params: params.clone(),
            models,
            adapter,
        })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let mut clip: Clip = context.read("clip")?;
        self.complete(&mut clip, context)?;
        let robot: RobotMaps = context.read("robot")?;
        let model = self.models.of_clip(&self.params, &robot)?;
        if !model.info.trained {
            context.warn(format!(
                "THE STAGE-1 WEIGHTS ARE NOT TRAINED ({}): depth, colour and motion of this field are not predictions",
                model.info.description
            ));
        }
        if let Some(warning) = model.out_of_distribution(&clip) {
            context.warn(warning);
        }
        if let Some(warning) = model.other_size(&clip) {
            context.warn(warning);
        }
        let conditioning: Conditioning = context.read("conditioning")?;
        let latents = context.optional_input("latents").map(PathBuf::from);
        let inputs = ClipInputs {
            latents: latents.as_deref(),
            adapter: self.adapter.as_ref(),
            ..ClipInputs::new(&clip, &robot, &conditioning)
        };
        let field = lift_clip(model, &self.params, inputs, context)?;
        context.timed("write", |context| context.write(&field))
    }
}

impl Lift {
    /// Puts depth that the pipeline made into a clip that is lifted camera by camera: its scales are taken from that.
    fn complete(&self, clip: &mut Clip, context: &mut Context<'_>) -> StageResult<()> {
        if context.optional_input("references").is_none() {
            return Ok(());
        }
        if self.params.attention != CrossCamera::CameraWise {
            context
                .warn("the input `references` is not read: only `attention = \"camera-wise\"` takes a scale from it");
            return Ok(());
        }
        let references: References = context.read("references")?;
        references.complete(clip).map_err(StageError::bad_input)
    }
}

/// What a clip is lifted from.
#[derive(Clone, Copy)]
pub struct ClipInputs<'a> {
    /// The clip.
    pub clip: &'a Clip,
    /// Its robot maps.
    pub robot: &'a RobotMaps,
    /// Its conditioning maps.
    pub conditioning: &'a Conditioning,
    /// File of its latents, where tokens are made from latents.
    pub latents: Option<&'a Path>,
    /// Weights that make tokens of them ([`latents::open_adapter`]).
    pub adapter: Option<&'a Parameters>,
}

impl<'a> ClipInputs<'a> {
    /// What a clip without latents is lifted from.
    #[must_use]
    pub fn new(clip: &'a Clip, robot: &'a RobotMaps, conditioning: &'a Conditioning) -> Self {
        Self {
            clip,
            robot,
            conditioning,
            latents: None,
            adapter: None,
        }
    }
}

/// What the network sees of a clip, and its latents on the grid of 2 x 2 cells per token (`[S, 48, 2 rows, 2 columns]`), for
/// the training of an adapter. Tensors lie on `device`; `inputs.adapter` is not read.
///
/// # Errors
/// When the inputs do not fit each other, the network or its token grid, or there are no latents.
pub fn latent_inputs(
    network: &Stage1,
    params: &LiftParams,
    inputs: ClipInputs<'_>,
    device: &Device,
) -> StageResult<(SourceFrames, Tensor<4>)> {
    let source = Source::new(inputs.clip, inputs.robot, inputs.conditioning, params)?;
    let path = (inputs.latents).ok_or_else(|| StageError::bad_input("the clip comes without latents"))?;
    let cells = latents::cells(path, network, &source, params, device)?;
    Ok((source.frames(params, device).0, cells))
}

/// Lifts one clip. `observer` hears each phase (`encode`, `base heads`, `motion heads`) and what a person should know.
///
/// # Errors
/// When the inputs do not fit each other or the network, and when latents or their adapter are needed and missing.
pub fn lift_clip(
    model: &Model,
    params: &LiftParams,
    inputs: ClipInputs<'_>,
    observer: &mut dyn Observer,
) -> StageResult<Field> {
    params.validate()?;
    let ClipInputs {
        clip,
        robot,
        conditioning,
        latents,
        adapter,
    } = inputs;
    let source = Source::new(clip, robot, conditioning, params)?;
    let mut lifting = Lifting {
        model,
        params,
        observer,
    };
    let mut weights = model.info.clone();
    let (base, slices, query_state) = if params.attention == CrossCamera::CameraWise {
        let camera_wise::Merged { base, slices, scales } = camera_wise::lift(&mut lifting, &source)?;
        weights.description = format!("{}; {scales}", weights.description);
        (base, slices, Vec::new())
    } else {
        lifting.jointly(&source, latents, adapter)?
    };
    Ok(Field {
        clip_id: clip.clip_id.clone(),
        frame_count: clip.frame_count() as u32,
        height: clip.height,
        width: clip.width,
        views: source.views.iter().map(|view| view.view).collect(),
        recon_from_base: robot.recon_from_base,
        weights,
        position_m: base.position_m,
        base_raw: base.raw,
        support: base.support,
        link: base.link,
        scale_cap_iu: base.scale_cap_iu,
        slices,
        query_state,
    })
}

/// How clips are lifted, and who hears of it.
struct Lifting<'a> {
    model: &'a Model,
    params: &'a LiftParams,
    observer: &'a mut dyn Observer,
}

impl Lifting<'_> {
    /// All cameras in one pass of the network: the base field, its state at the stored times, and what answers others.
    fn jointly(
        &mut self,
        source: &Source<'_>,
        latents: Option<&Path>,
        adapter: Option<&Parameters>,
    ) -> StageResult<(Base, Vec<TimeSlice>, Vec<NamedArray>)> {
        let (network, params) = (&self.model.network, self.params);
        let (frames, images) = source.frames(params, network.parameters.device());
        let encoded = match params.tokens {
            TokenSource::Rgb => self.phase("encode", 0.0, || network.encode(&frames))?,
            TokenSource::Latents => {
                let missing = |what: &str| {
                    StageError::bad_input(format!("`tokens = \"latents\"` needs the input `{what}`")).with_hint(
                        "name a file for it (in a run: CLIP.safetensors in the [latents] folder), or set `tokens` to \"rgb\"",
                    )
                };
                let path = latents.ok_or_else(|| missing("latents"))?;
                let adapter = adapter.ok_or_else(|| missing("adapter"))?;
                let tokens = latents::tokens(path, adapter, network, source, params)?;
                self.phase("encode", 0.0, || network.encode_tokens(&frames, tokens))?
            }
        };
        drop(frames);
        let base = self.phase("base heads", 0.3, || {
            lift_base(network, &encoded, &images, source, params)
        })?;
        drop(images);
        let heads = MotionHeads::load(network, source.views.len()).map_err(stage_error)?;
        if params.fk_conditioning && !heads.has_fk_branch() {
            let warning = "the weights have no FK-conditioning branch: motion is the visual displacement alone";
            self.observer.warn(warning.into());
        }
        let slices = self.slices(source, &heads, &encoded, &base)?;
        let query_state = if params.keeps_query_state(&self.model.info.configuration) {
            query::keep(&encoded).map_err(stage_error)?
        } else {
            Vec::new()
        };
        Ok((base, slices, query_state))
    }

    /// The field at every time that the clip asks for.
    fn slices(
        &mut self,
        source: &Source<'_>,
        heads: &MotionHeads,
        encoded: &Encoded,
        base: &Base,
    ) -> StageResult<Vec<TimeSlice>> {
        let params = self.params;
        // Kinematic transport of a field without anchoring follows the mask of the maps.
        let masked = if params.anchoring {
            Vec::new()
        } else {
            robot_links(source)
        };
        let held = if params.fk_conditioning && heads.has_held_gate() {
            let path = source.held_path()?;
            if path.is_none() {
                let warning = "no link of the robot carries the tool centre: nothing follows the gripper";
                self.observer.warn(warning.into());
            }
            path
        } else {
            None
        };
        let anchor = Anchor {
            position_m: &base.position_m,
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
                    Some(source.robot_at(view, frame, positions, held.as_ref())?)
                } else {
                    None
                });
            }
            let time = time_of_frame(frame, source.clip.frame_count());
            let fraction = 0.45 + 0.5 * done as f64 / frames.len() as f64;
            slices.push(self.phase("motion heads", fraction, || {
                heads.slice(encoded, &anchor, time, options, &robot, branch)
            })?);
        }
        Ok(slices)
    }

    /// Runs a phase of the network that may fail.
    fn phase<T>(
        &mut self,
        name: &str,
        fraction: f64,
        work: impl FnOnce() -> rogs_tensors::Result<T>,
    ) -> StageResult<T> {
        self.observer.phase(name, fraction, work).map_err(stage_error)
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
pub(crate) fn stage_error(error: impl Into<Error>) -> StageError {
    let error = error.into();
    match error {
        Error::Weights(rogs_weights::Error::Io { .. }) => StageError::io(error.to_string()),
        Error::BadConfiguration(_) | Error::Device(_) => StageError::bad_params(error.to_string()),
        _ => StageError::bad_input(error.to_string()),
    }
}
