//! Training of Stage 2, the refiner, on fields that a trained Stage 1 lifts from procedural clips
//! (`stage2-network.md` section B.8).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use rogs_lift::{LiftParams, load_model};
use rogs_networks::parameters::{Parameters, to_host};
use rogs_networks::stage2::objective::ObjectiveWeights;
use rogs_networks::stage2::weights::is_trained;
use rogs_networks::stage2::{Refiner, RefinerConfig, read_weights, seeded_parameters, verify_parameters};
use rogs_random::Pcg64;
use rogs_refine::training::{TermValues, TrainingOptions, training_step};
use rogs_refine::{ClipInputs, LoadedRefiner, RefineParams, refine};
use rogs_schemas::key::CacheKey;
use rogs_schemas::records::clip::{Clip, time_of_frame};
use rogs_schemas::records::field::{Field, WeightsInfo};
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_splat::{Camera, RasterConfig, TimedField, render};
use serde::{Deserialize, Serialize};

use crate::checkpoint::State;
use crate::config::{self, DataSettings};
use crate::error::{Error, Result};
use crate::optimiser::{Gradients, Moments, Rule, schedule, update};
use crate::records::Records;
use crate::run::{Course, Evaluation, Picture, Rhythm, UpdateReport};
use crate::sample::{ClipPlan, SOURCE_CAMERAS};
use crate::stream::Stream;

/// A Stage-2 training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stage2Training {
    /// Size of the refiner: `paper`, `cpu` or `ci`.
    pub preset: String,
    /// Weights of the Stage 1 whose fields are refined.
    pub lift: PathBuf,
    /// Weights to start from; without them, seeded ones whose last layer is zero.
    pub start: Option<PathBuf>,
    /// Seed of weights and data order.
    pub seed: u64,
    /// Updates of the parameters in the whole schedule.
    pub steps: u64,
    /// A checkpoint is written every so many updates.
    pub checkpoint_every: u64,
    /// Held-out clips are scored every so many updates.
    pub evaluate_every: u64,
    /// Held-out clips that are scored.
    pub evaluation_clips: u64,
    /// Fewest and most recurrent updates of a clip.
    pub recurrence: [u32; 2],
    /// Where clips come from.
    pub data: DataSettings,
    /// Peak rate of the updater.
    pub rate: f64,
    /// Peak rate of the residual gates.
    pub gate_rate: f64,
    /// Updates over which the rates rise.
    pub warmup: u64,
    /// Decoupled weight decay of matrices.
    pub weight_decay: f64,
    /// Largest norm of all gradients together.
    pub clip: f64,
    /// Weights of the losses.
    pub losses: Stage2Losses,
}

/// Weights of the losses of Stage 2; the perceptual one needs the user's LPIPS weights and is left out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stage2Losses {
    /// Absolute colour difference.
    pub rendering: f64,
    /// Relative metric depth.
    pub depth: f64,
    /// Robot position against forward kinematics.
    pub robot: f64,
    /// Rendered motion against tracks.
    pub motion: f64,
    /// Rendered motion against that of Stage 1.
    pub preservation: f64,
    /// Missing opacity, source views.
    pub coverage: f64,
    /// Missing opacity, right views.
    pub coverage_right: f64,
}

impl Default for Stage2Losses {
    fn default() -> Self {
        let weights = ObjectiveWeights::default();
        Self {
            rendering: weights.rendering,
            depth: weights.depth,
            robot: weights.robot,
            motion: weights.motion,
            preservation: weights.preservation,
            coverage: weights.coverage,
            coverage_right: weights.coverage_right,
        }
    }
}

impl From<Stage2Losses> for ObjectiveWeights {
    fn from(losses: Stage2Losses) -> Self {
        Self {
            rendering: losses.rendering,
            perceptual: 0.0,
            depth: losses.depth,
            robot: losses.robot,
            motion: losses.motion,
            preservation: losses.preservation,
            coverage: losses.coverage,
            coverage_right: losses.coverage_right,
            ..Self::default()
        }
    }
}

