//! Training of Stage 1, the lifting network (`docs/spec/stage1.md` sections 14 and 15).

mod checkpointed;
mod evaluate;
pub mod forward;
mod matching;
pub mod objective;
mod renders;
pub mod start;
pub mod terms;

use std::collections::BTreeMap;

use burn::tensor::Device;
use rayon::prelude::*;
use rogs_lpips::LpipsTensors;
use rogs_random::Pcg64;
use rogs_stage1::{Stage1, Stage1Config, stage1_metadata};
use rogs_tensors::device;
use rogs_tensors::optimiser::{self, Gradients, Moments, Rule, schedule};
use rogs_tensors::parameters::Parameters;
use rogs_weights::{TRAINING_DOMAIN, TrainingDomain};

use crate::checkpoint::State;
use crate::config::{Cadence, Stage1Training, check_precision};
use crate::error::{Error, Result};
use crate::perceptual::perceptual;
use crate::props::props;
use crate::recorded::Recordings;
use crate::run::{Evaluation, Trainer, UpdateReport};
use crate::sample::Sample;
use crate::stream::{Batch, Stream, batches};
use evaluate::evaluate;
use forward::{Heads, SweepTerms, lift, source_frames};
use objective::{objective, of_sweep};
use terms::{Losses, Objective};

/// A run between two updates.
pub struct Stage1Trainer {
    /// Its settings.
    pub settings: Stage1Training,
    /// The network as it is now.
    pub network: Stage1,
    /// Moments of the optimiser.
    pub moments: Moments,
    /// Updates done.
    pub step: u64,
    /// The narrow kind of clips that the weights had seen before the first update, if any.
    domain: Option<TrainingDomain>,
    /// The network of `movies_lpips`.
    perceptual: Option<LpipsTensors>,
}

impl Stage1Trainer {
    /// A run before its first update. The network runs on the device; rendering and losses are computed on the CPU.
    ///
    /// # Errors
    /// When settings are wrong or the checkpoint to start from cannot be opened.
    pub fn new(settings: Stage1Training, device: &Device) -> Result<Self> {
        settings.check()?;
        check_precision(settings.precision, device)?;
        props(&settings.data)?;
        let patch = Stage1Config::by_name(&settings.configuration)?.patch;
        Recordings::open(&settings.data)?.check(patch)?;
        let device = device.clone().autodiff();
        let mut start = start::start(&settings, &device)?;
        start.network.parameters.set_products(settings.precision.into());
        let perceptual = perceptual(settings.lpips.as_deref(), &Device::flex().autodiff())?;
        Ok(Self {
            settings,
            network: start.network,
            domain: start.domain,
            moments: Moments::default(),
            step: 0,
            perceptual,
        })
    }

    /// Loss and gradients of a clip.
    fn differentiate(&self, clip: &Sample, index: u64) -> Result<ClipResult> {
        let settings = &self.settings;
        let network = start::tracked(&self.network, &settings.optimiser)?;
        let mut random = Pcg64::from_seeds(&[settings.seed, 3, self.step, index]);
        let conditioned = random.next_double() >= settings.data.conditioning_dropout;
        let anchoring_dropout = settings.data.anchoring_dropout;
        let free =
            (anchoring_dropout > 0.0 && random.next_double() < anchoring_dropout).then(|| clip.without_anchors());
        let clip = free.as_ref().unwrap_or(clip);
        let losses = Losses {
            weights: &settings.losses,
            perceptual: self.perceptual.as_ref(),
        };
        let heads = if settings.losses.needs_queries() {
            Heads::All
        } else {
            Heads::Depth
        };
        let (objective, gradients) = if settings.losses.only_sweep() {
            let found = network.sweep(&source_frames(clip, network.parameters.device()))?;
            let swept = found.as_ref().map(SweepTerms::from);
            differentiated(&network, of_sweep(clip, swept.as_ref(), &settings.losses)?)?
        } else if settings.gradient_checkpointing {
            checkpointed::differentiate(&network, clip, (conditioned, heads), losses, &mut random)?
        } else {
            let lifted = lift(&network, clip, conditioned, heads)?;
            let objective = objective(clip, &lifted, losses, &mut random)?;
            drop(lifted);
            differentiated(&network, objective)?
        };
        let gradients = match settings.optimiser.clip_each {
            Some(most) => optimiser::clipped(gradients, most),
            None => gradients,
        };
        if !objective.value.is_finite() {
            let bad = objective.terms.iter().find(|(_, value)| !value.is_finite());
            let bad = bad.map_or("total", |(key, _)| key);
            return Err(Error::Diverged {
                step: self.step,
                what: format!("the loss `{bad}` of {}", clip.origin),
            });
        }
        Ok(ClipResult {
            value: objective.value,
            terms: objective.terms,
            gradients,
        })
    }
}

