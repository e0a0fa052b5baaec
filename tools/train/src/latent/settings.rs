//! Settings of the training of a latent adapter; defaults are those of its first phase (`docs/spec/latents.md` section 5).

use std::path::{Path, PathBuf};

use rogs_lift::ProductPrecision;
use serde::{Deserialize, Serialize};

use crate::config;
use crate::config::Cadence;
use crate::error::{Error, Result};

/// A training run of an adapter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LatentTraining {
    /// Weights of the Stage 1 that the adapter is for; they stay as they are.
    pub lift: PathBuf,
    /// Adapter to start from; without one, seeded weights.
    pub start: Option<PathBuf>,
    /// Blocks of a seeded adapter.
    pub blocks: usize,
    /// Folder of a run of `rogs` whose clips are ingested, with robot maps and conditioning.
    pub run: PathBuf,
    /// Folder of `CLIP.safetensors`: the latents of the clips, as `[latents] root` of a run has them.
    pub latents: PathBuf,
    /// Seed of weights and data order.
    pub seed: u64,
    /// Updates.
    pub steps: u64,
    /// Updates from one checkpoint to the next.
    pub checkpoint_every: u64,
    /// Updates from one scoring of held-out clips to the next.
    pub evaluate_every: u64,
    /// Clips that are held out: the last ones by name.
    pub evaluation_clips: usize,
    /// Clips of an update.
    pub clips_per_step: usize,
    /// Runs the aggregator twice, the second time a pair at a time, instead of keeping what all pairs compute: less memory,
    /// more time. Only where a loss looks behind the tokens.
    pub gradient_checkpointing: bool,
    /// Precision of the products of linear layers and 3x3 convolutions, forwards and backwards: `f32`, or `bf16` with sums in
    /// f32. Parameters, moments and everything else stay f32. `bf16` is for the CPU.
    pub precision: ProductPrecision,
    /// Learning rate.
    pub rate: f64,
    /// Updates over which the rate rises; afterwards it stays.
    pub warmup: u64,
    /// Decay rates of the two moments.
    pub betas: [f64; 2],
    /// Decoupled weight decay of matrices.
    pub weight_decay: f64,
    /// Largest norm of all gradients together.
    pub clip: f64,
    /// Weights of the losses.
    pub losses: LatentLosses,
}

/// Weights of the losses. Without the last two the network behind the tokens does not run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LatentLosses {
    /// Squared difference of tokens.
    pub token: f64,
    /// Difference of the cosines between tokens.
    pub pairs: f64,
    /// Cosine between a token and its counterpart.
    pub direction: f64,
    /// Squared difference of the standardised features that the dense heads read.
    pub feature: f64,
    /// Difference of the logarithm of depth.
    pub log_depth: f64,
}

impl Default for LatentTraining {
    fn default() -> Self {
        Self {
            lift: PathBuf::new(),
            start: None,
            blocks: 12,
            run: PathBuf::new(),
            latents: PathBuf::new(),
            seed: 73,
            steps: 5000,
            checkpoint_every: 50,
            evaluate_every: 500,
            evaluation_clips: 4,
            clips_per_step: 1,
            gradient_checkpointing: false,
            precision: ProductPrecision::F32,
            rate: 1e-4,
            warmup: 500,
            betas: [0.9, 0.95],
            weight_decay: 0.01,
            clip: 1.0,
            losses: LatentLosses::default(),
        }
    }
}

impl Default for LatentLosses {
    fn default() -> Self {
        Self {
            token: 1.0,
            pairs: 1.0,
            direction: 1.0,
            feature: 0.0,
            log_depth: 0.0,
        }
    }
}

impl LatentLosses {
    /// Whether any loss looks behind the tokens.
    pub(super) fn needs_network(&self) -> bool {
        self.feature > 0.0 || self.log_depth > 0.0
    }
}

impl LatentTraining {
    /// Reads a TOML file. Relative paths are taken from the file's folder.
    ///
    /// # Errors
    /// As [`crate::Stage1Training::read`].
    pub fn read(path: &Path) -> Result<Self> {
        let settings = config::read_toml(path, |settings: &mut Self| {
            let places = [&mut settings.lift, &mut settings.run, &mut settings.latents];
            places.into_iter().chain(settings.start.as_mut()).collect()
        })?;
        settings.check()?;
        Ok(settings)
    }

    /// When the run writes and scores.
    #[must_use]
    pub fn cadence(&self) -> Cadence {
        Cadence {
            steps: self.steps,
            checkpoint_every: self.checkpoint_every,
            evaluate_every: self.evaluate_every,
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of its range.
    pub fn check(&self) -> Result<()> {
        let wrong = |what, value: String, rule| Err(Error::Setting { what, value, rule });
        self.cadence().check()?;
        if !(1..=64).contains(&self.blocks) {
            return wrong("blocks", self.blocks.to_string(), "from 1 to 64");
        }
        if !(1..=1000).contains(&self.clips_per_step) {
            return wrong("clips_per_step", self.clips_per_step.to_string(), "from 1 to 1000");
        }
        let numbers = [self.rate, self.weight_decay];
        if numbers.iter().any(|number| !(0.0..=1.0).contains(number)) || self.clip.is_nan() || self.clip <= 0.0 {
            return wrong("rate", format!("{numbers:?}"), "from 0 to 1, with a positive clip");
        }
        if self.betas.iter().any(|beta| !(0.0..1.0).contains(beta)) {
            return wrong("betas", format!("{:?}", self.betas), "from 0 to below 1");
        }
        let losses = &self.losses;
        let weights = [
            losses.token,
            losses.pairs,
            losses.direction,
            losses.feature,
            losses.log_depth,
        ];
        if weights.iter().any(|weight| !weight.is_finite() || *weight < 0.0) || weights.iter().sum::<f64>() == 0.0 {
            return wrong("losses", format!("{weights:?}"), "finite, not negative, and not all 0");
        }
        Ok(())
    }
}