/// Terms after the last update, and the colour difference after the first one.
fn terms_of(updates: &[TermValues]) -> BTreeMap<String, f64> {
    let mut terms = BTreeMap::new();
    if let (Some(first), Some(last)) = (updates.first(), updates.last()) {
        for (key, value) in [
            ("rendering after the first update", first.rendering),
            ("rendering", last.rendering),
            ("depth", last.depth),
            ("robot", last.robot),
            ("motion", last.motion),
            ("preservation", last.preservation),
            ("coverage", last.coverage),
            ("coverage_right", last.coverage_right),
        ] {
            terms.insert(key.to_owned(), value);
        }
    }
    terms
}

impl Default for Stage2Training {
    fn default() -> Self {
        Self {
            preset: "cpu".into(),
            lift: PathBuf::new(),
            start: None,
            seed: 73,
            steps: 2000,
            checkpoint_every: 50,
            evaluate_every: 200,
            evaluation_clips: 4,
            recurrence: [1, 4],
            data: DataSettings {
                queries: 3,
                images_per_step: 15,
                ..DataSettings::default()
            },
            rate: 1e-4,
            gate_rate: 1.521e-4,
            warmup: 100,
            weight_decay: 0.01,
            clip: 0.5,
            losses: Stage2Losses::default(),
        }
    }
}

impl Stage2Training {
    /// Reads a TOML file. Relative paths are taken from the file's folder.
    ///
    /// # Errors
    /// As [`crate::Stage1Training::read`].
    pub fn read(path: &Path) -> Result<Self> {
        let mut settings: Self = config::read_toml(path)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        settings.lift = config::absolute(&folder.join(&settings.lift))?;
        if let Some(start) = &settings.start {
            settings.start = Some(config::absolute(&folder.join(start))?);
        }
        settings.check()?;
        Ok(settings)
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of its range.
    pub fn check(&self) -> Result<()> {
        let network = RefinerConfig::preset(&self.preset)?;
        let wrong = |what, value: String, rule| Err(Error::Setting { what, value, rule });
        if self.steps == 0 || self.checkpoint_every == 0 || self.evaluate_every == 0 {
            return wrong(
                "steps",
                self.steps.to_string(),
                "at least 1, and so must both intervals be",
            );
        }
        let [fewest, most] = self.recurrence;
        if fewest < 1 || fewest > most || most > rogs_refine::MOST_UPDATES {
            return wrong(
                "recurrence",
                format!("{fewest} to {most}"),
                "at least 1, ascending, at most 64",
            );
        }
        let block = network.token_block as u32;
        if self.data.size.iter().any(|side| !side.is_multiple_of(block)) {
            let [height, width] = self.data.size;
            return wrong(
                "data.size",
                format!("{height} x {width}"),
                "a multiple of the token block",
            );
        }
        let losses = &self.losses;
        let weights = [
            losses.rendering,
            losses.depth,
            losses.robot,
            losses.motion,
            losses.preservation,
            losses.coverage,
            losses.coverage_right,
        ];
        if weights.iter().any(|weight| !weight.is_finite() || *weight < 0.0) {
            return wrong("losses", format!("{weights:?}"), "finite and not negative");
        }
        let numbers = [self.rate, self.gate_rate, self.weight_decay];
        if numbers.iter().any(|number| !(0.0..=10.0).contains(number)) || self.clip.is_nan() || self.clip <= 0.0 {
            return wrong("rate", format!("{numbers:?}"), "from 0 to 10, with a positive clip");
        }
        self.data.check(14)
    }
}

/// A clip and the field that Stage 1 makes of it.
pub struct Lifted {
    records: Records,
    field: Field,
    /// Query frames.
    frames: Vec<u32>,
}

/// Lifts clips with one loaded network.
struct Lifter {
    model: rogs_lift::Model,
    params: LiftParams,
}

impl Lifter {
    fn load(weights: &Path) -> Result<Self> {
        let params = LiftParams::default();
        let model = load_model(&params, Some(weights)).map_err(stage)?;
        Ok(Self { model, params })
    }

