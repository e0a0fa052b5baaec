//! Training of the latent adapter: its tokens, and what a frozen Stage 1 makes of them, are to come close to those of the
//! RGB path (`docs/spec/latents.md` section 5, after the paper's appendix on the latent-token interface).

mod clips;
mod settings;

use std::collections::BTreeMap;

use burn::tensor::{Device, Tensor};
use rogs_lift::latents::open_adapter;
use rogs_lift::{ClipInputs, LiftParams, latent_inputs};
use rogs_random::Pcg64;
use rogs_stage1::adapter::LatentAdapter;
use rogs_stage1::{Encoded, HeadKind, SourceFrames, Stage1, distillation, layout, seeded};
use rogs_tensors::optimiser::{self, Gradients, Moments, Rule};
use rogs_tensors::parameters::{Parameters, to_host};
use rogs_weights::{self, PROVENANCE};

pub use self::clips::LatentClip;
use self::clips::Place;
pub use self::settings::{LatentLosses, LatentTraining};
use crate::checkpoint::State;
use crate::config::{Cadence, check_precision};
use crate::error::{Error, Result};
use crate::run::{Evaluation, Trainer, UpdateReport};
use crate::segments::Segments;
use crate::stream::Stream;

/// A run between two updates.
pub struct LatentTrainer {
    settings: LatentTraining,
    /// The network behind the tokens, for gradients to pass through; nothing of it is trained.
    network: Stage1,
    /// The same without gradients: the RGB path, and what scores.
    plain: Stage1,
    adapter: Parameters,
    moments: Moments,
    step: u64,
    training: Vec<Place>,
    held_out: Vec<Place>,
}

impl LatentTrainer {
    /// A run before its first update, on a device of its own kind with gradients.
    ///
    /// # Errors
    /// When settings are wrong, weights cannot be read or do not fit each other, or there is nothing to train on.
    pub fn new(settings: LatentTraining, device: &Device) -> Result<Self> {
        settings.check()?;
        check_precision(settings.precision, device)?;
        let device = device.clone().autodiff();
        let mut network = rogs_stage1::open_stage1(&settings.lift, &device)?.network;
        let mut adapter = match &settings.start {
            Some(path) => started(open_adapter(path, &device)?, &network)?,
            None => from_seed(&network, &settings, &device)?,
        };
        network.parameters.set_products(settings.precision.into());
        adapter.set_products(settings.precision.into());
        let plain = Stage1::new(network.config.clone(), network.parameters.without_gradients())?;
        let [training, held_out] = clips::find(&settings)?;
        Ok(Self {
            settings,
            network,
            plain,
            adapter,
            moments: Moments::default(),
            step: 0,
            training,
            held_out,
        })
    }

    /// Tokens of a clip by an adapter on a network's device, and by the RGB path.
    fn pass(&self, network: &Stage1, adapter: &Parameters, clip: &LatentClip) -> Result<Pass> {
        let inputs = ClipInputs {
            clip: &clip.clip,
            robot: &clip.robot,
            conditioning: &clip.conditioning,
            latents: Some(&clip.latents),
            adapter: None,
        };
        let (frames, cells) = latent_inputs(network, &LiftParams::default(), inputs, adapter.device())?;
        let config = &network.config;
        let tokens = LatentAdapter::new(adapter.scope("adapter"), config.width, config.heads).forward(cells)?;
        let plain_frames = without_gradients(&frames);
        let visual = Visual::of(&self.plain, &plain_frames, self.settings.losses.needs_network())?;
        Ok(Pass {
            frames,
            plain_frames,
            tokens,
            visual,
        })
    }

    /// Losses of the tokens.
    fn token_terms(&self, pass: &Pass) -> Vec<Term> {
        let weights = &self.settings.losses;
        let visual = pass.visual.tokens.clone().to_device(&pass.tokens.device());
        let aligned = distillation::tokens(pass.tokens.clone(), visual);
        vec![
            ("token", weights.token, aligned.square),
            ("pairs", weights.pairs, aligned.pairs),
            ("direction", weights.direction, aligned.direction),
        ]
    }

    /// Losses of what the network makes of the tokens.
    fn network_terms(&self, network: &Stage1, latent: &Encoded, behind: &Behind) -> Result<Vec<Term>> {
        let (weights, device) = (&self.settings.losses, latent.taps[0].device());
        let taps = behind.encoded.taps.clone().map(|tap| tap.to_device(&device));
        let log_depth = behind.log_depth.clone().to_device(&device);
        Ok(vec![
            ("feature", weights.feature, distillation::features(&latent.taps, &taps)),
            (
                "log_depth",
                weights.log_depth,
                distillation::log_depth(log_depth_of(network, latent)?, log_depth),
            ),
        ])
    }

