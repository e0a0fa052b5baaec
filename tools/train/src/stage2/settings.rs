//! Settings of a Stage-2 run; `docs/spec/stage2.md` section B.8 has the defaults and those of the paper.

use std::path::{Path, PathBuf};

use rogs_lift::ProductPrecision;
use rogs_stage2::RefinerConfig;
use rogs_stage2::objective::ObjectiveWeights;
use serde::{Deserialize, Serialize};

use crate::config::Cadence;
use crate::config::{self, DataSettings};
use crate::error::{Error, Result};

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
    /// Weights of LPIPS-VGG, a file or a folder of files; without them `perceptual` is left out.
    pub lpips: Option<PathBuf>,
    /// Seed of weights and data order.
    pub seed: u64,
    /// Updates of the parameters in the whole schedule.
    pub steps: u64,
    /// Updates from one checkpoint to the next.
    pub checkpoint_every: u64,
    /// Updates from one scoring of held-out clips to the next.
    pub evaluate_every: u64,
    /// Held-out clips that are scored.
    pub evaluation_clips: u64,
    /// Fewest and most recurrent updates of a clip.
    pub recurrence: [u32; 2],
    /// Precision of the products of linear layers and 3x3 convolutions, forwards and backwards: `f32`, or `bf16` with sums in
    /// f32. Parameters, moments and everything else stay f32. `bf16` is for the CPU.
    pub precision: ProductPrecision,
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
    pub losses: ObjectiveWeights,
}

impl Default for Stage2Training {
    fn default() -> Self {
        Self {
            preset: "cpu".into(),
            lift: PathBuf::new(),
            start: None,
            lpips: None,
            seed: 73,
            steps: 2000,
            checkpoint_every: 50,
            evaluate_every: 200,
            evaluation_clips: 4,
            recurrence: [1, 4],
            precision: ProductPrecision::F32,
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
            losses: ObjectiveWeights::default(),
        }
    }
}

impl Stage2Training {
    /// Reads a TOML file. Relative paths are taken from the file's folder.
    ///
    /// # Errors
    /// As [`crate::Stage1Training::read`].
    pub fn read(path: &Path) -> Result<Self> {
        let settings = config::read_toml(path, |settings: &mut Self| {
            let given = [&mut settings.start, &mut settings.lpips].into_iter().flatten();
            given.chain([&mut settings.lift]).chain(settings.data.paths()).collect()
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
        let network = RefinerConfig::preset(&self.preset)?;
        let wrong = |what, value: String, rule| Err(Error::Setting { what, value, rule });
        self.cadence().check()?;
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
        let data = &self.data;
        if data.source_cameras != DataSettings::default().source_cameras || !data.more_sizes.is_empty() {
            let rule = "absent: Stage 2 is trained on clips of three cameras and one size";
            return wrong("data.source_cameras or data.more_sizes", "given".into(), rule);
        }
        if !data.recorded.is_empty() || !data.frames.is_empty() {
            let rule = "absent: Stage 2 is trained on procedural clips";
            return wrong("data.recorded or data.frames", "given".into(), rule);
        }
        let losses = &self.losses;
        let weights = [
            losses.rendering,
            losses.rendering_squared,
            losses.right_views,
            losses.perceptual,
            losses.depth,
            losses.robot,
            losses.motion,
            losses.preservation,
            losses.coverage,
            losses.coverage_right,
            losses.discount,
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