    fn lift(&self, plan: &ClipPlan, data: &DataSettings) -> Result<Lifted> {
        let records = plan.or_another(|plan| plan.records(data))?;
        let (clip, robot, conditioning) = (&records.clip, &records.robot, &records.conditioning);
        let mut run = |_: &str, _: f64, work: rogs_lift::Work<'_>| work();
        let field = rogs_lift::lift_clip(
            &self.model,
            &self.params,
            clip,
            robot,
            conditioning,
            &mut run,
            &mut Vec::new(),
        );
        Ok(Lifted {
            frames: plan.queries.clone(),
            field: field.map_err(stage)?,
            records,
        })
    }
}

impl Lifted {
    fn inputs(&self) -> ClipInputs<'_> {
        ClipInputs {
            clip: &self.records.clip,
            robot: &self.records.robot,
            field: &self.field,
            field_key: CacheKey([0; 16]),
            resume: None,
        }
    }
}

/// A run between two updates.
pub struct Stage2Trainer {
    settings: Stage2Training,
    config: RefinerConfig,
    parameters: Parameters,
    moments: Moments,
    step: u64,
}

impl Stage2Trainer {
    /// A run before its first update.
    ///
    /// # Errors
    /// When settings are wrong or the weights to start from cannot be read.
    pub fn new(settings: Stage2Training) -> Result<Self> {
        settings.check()?;
        let config = RefinerConfig::preset(&settings.preset)?;
        let device = Device::flex().autodiff();
        let parameters = match &settings.start {
            Some(path) => {
                let mut parameters = read_weights(path, &config, &device)?;
                verify_parameters(&mut parameters, &config, settings.seed)?;
                parameters
            }
            None => seeded_parameters(&config, settings.seed, &device)?,
        };
        Ok(Self {
            settings,
            config,
            parameters,
            moments: Moments::default(),
            step: 0,
        })
    }

    fn params(&self, updates: u32) -> RefineParams {
        RefineParams {
            preset: self.settings.preset.clone(),
            updates: Some(updates),
            keep_intermediate: true,
            ..RefineParams::default()
        }
    }

    /// The refiner on a copy of the parameters; the trained ones are leaves that record gradients when asked to.
    fn refiner(&self, tracked: bool) -> Result<(Parameters, Refiner)> {
        let device = if tracked {
            Device::flex().autodiff()
        } else {
            Device::flex()
        };
        let mut copy = Parameters::new(&device);
        for name in self.parameters.names() {
            let shape = self.parameters.shape(&name).map(<[usize]>::to_vec).unwrap_or_default();
            copy.insert(&name, &shape, self.parameters.host(&name)?)?;
        }
        if tracked {
            for (_, parameter) in copy.memory_mut().iter_mut().filter(|(name, _)| is_trained(name)) {
                parameter.values = parameter.values.clone().require_grad();
            }
        }
        let refiner = Refiner::load(&copy, &self.config)?;
        Ok((copy, refiner))
    }
}

impl Course for Stage2Trainer {
    type Settings = Stage2Training;
    type Batch = Lifted;

    const TITLE: &'static str = "Training of Stage 2";
    const PICTURE: &'static str = "Seen, Stage 1, refined; the three source cameras at the first source time.";

    fn settings(&self) -> &Stage2Training {
        &self.settings
    }

    fn rhythm(&self) -> Rhythm {
        Rhythm {
            steps: self.settings.steps,
            checkpoint_every: self.settings.checkpoint_every,
            evaluate_every: self.settings.evaluate_every,
        }
    }