impl Trainer for Stage1Trainer {
    type Settings = Stage1Training;
    type Batch = Batch;

    const TITLE: &'static str = "Training of Stage 1";
    const PICTURE: &'static str = "At a query time: seen, rendered, reference depth, rendered depth; three source cameras, \
        then their right eyes. Below, source images: seen, reference depth, depth of the head.";

    fn settings(&self) -> &Stage1Training {
        &self.settings
    }

    fn cadence(&self) -> Cadence {
        self.settings.cadence()
    }

    fn state(&mut self) -> State<'_> {
        State {
            parameters: &mut self.network.parameters,
            moments: &mut self.moments,
            step: &mut self.step,
        }
    }

    fn parameters(&self) -> &Parameters {
        &self.network.parameters
    }

    fn moments(&self) -> &Moments {
        &self.moments
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn stream(&self) -> Result<Stream<Batch>> {
        Ok(batches(&self.settings, self.step))
    }

    fn evaluate(&self) -> Result<Evaluation> {
        evaluate(&self.network, &self.settings)
    }

    fn metadata(&self, time: &str) -> BTreeMap<String, String> {
        let settings = &self.settings;
        let start = match &settings.start {
            Some(path) => format!(
                "started from {}",
                path.file_name().unwrap_or_default().to_string_lossy()
            ),
            None => format!("from scratch, seed {}", settings.seed),
        };
        let ([height, width], step) = (settings.data.size, self.step);
        let recorded = !settings.data.recorded.is_empty() || !settings.data.frames.is_empty();
        let clips = if recorded {
            "procedural and recorded clips"
        } else {
            "procedural clips only"
        };
        let more: String = settings
            .data
            .more_sizes
            .iter()
            .map(|more| format!(" and {} x {}", more.size[0], more.size[1]))
            .collect();
        let provenance =
            format!("trained by rogs-train on {clips}, {step} updates at {height} x {width}{more}, {start}{time}");
        let mut metadata = stage1_metadata(&self.network.config, step > 0, &provenance);
        let domain = self.domain.filter(|_| settings.data.recorded.is_empty());
        if let Some(domain) = domain {
            let domain = if settings.data.frames.is_empty() {
                domain
            } else {
                TrainingDomain::ProceduralAndRooms
            };
            metadata.insert(TRAINING_DOMAIN.to_owned(), domain.name().to_owned());
        }
        metadata
    }

    // Clips are differentiated side by side on as many threads as there are, on a GPU one after the other; their
    // gradients are added up in their order.
    fn update(&mut self, batch: &Batch) -> Result<UpdateReport> {
        let differentiated = |index: usize| self.differentiate(&batch.clips[index], index as u64);
        let clips = 0..batch.clips.len();
        let results: Vec<Result<ClipResult>> = if device::is_cpu(self.network.parameters.device()) {
            clips.into_par_iter().with_max_len(1).map(differentiated).collect()
        } else {
            clips.map(differentiated).collect()
        };
        let mut sum = Gradients::new();
        let mut terms: BTreeMap<String, f64> = BTreeMap::new();
        let (mut loss, share) = (0.0, 1.0 / batch.clips.len().max(1) as f64);
        for result in results {
            let ClipResult {
                value,
                terms: of_clip,
                gradients,
            } = result?;
            loss += share * value;
            for (key, value) in of_clip {
                *terms.entry(key.to_owned()).or_insert(0.0) += share * value;
            }
            optimiser::add(&mut sum, share, gradients);
        }
        let optimiser = &self.settings.optimiser;
        let rule = Rule {
            rate: &|name| start::rate_of(name, optimiser),
            share: schedule(self.step, self.settings.steps, optimiser.warmup),
            betas: optimiser.betas,
            weight_decay: &|_| optimiser.weight_decay,
            clip: optimiser.clip,
        };
        let gradient_norm = optimiser::update(&mut self.network.parameters, &mut self.moments, &sum, &rule, self.step)?;
        if !gradient_norm.is_finite() {
            return Err(Error::Diverged {
                step: self.step,
                what: "the norm of the gradients".into(),
            });
        }
        let report = UpdateReport {
            step: self.step,
            loss,
            terms,
            gradient_norm,
            images: batch.clips.iter().map(|clip| clip.views.len()).sum(),
        };
        self.step += 1;
        Ok(report)
    }
}

/// An objective with the gradients of its loss.
fn differentiated(network: &Stage1, objective: Objective) -> Result<(Objective, Gradients)> {
    let gradients = optimiser::gradients(&network.parameters, &objective.loss)?;
    Ok((objective, gradients))
}

/// What a clip adds to an update.
struct ClipResult {
    value: f64,
    terms: BTreeMap<&'static str, f64>,
    gradients: Gradients,
}
