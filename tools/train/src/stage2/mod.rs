//! Training of Stage 2, the refiner, on fields that a trained Stage 1 lifts from procedural clips
//! (`docs/spec/stage2.md` section B.8).

mod lifted;
mod settings;
mod views;

use std::collections::BTreeMap;

use burn::tensor::{Device, Tensor};
use rogs_lpips::LpipsTensors;
use rogs_random::Pcg64;
use rogs_refine::training::{AdamW, TermValues, TrainingOptions, training_step};
use rogs_refine::{LoadedRefiner, RefineParams, refine};
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_stage2::objective::{Perceptual, RenderedView};
use rogs_stage2::{Refiner, RefinerConfig, read_weights, seeded_parameters, verify_parameters};
use rogs_tensors::optimiser::{self, Moments, schedule};
use rogs_tensors::parameters::Parameters;
use rogs_worker::Unobserved;

pub use self::lifted::LiftedClip;
use self::lifted::Lifter;
pub use self::settings::Stage2Training;
use self::views::{picture, seen, view};
use crate::checkpoint::State;
use crate::config::{Cadence, check_precision};
use crate::error::{Error, Result};
use crate::perceptual::perceptual;
use crate::picture::peak_signal;
use crate::plan::ClipPlan;
use crate::plan::SOURCE_CAMERAS;
use crate::props::props;
use crate::run::{Evaluation, Trainer, UpdateReport};
use crate::stream::Stream;