    fn state(&mut self) -> State<'_> {
        State {
            parameters: &mut self.parameters,
            moments: &mut self.moments,
            step: &mut self.step,
        }
    }

    fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    fn moments(&self) -> &Moments {
        &self.moments
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn stream(&self) -> Result<Stream<Lifted>> {
        let (settings, lifter) = (self.settings.clone(), Lifter::load(&self.settings.lift)?);
        Ok(Stream::start(self.step..settings.steps, move |step| {
            let data = &settings.data;
            let mut random = Pcg64::from_seeds(&[settings.seed, 2, step]);
            let [fewest, most] = data.source_times;
            let times = fewest + (random.next_double() * f64::from(most - fewest + 1)) as u32;
            let plan = ClipPlan::draw(data.first_seed + step, times.min(most), data, &mut random);
            lifter.lift(&plan, data)
        }))
    }

    fn update(&mut self, batch: &Lifted) -> Result<UpdateReport> {
        let [fewest, most] = self.settings.recurrence;
        let draw = Pcg64::from_seeds(&[self.settings.seed, 3, self.step]).next_double();
        let updates = (fewest + (draw * f64::from(most - fewest + 1)) as u32).min(most);
        let (leaves, refiner) = self.refiner(true)?;
        let options = TrainingOptions {
            weights: self.settings.losses.into(),
            frames: &batch.frames,
            right_views: true,
            perceptual: None,
        };
        let result = training_step(batch.inputs(), &refiner, &self.params(updates), &options).map_err(stage)?;
        if !result.objective.is_finite() {
            return Err(Error::Diverged {
                step: self.step,
                what: format!("the objective of clip `{}`", batch.records.clip.clip_id),
            });
        }
        let graph = result.surrogate.backward();
        let mut gradients = Gradients::new();
        for (name, parameter) in leaves.memory().iter().filter(|(name, _)| is_trained(name)) {
            if let Some(gradient) = parameter.values.grad(&graph) {
                gradients.insert(name.clone(), to_host(gradient)?);
            }
        }
        let settings = &self.settings;
        let rule = Rule {
            rate: &|name| {
                let gate = name == "encoder.update_gate.logit";
                is_trained(name).then_some(if gate { settings.gate_rate } else { settings.rate })
            },
            share: schedule(self.step, settings.steps, settings.warmup),
            betas: [0.9, 0.999],
            weight_decay: &|shape| if shape.len() > 1 { settings.weight_decay } else { 0.0 },
            clip: settings.clip,
        };
        let gradient_norm = update(&mut self.parameters, &mut self.moments, &gradients, &rule, self.step)?;
        let report = UpdateReport {
            step: self.step,
            loss: result.objective,
            terms: terms_of(&result.terms),
            gradient_norm,
            images: batch.field.views.len(),
        };
        self.step += 1;
        Ok(report)
    }

    fn evaluate(&self) -> Result<Evaluation> {
        let settings = &self.settings;
        let mut evaluation = Evaluation::default();
        if settings.evaluation_clips == 0 {
            return Ok(evaluation);
        }
        let most = settings.recurrence[1];
        let (_, refiner) = self.refiner(false)?;
        let network = LoadedRefiner {
            refiner,
            info: WeightsInfo {
                trained: self.step > 0,
                configuration: settings.preset.clone(),
                description: String::new(),
                hash: String::new(),
            },
            warnings: Vec::new(),
        };
        let lifter = Lifter::load(&settings.lift)?;
        for index in 0..settings.evaluation_clips {
            let plan = ClipPlan::evaluation(settings.data.held_out_seed + index, &settings.data);
            let lifted = lifter.lift(&plan, &settings.data)?;
            let refinement = refine(lifted.inputs(), &network, &self.params(most), &mut |_, _| {}).map_err(stage)?;
            for updates in 0..=most {
                for (name, frames, cameras) in [
                    ("source", &plan.sources, 0..SOURCE_CAMERAS),
                    ("novel", &plan.queries, SOURCE_CAMERAS..2 * SOURCE_CAMERAS),
                ] {
                    let views: Vec<(u32, usize)> = (frames.iter())
                        .flat_map(|&frame| cameras.clone().map(move |camera| (frame, camera)))
                        .collect();
                    let mut sum = 0.0;
                    for &(frame, camera) in &views {
                        let image = view(&lifted, &refinement, updates, frame, camera)?;
                        sum += peak_signal(&image, &seen(&lifted.records.clip, frame, camera));
                    }
                    let key = format!("{name} PSNR after {updates} updates");
                    *evaluation.scores.entry(key).or_insert(0.0) +=
                        sum / (views.len() as f64 * settings.evaluation_clips as f64);
                }
            }
            if evaluation.picture.is_none() {
                evaluation.picture = Some(picture(&lifted, &refinement, most, plan.sources[0])?);
            }
        }
        Ok(evaluation)
    }

    fn metadata(&self, time: &str) -> BTreeMap<String, String> {
        let [height, width] = self.settings.data.size;
        let provenance = format!(
            "Stage 2 `{}`, trained by rogs-train on procedural clips only, {} updates at {height} x {width}{time}",
            self.settings.preset, self.step
        );
        BTreeMap::from([(rogs_networks::checkpoint::PROVENANCE.to_owned(), provenance)])
    }
}