    /// Losses and gradients of a clip.
    fn differentiate(&self, clip: &LatentClip) -> Result<ClipResult> {
        let network = &self.network;
        let tracked = self
            .adapter
            .with_leaves(self.adapter.device(), |_, values| values.require_grad());
        let pass = self.pass(network, &tracked, clip)?;
        let mut sum = Sum::default();
        sum.add(self.token_terms(&pass))?;
        if let Some(behind) = &pass.visual.behind {
            if self.settings.gradient_checkpointing {
                let of_network = self.through_segments(&pass, behind, &mut sum)?;
                sum.loss = (sum.loss.into_iter().chain(of_network)).reduce(|loss, term| loss + term);
            } else {
                let latent = network.encode_tokens(&pass.frames, pass.tokens.clone())?;
                sum.add(self.network_terms(network, &latent, behind)?)?;
            }
        }
        let gradients = match &sum.loss {
            Some(loss) => optimiser::gradients(&tracked, loss)?,
            None => Gradients::new(),
        };
        Ok(ClipResult {
            value: sum.value,
            terms: sum.terms,
            gradients,
        })
    }

    /// Adds the values of the losses behind the tokens; returns a number whose gradient with respect to the tokens is theirs.
    fn through_segments(&self, pass: &Pass, behind: &Behind, sum: &mut Sum) -> Result<Option<Tensor<1>>> {
        let (network, frames) = (&self.network, &pass.frames);
        let tokens = pass.tokens.clone().without_autodiff();
        let segments = Segments::run(&self.plain, &pass.plain_frames, tokens)?;
        let leaves = segments.taps.clone().map(|tap| tap.autodiff().require_grad());
        let [_, _, height, width] = frames.images.dims();
        let latent = network.encoded(leaves.clone(), network.local(frames)?, [height, width])?;
        let mut of_network = Sum::default();
        of_network.add(self.network_terms(network, &latent, behind)?)?;
        sum.value += of_network.value;
        sum.terms.append(&mut of_network.terms);
        let Some(loss) = of_network.loss else { return Ok(None) };
        let mut graph = loss.backward();
        let of_taps = leaves.map(|leaf| leaf.grad_remove(&mut graph));
        drop((graph, latent));
        // Nothing of the network is trained: there is nothing to collect.
        let gradient = segments.back(network, frames, &of_taps, &mut Gradients::new())?;
        let Some(gradient) = gradient else { return Ok(None) };
        let tokens = network.embed(frames, pass.tokens.clone())?;
        Ok(Some((tokens * gradient.autodiff()).sum()))
    }
}

/// A clip on its way to the losses.
struct Pass {
    frames: SourceFrames,
    /// The same without gradients.
    plain_frames: SourceFrames,
    /// Of the adapter.
    tokens: Tensor<3>,
    visual: Visual,
}

/// A sum of weighted terms.
#[derive(Default)]
struct Sum {
    value: f64,
    terms: BTreeMap<&'static str, f64>,
    /// Its differentiable part: terms with a weight.
    loss: Option<Tensor<1>>,
}

impl Sum {
    fn add(&mut self, terms: Vec<Term>) -> Result<()> {
        for (name, weight, term) in terms {
            let unweighted = number(term.clone())?;
            self.value += weight * unweighted;
            self.terms.insert(name, unweighted);
            if weight > 0.0 {
                let weighted = term * weight;
                self.loss = Some(match self.loss.take() {
                    Some(loss) => loss + weighted,
                    None => weighted,
                });
            }
        }
        Ok(())
    }
}

/// What a clip adds to an update.
struct ClipResult {
    value: f64,
    terms: BTreeMap<&'static str, f64>,
    gradients: Gradients,
}