/// Terms after the last update, and the colour difference after the first one.
fn terms_of(updates: &[TermValues]) -> BTreeMap<String, f64> {
    let mut terms = BTreeMap::new();
    if let (Some(first), Some(last)) = (updates.first(), updates.last()) {
        for (key, value) in [
            ("rendering after the first update", first.rendering),
            ("rendering", last.rendering),
            ("rendering_squared", last.rendering_squared),
            ("perceptual", last.perceptual),
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

/// A run between two updates.
pub struct Stage2Trainer {
    settings: Stage2Training,
    config: RefinerConfig,
    parameters: Parameters,
    optimiser: AdamW,
    perceptual: Option<LpipsTensors>,
}

impl Stage2Trainer {
    /// A run before its first update, on a device of its own kind with gradients. Fields are lifted there too.
    ///
    /// # Errors
    /// When settings are wrong or the weights to start from cannot be read.
    pub fn new(settings: Stage2Training, device: &Device) -> Result<Self> {
        settings.check()?;
        check_precision(settings.precision, device)?;
        props(&settings.data)?;
        let config = RefinerConfig::preset(&settings.preset)?;
        let device = device.clone().autodiff();
        let mut parameters = match &settings.start {
            Some(path) => {
                let mut parameters = read_weights(path, &config, &device)?;
                verify_parameters(&mut parameters, &config, settings.seed)?;
                parameters
            }
            None => seeded_parameters(&config, settings.seed, &device)?,
        };
        parameters.set_products(settings.precision.into());
        let perceptual = perceptual(settings.lpips.as_deref(), &device)?;
        let optimiser = AdamW {
            weight_decay: settings.weight_decay,
            clip: settings.clip,
            ..AdamW::default()
        };
        Ok(Self {
            settings,
            config,
            parameters,
            optimiser,
            perceptual,
        })
    }

    fn lifter(&self) -> Result<Lifter> {
        Lifter::load(&self.settings.lift, self.parameters.device())
    }

    fn params(&self, updates: u32) -> RefineParams {
        RefineParams {
            preset: self.settings.preset.clone(),
            updates: Some(updates),
            keep_intermediate: true,
            ..RefineParams::default()
        }
    }

    /// The refiner on a copy of the parameters, which may record gradients.
    fn refiner(&self, tracked: bool) -> Result<(Parameters, Refiner)> {
        let copy = if tracked {
            let mut copy = self
                .parameters
                .with_leaves(self.parameters.device(), |_, values| values);
            AdamW::track(&mut copy);
            copy
        } else {
            self.parameters.without_gradients()
        };
        let refiner = Refiner::load(&copy, &self.config)?;
        Ok((copy, refiner))
    }
}

impl Trainer for Stage2Trainer {
    type Settings = Stage2Training;
    type Batch = LiftedClip;

    const TITLE: &'static str = "Training of Stage 2";
    const PICTURE: &'static str = "Seen, Stage 1, refined; the three source cameras at the first source time.";

    fn settings(&self) -> &Stage2Training {
        &self.settings
    }

    fn cadence(&self) -> Cadence {
        self.settings.cadence()
    }

    fn state(&mut self) -> State<'_> {
        State {
            parameters: &mut self.parameters,
            moments: &mut self.optimiser.moments,
            step: &mut self.optimiser.steps,
        }
    }

    fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    fn moments(&self) -> &Moments {
        &self.optimiser.moments
    }

    fn step(&self) -> u64 {
        self.optimiser.steps
    }

    fn stream(&self) -> Result<Stream<LiftedClip>> {
        let (settings, lifter) = (self.settings.clone(), self.lifter()?);
        Ok(Stream::start(self.step()..settings.steps, move |step| {
            let data = &settings.data;
            let mut random = Pcg64::from_seeds(&[settings.seed, 2, step]);
            let [fewest, most] = data.source_times;
            let times = fewest + (random.next_double() * f64::from(most - fewest + 1)) as u32;
            let plan = ClipPlan::draw(data.first_seed + step, times.min(most), data, &mut random);
            lifter.lift(&plan, data)
        }))
    }

    fn update(&mut self, batch: &LiftedClip) -> Result<UpdateReport> {
        let [fewest, most] = self.settings.recurrence;
        let draw = Pcg64::from_seeds(&[self.settings.seed, 3, self.step()]).next_double();
        let updates = (fewest + (draw * f64::from(most - fewest + 1)) as u32).min(most);
        let (leaves, refiner) = self.refiner(true)?;
        let [height, width] = self.settings.data.size.map(|side| side as usize);
        let distance = self.perceptual.as_ref().map(|network| {
            let planar = move |rgb: &Tensor<2>| rgb.clone().reshape([1, height, width, 3]).permute([0, 3, 1, 2]);
            move |view: &RenderedView| network.distance(planar(&view.rgb), planar(&view.observed_rgb))
        });
        let options = TrainingOptions {
            weights: self.settings.losses,
            frames: &batch.frames,
            right_views: true,
            perceptual: distance.as_ref().map(|distance| distance as Perceptual<'_>),
        };
        let result = training_step(batch.inputs(), &refiner, &self.params(updates), &options)?;
        if !result.objective.is_finite() {
            return Err(Error::Diverged {
                step: self.step(),
                what: format!("the objective of clip `{}`", batch.records.clip.clip_id),
            });
        }
        let gradients = optimiser::gradients(&leaves, &result.surrogate)?;
        let (settings, step) = (&self.settings, self.step());
        let share = schedule(step, settings.steps, settings.warmup);
        self.optimiser.learning_rate = settings.rate * share;
        self.optimiser.gate_learning_rate = settings.gate_rate * share;
        let gradient_norm = self.optimiser.apply(&mut self.parameters, &gradients)?;
        if !gradient_norm.is_finite() {
            return Err(Error::Diverged {
                step,
                what: "the norm of the gradients".into(),
            });
        }
        Ok(UpdateReport {
            step,
            loss: result.objective,
            terms: terms_of(&result.terms),
            gradient_norm,
            images: batch.field.views.len(),
        })
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
                trained: self.step() > 0,
                configuration: settings.preset.clone(),
                description: String::new(),
                hash: String::new(),
            },
            warnings: Vec::new(),
        };
        let lifter = self.lifter()?;
        let cameras = |first| CameraIndex::first(first + SOURCE_CAMERAS).skip(first);
        for index in 0..settings.evaluation_clips {
            let plan = ClipPlan::evaluation(settings.data.held_out_seed + index, &settings.data);
            let lifted = lifter.lift(&plan, &settings.data)?;
            let refinement = refine(lifted.inputs(), &network, &self.params(most), &mut Unobserved)?;
            for updates in 0..=most {
                for (name, frames, cameras) in [
                    ("source", &plan.sources, cameras(0)),
                    ("novel", &plan.queries, cameras(SOURCE_CAMERAS)),
                ] {
                    let views: Vec<(FrameIndex, CameraIndex)> = (frames.iter())
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
            self.settings.preset,
            self.step()
        );
        BTreeMap::from([(rogs_weights::PROVENANCE.to_owned(), provenance)])
    }
}