/// A view of the field after some updates, RGB in 0..1. `[A, 3]`
fn view(lifted: &Lifted, refinement: &Refinement, updates: u32, frame: u32, camera: usize) -> Result<Vec<f32>> {
    let Lifted { records, field, .. } = lifted;
    let timed = TimedField::new(field)?;
    let timed = match refinement.steps.iter().find(|step| step.update == updates) {
        Some(step) => timed.with_correction(step, refinement.scale_residual)?,
        None => timed,
    };
    let frames = records.clip.frame_count();
    let scene = timed.gaussians(time_of_frame(frame, frames))?;
    let pose = &records.robot.base_from_camera[camera * frames + frame as usize];
    let camera_in_base = Camera::from_world_pose(
        field.width,
        field.height,
        &records.clip.cameras[camera].intrinsics,
        &compose(&records.robot.recon_from_base, pose),
        UNITS_PER_METRE,
    );
    Ok(render(&scene, &camera_in_base, &RasterConfig::default())?.rgb)
}

/// a_from_c of a_from_b and b_from_c.
fn compose(a: &rogs_schemas::RigidPose, b: &rogs_schemas::RigidPose) -> rogs_schemas::RigidPose {
    let (ra, rb) = (&a.rotation, &b.rotation);
    let dot = |row: usize, column: usize| (0..3).map(|k| ra[3 * row + k] * rb[3 * k + column]).sum();
    let moved = |row: usize| (0..3).map(|k| ra[3 * row + k] * b.translation[k]).sum::<f64>() + a.translation[row];
    rogs_schemas::RigidPose {
        rotation: std::array::from_fn(|index| dot(index / 3, index % 3)),
        translation: std::array::from_fn(moved),
    }
}

/// What a camera saw, RGB in 0..1. `[A, 3]`
fn seen(clip: &Clip, frame: u32, camera: usize) -> Vec<f32> {
    let length = 3 * clip.height as usize * clip.width as usize;
    let images = clip.cameras[camera].rgb.as_deref().unwrap_or_default();
    images[frame as usize * length..][..length]
        .iter()
        .map(|&value| f32::from(value) / 255.0)
        .collect()
}

fn peak_signal(image: &[f32], reference: &[f32]) -> f64 {
    let square = image
        .iter()
        .zip(reference)
        .map(|(a, b)| f64::from(a.clamp(0.0, 1.0) - b).powi(2));
    -10.0 * libm::log10((square.sum::<f64>() / reference.len() as f64).max(1e-10))
}

/// Rows: seen, Stage 1, refined; columns: the source cameras.
fn picture(lifted: &Lifted, refinement: &Refinement, updates: u32, frame: u32) -> Result<Picture> {
    let clip = &lifted.records.clip;
    let (height, width) = (clip.height as usize, clip.width as usize);
    let row = 3 * SOURCE_CAMERAS * width;
    let mut rgb = vec![0u8; 3 * height * row];
    for camera in 0..SOURCE_CAMERAS {
        let images = [
            seen(clip, frame, camera),
            view(lifted, refinement, 0, frame, camera)?,
            view(lifted, refinement, updates, frame, camera)?,
        ];
        for (block, image) in images.iter().enumerate() {
            for (y, line) in image.chunks_exact(3 * width).enumerate() {
                let out = &mut rgb[(block * height + y) * row + 3 * camera * width..][..3 * width];
                (out.iter_mut().zip(line)).for_each(|(out, &value)| *out = (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8);
            }
        }
    }
    Ok(Picture {
        width: (SOURCE_CAMERAS * width) as u32,
        height: (3 * height) as u32,
        rgb,
    })
}

/// An error of a stage's library.
fn stage(error: rogs_worker::StageError) -> Error {
    Error::Stage(error.to_string())
}