/// Name, weight and value of a loss.
type Term = (&'static str, f64, Tensor<1>);

/// What the RGB path makes of a clip.
struct Visual {
    tokens: Tensor<3>,
    behind: Option<Behind>,
}

/// What the network makes of tokens.
struct Behind {
    /// What the heads read.
    encoded: Encoded,
    log_depth: Tensor<3>,
}

impl Visual {
    fn of(network: &Stage1, frames: &SourceFrames, needs_network: bool) -> Result<Self> {
        let tokens = network.patch_tokens(frames, network.local(frames)?.as_ref())?;
        let behind = if needs_network {
            let encoded = network.encode_tokens(frames, tokens.clone())?;
            let log_depth = log_depth_of(network, &encoded)?;
            Some(Behind { encoded, log_depth })
        } else {
            None
        };
        Ok(Self { tokens, behind })
    }
}

fn without_gradients(frames: &SourceFrames) -> SourceFrames {
    SourceFrames {
        images: frames.images.clone().without_autodiff(),
        cameras: frames.cameras.clone(),
        recon_from_base_iu: frames.recon_from_base_iu,
        times: frames.times.clone(),
        attention: frames.attention.clone(),
    }
}

/// The logarithm of the depth head's depth. `[S, H, W]`
fn log_depth_of(network: &Stage1, encoded: &Encoded) -> Result<Tensor<3>> {
    let head = network.head(HeadKind::Depth)?;
    let output = head.forward(&head.projections(None), encoded);
    Ok(output.narrow(1, 0, 1).squeeze_dim(1))
}

fn number(value: Tensor<1>) -> Result<f64> {
    Ok(to_host(value)?.first().copied().map_or(f64::NAN, f64::from))
}

/// An adapter to continue from, after a check that it fits the network.
fn started(adapter: Parameters, network: &Stage1) -> Result<Parameters> {
    let blocks = LatentAdapter::new(adapter.scope("adapter"), network.config.width, network.config.heads).blocks();
    for spec in layout::adapter(&network.config, blocks) {
        if adapter.shape(&spec.name) != Some(&spec.shape) {
            return Err(Error::Setting {
                what: "start",
                value: format!("an adapter whose `{}` is {:?}", spec.name, adapter.shape(&spec.name)),
                rule: "an adapter for the network of `lift`",
            });
        }
    }
    Ok(adapter)
}

fn from_seed(network: &Stage1, settings: &LatentTraining, device: &Device) -> Result<Parameters> {
    let mut adapter = Parameters::new(device);
    for spec in layout::adapter(&network.config, settings.blocks) {
        let values = seeded::values(&spec, &network.config, settings.seed);
        adapter.insert(&spec.name, &spec.shape, values)?;
    }
    Ok(adapter)
}

impl Trainer for LatentTrainer {
    type Settings = LatentTraining;
    type Batch = Vec<LatentClip>;

    const TITLE: &'static str = "Training of the latent adapter";
    const PICTURE: &'static str = "";

    fn settings(&self) -> &LatentTraining {
        &self.settings
    }

    fn cadence(&self) -> Cadence {
        self.settings.cadence()
    }

    fn state(&mut self) -> State<'_> {
        State {
            parameters: &mut self.adapter,
            moments: &mut self.moments,
            step: &mut self.step,
        }
    }

    fn parameters(&self) -> &Parameters {
        &self.adapter
    }

    fn moments(&self) -> &Moments {
        &self.moments
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn stream(&self) -> Result<Stream<Vec<LatentClip>>> {
        let (settings, places) = (self.settings.clone(), self.training.clone());
        Ok(Stream::start(self.step..settings.steps, move |step| {
            let mut random = Pcg64::from_seeds(&[settings.seed, 2, step]);
            let draw = |_| {
                let index = (random.next_double() * places.len() as f64) as usize;
                places[index.min(places.len() - 1)].read()
            };
            (0..settings.clips_per_step).map(draw).collect()
        }))
    }

    fn update(&mut self, batch: &Vec<LatentClip>) -> Result<UpdateReport> {
        let share = 1.0 / batch.len().max(1) as f64;
        let (mut loss, mut terms) = (0.0, BTreeMap::new());
        let mut sum = Gradients::new();
        for clip in batch {
            let ClipResult {
                value,
                terms: of_clip,
                gradients,
            } = self.differentiate(clip)?;
            if let Some((name, _)) = of_clip.iter().find(|(_, value)| !value.is_finite()) {
                return Err(Error::Diverged {
                    step: self.step,
                    what: format!("the loss `{name}` of clip `{}`", clip.clip.clip_id),
                });
            }
            loss += share * value;
            for (name, value) in of_clip {
                *terms.entry(name.to_owned()).or_insert(0.0) += share * value;
            }
            optimiser::add(&mut sum, share, gradients);
        }
        let settings = &self.settings;
        let rule = Rule {
            rate: &|_| Some(settings.rate),
            share: ((self.step + 1) as f64 / settings.warmup.max(1) as f64).min(1.0),
            betas: settings.betas,
            weight_decay: &|shape| if shape.len() > 1 { settings.weight_decay } else { 0.0 },
            clip: settings.clip,
        };
        let gradient_norm = optimiser::update(&mut self.adapter, &mut self.moments, &sum, &rule, self.step)?;
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
            images: batch.iter().map(|clip| clip.clip.source_views().len()).sum(),
        };
        self.step += 1;
        Ok(report)
    }

    /// The losses of the held-out clips, all of them, whatever their weights.
    fn evaluate(&self) -> Result<Evaluation> {
        let mut evaluation = Evaluation::default();
        let adapter = self.adapter.without_gradients();
        for place in &self.held_out {
            let pass = self.pass(&self.plain, &adapter, &place.read()?)?;
            let mut terms = self.token_terms(&pass);
            if let Some(behind) = &pass.visual.behind {
                let latent = self.plain.encode_tokens(&pass.frames, pass.tokens.clone())?;
                terms.extend(self.network_terms(&self.plain, &latent, behind)?);
            }
            for (name, _, value) in terms {
                *evaluation.scores.entry(name.to_owned()).or_insert(0.0) += number(value)? / self.held_out.len() as f64;
            }
        }
        Ok(evaluation)
    }

    fn metadata(&self, time: &str) -> BTreeMap<String, String> {
        let provenance = format!(
            "latent adapter for a Stage 1 `{}`, trained by rogs-train, {} updates on {} clips{time}",
            self.network.config.name,
            self.step,
            self.training.len()
        );
        BTreeMap::from([(PROVENANCE.to_owned(), provenance)])
    }
}
