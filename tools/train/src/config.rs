//! Settings of a training run: one TOML file, every key optional. Defaults are the paper's schedule
//! (`docs/spec/stage1.md` sections 14 and 15).

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use rogs_lift::ProductPrecision;
use rogs_stage1::Stage1Config;
use rogs_synth::World;
use rogs_tensors::device;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::sources::{self, FramesSettings, RecordedSettings, RobotSettings};

/// A Stage-1 training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stage1Training {
    /// Network configuration: `full`, `compact`, `compact-sweep` or `compact-wide`.
    pub configuration: String,
    /// Checkpoint to start from; without one, weights are drawn from the seed.
    pub start: Option<PathBuf>,
    /// Starts the FK branch anew although the checkpoint has one.
    pub fresh_fk_branch: bool,
    /// Gives a network that has none the gate of what the gripper holds: held objects then follow it. Not in the paper.
    #[serde(skip_serializing_if = "is_off")]
    pub held_gate: bool,
    /// Weights of LPIPS-VGG, a file or a folder of files; without them `movies_lpips` is left out.
    pub lpips: Option<PathBuf>,
    /// Seed of weights, data order and dropout.
    pub seed: u64,
    /// Updates of the whole schedule.
    pub steps: u64,
    /// Updates from one checkpoint to the next.
    pub checkpoint_every: u64,
    /// Updates from one scoring of held-out clips to the next.
    pub evaluate_every: u64,
    /// Held-out clips that are scored.
    pub evaluation_clips: u64,
    /// Runs the aggregator twice, the second time a pair at a time, instead of keeping what all pairs compute: less memory,
    /// more time.
    pub gradient_checkpointing: bool,
    /// Precision of the products of linear layers and 3x3 convolutions, forwards and backwards: `f32`, or `bf16` with sums in
    /// f32. Parameters, moments and everything else stay f32. `bf16` is for the CPU.
    pub precision: ProductPrecision,
    /// Where clips come from.
    pub data: DataSettings,
    /// What is trained, and how fast.
    pub optimiser: OptimiserSettings,
    /// Weights of the losses.
    pub losses: LossWeights,
}

/// Clips of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DataSettings {
    /// First seed of the training episodes; clip `i` comes from the episode of seed `first_seed + i`.
    pub first_seed: u64,
    /// First seed of the episodes that training never sees.
    pub held_out_seed: u64,
    /// Image height and width, pixels; multiples of the patch side.
    pub size: [u32; 2],
    /// Frames of a clip.
    pub clip_frames: u32,
    /// Fewest and most source times of a clip.
    pub source_times: [u32; 2],
    /// Query times of a clip.
    pub queries: u32,
    /// Other image sizes, each for a share of the updates; the rest have `size`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub more_sizes: Vec<SizeShare>,
    /// Fewest and most cameras of a procedural clip whose images the network sees, of wrist and external ones; a fourth is a
    /// right eye. Recorded clips have those that they were ingested with.
    #[serde(skip_serializing_if = "is_three")]
    pub source_cameras: [u32; 2],
    /// Source images of one update: as many clips as fit, of larger images fewer.
    pub images_per_step: u32,
    /// Probability that a clip's conditioning maps are all zero.
    pub conditioning_dropout: f64,
    /// Share of clips whose robot pixels are not anchored to the mesh. None in the paper; without some, the network
    /// never learns the robot's depth, which the ablation without anchoring asks for.
    pub anchoring_dropout: f64,
    /// Errors of the recorded extrinsics, standard deviations in metres and radians.
    pub calibration_noise: Option<[f64; 2]>,
    /// How wide the worlds of procedural episodes are; without it, all are plain robot cells.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub world: Option<World>,
    /// Folder of photographs, models and light probes for wide worlds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub props: Option<PathBuf>,
    /// Other robots for wide worlds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub robots: Vec<RobotSettings>,
    /// Ingested clips, mixed with procedural ones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub recorded: Vec<RecordedSettings>,
    /// Posed RGB-D frames of rooms, mixed with procedural clips.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frames: Vec<FramesSettings>,
}

/// An image size and how often it comes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SizeShare {
    /// Image height and width, pixels; multiples of the patch side.
    pub size: [u32; 2],
    /// Share of the updates.
    pub share: f64,
}

/// The cameras of DROID, which settings need not say.
const THREE_CAMERAS: [u32; 2] = [3, 3];

fn is_off(setting: &bool) -> bool {
    !setting
}

fn is_zero(weight: &f64) -> bool {
    *weight == 0.0
}

fn is_three(cameras: &[u32; 2]) -> bool {
    *cameras == THREE_CAMERAS
}

/// AdamW with a learning rate per group of parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OptimiserSettings {
    /// Peak rate of encoder, aggregator, depth and motion head (or of their low-rank updates).
    pub rate: f64,
    /// Peak rate of the attribute heads.
    pub head_rate: f64,
    /// Peak rate of the FK branch.
    pub fk_rate: f64,
    /// Peak rate of the gate of what is held; that of the FK branch without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_rate: Option<f64>,
    /// Rank of low-rank updates of the attention layers; 0 trains all weights.
    pub lora_rank: usize,
    /// Whether encoder and aggregator weights are trained when there are no low-rank updates.
    pub train_backbone: bool,
    /// Updates over which the rate rises linearly.
    pub warmup: u64,
    /// Decay rates of the two moments.
    pub betas: [f64; 2],
    /// Decoupled weight decay.
    pub weight_decay: f64,
    /// Largest norm of all gradients together.
    pub clip: f64,
    /// Largest norm of the gradients of one clip, before those of an update are added up: no clip then outweighs the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip_each: Option<f64>,
}

/// Weights of the losses under the paper's keys.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossWeights {
    /// Squared colour error of rendered views.
    pub movies_mse: f64,
    /// LPIPS of rendered views.
    pub movies_lpips: f64,
    /// Squared depth error and its gradient term at the depth head.
    pub depth_head: f64,
    /// Absolute log-depth error at the depth head.
    pub stereo: f64,
    /// The same over robot pixels only. Not in the paper, whose robot depth is the mesh's: it teaches the network the depth
    /// that the ablation without anchoring asks for.
    pub stereo_robot: f64,
    /// Cross entropies of the depths that the stem's plane sweep finds likely: by similarity alone, where another camera sees
    /// the same, and in the end, everywhere. Not in the paper, whose network has no sweep.
    pub sweep: f64,
    /// Absolute log-depth error of the sweep's expected depth.
    pub sweep_depth: f64,
    /// Motion at track pixels.
    pub track_head: f64,
    /// Composited displacement at track pixels.
    pub track_final: f64,
    /// Motion of objects that move, and of what stands still within reach of the gripper. Not in the paper, whose network
    /// has no gate of what is held.
    #[serde(skip_serializing_if = "is_zero")]
    pub held: f64,
    /// Distance to the FK displacement at robot pixels.
    pub fk_head: f64,
    /// The same of the composited displacement.
    pub fk_final: f64,
    /// Absolute rendered depth error at source cameras, millimetres.
    pub metric_final: f64,
    /// The same at right eyes.
    pub metric_right: f64,
    /// Absolute rendered depth error as a share of the depth, at source cameras and right eyes: what is far does not outweigh
    /// what is near. Not in the paper.
    #[serde(skip_serializing_if = "is_zero")]
    pub metric_share: f64,
    /// The same at source cameras over valid robot pixels, where the mesh anchors: the Gaussians are then at the right depth, and
    /// what is left to learn is what stands before them and what shines through. Not in the paper.
    pub metric_robot: f64,
    /// Missing opacity at source cameras.
    pub coverage: f64,
    /// The same at right eyes.
    pub coverage_right: f64,
}

impl Default for Stage1Training {
    fn default() -> Self {
        Self {
            configuration: "compact".into(),
            start: None,
            fresh_fk_branch: false,
            held_gate: false,
            lpips: None,
            seed: 73,
            steps: 3462,
            checkpoint_every: 100,
            evaluate_every: 200,
            evaluation_clips: 8,
            gradient_checkpointing: false,
            precision: ProductPrecision::F32,
            data: DataSettings::default(),
            optimiser: OptimiserSettings::default(),
            losses: LossWeights::default(),
        }
    }
}

impl Default for DataSettings {
    fn default() -> Self {
        Self {
            first_seed: 10_000_000,
            held_out_seed: 5_000_000,
            size: [154, 280],
            clip_frames: 17,
            source_times: [2, 5],
            queries: 8,
            more_sizes: Vec::new(),
            source_cameras: THREE_CAMERAS,
            images_per_step: 80,
            conditioning_dropout: 0.1,
            anchoring_dropout: 0.0,
            calibration_noise: None,
            world: None,
            props: None,
            robots: Vec::new(),
            recorded: Vec::new(),
            frames: Vec::new(),
        }
    }
}

impl Default for OptimiserSettings {
    fn default() -> Self {
        Self {
            rate: 4e-5,
            head_rate: 4e-4,
            fk_rate: 4e-4,
            held_rate: None,
            lora_rank: 0,
            train_backbone: true,
            warmup: 150,
            betas: [0.9, 0.95],
            weight_decay: 0.05,
            clip: 1.0,
            clip_each: None,
        }
    }
}

impl Default for LossWeights {
    fn default() -> Self {
        Self {
            movies_mse: 1.0,
            movies_lpips: 0.5,
            depth_head: 1.0,
            stereo: 1.04051,
            stereo_robot: 0.0,
            sweep: 0.0,
            sweep_depth: 0.0,
            track_head: 10.0,
            track_final: 0.105_593,
            held: 0.0,
            fk_head: 0.464_340,
            fk_final: 0.157_137,
            metric_final: 0.001_829_39,
            metric_right: 0.004_844_63,
            metric_share: 0.0,
            metric_robot: 0.0,
            coverage: 0.058_967_8,
            coverage_right: 0.064_852_4,
        }
    }
}

impl LossWeights {
    /// Whether any loss looks at a rendered view.
    #[must_use]
    pub fn renders_views(&self) -> bool {
        let coverage = self.coverage > 0.0 || self.coverage_right > 0.0;
        self.movies_mse > 0.0 || self.movies_lpips > 0.0 || self.metric() || coverage
    }

    /// Whether any loss looks further than the depth head, at what is asked for at a query time.
    #[must_use]
    pub fn needs_queries(&self) -> bool {
        let outputs = self.track_head > 0.0 || self.fk_head > 0.0 || self.held > 0.0;
        self.renders_views() || self.renders_motion() || outputs
    }

    /// Whether any loss looks at the stem's sweep.
    #[must_use]
    pub fn looks_at_sweep(&self) -> bool {
        self.sweep > 0.0 || self.sweep_depth > 0.0
    }

    /// Whether nothing but the stem's sweep is looked at.
    #[must_use]
    pub fn only_sweep(&self) -> bool {
        let depth = self.stereo > 0.0 || self.stereo_robot > 0.0 || self.depth_head > 0.0;
        self.looks_at_sweep() && !depth && !self.needs_queries()
    }

    /// Whether any loss looks at a composited displacement.
    #[must_use]
    pub fn renders_motion(&self) -> bool {
        self.track_final > 0.0 || self.fk_final > 0.0
    }

    fn metric(&self) -> bool {
        let terms = [
            self.metric_final,
            self.metric_right,
            self.metric_share,
            self.metric_robot,
        ];
        terms.into_iter().any(|weight| weight > 0.0)
    }

    fn all(&self) -> [f64; 18] {
        [
            self.movies_mse,
            self.movies_lpips,
            self.depth_head,
            self.stereo,
            self.stereo_robot,
            self.sweep,
            self.sweep_depth,
            self.track_head,
            self.track_final,
            self.held,
            self.fk_head,
            self.fk_final,
            self.metric_final,
            self.metric_right,
            self.metric_share,
            self.metric_robot,
            self.coverage,
            self.coverage_right,
        ]
    }
}

impl Stage1Training {
    /// Reads a TOML file. Relative paths are taken from the file's folder.
    ///
    /// # Errors
    /// With line and column where the file cannot be understood, or the setting that is out of range.
    pub fn read(path: &Path) -> Result<Self> {
        let settings = read_toml(path, |settings: &mut Self| {
            let given = [&mut settings.start, &mut settings.lpips].into_iter().flatten();
            given.chain(settings.data.paths()).collect()
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
        let network = Stage1Config::by_name(&self.configuration)?;
        let wrong = |what, value: String, rule| Err(Error::Setting { what, value, rule });
        self.cadence().check()?;
        self.data.check(network.patch as u32)?;
        let optimiser = &self.optimiser;
        let rates = [
            optimiser.rate,
            optimiser.head_rate,
            optimiser.fk_rate,
            optimiser.held_rate.unwrap_or(0.0),
            optimiser.weight_decay,
        ];
        let clips = [Some(optimiser.clip), optimiser.clip_each];
        let out_of_range = |clip: f64| clip.is_nan() || clip <= 0.0;
        if rates.iter().any(|rate| !(0.0..=1.0).contains(rate)) || clips.into_iter().flatten().any(out_of_range) {
            return wrong(
                "optimiser",
                format!("{rates:?}"),
                "rates from 0 to 1 and a positive clip",
            );
        }
        if optimiser.betas.iter().any(|beta| !(0.0..1.0).contains(beta)) {
            return wrong("optimiser.betas", format!("{:?}", optimiser.betas), "from 0 to below 1");
        }
        if self.losses.only_sweep() && self.data.source_cameras[0] < 2 {
            let rule = "at least 2 where nothing but the sweep is trained, which compares cameras";
            return wrong("data.source_cameras", format!("{:?}", self.data.source_cameras), rule);
        }
        if optimiser.lora_rank > network.width {
            return wrong(
                "optimiser.lora_rank",
                optimiser.lora_rank.to_string(),
                "at most the token width",
            );
        }
        if self
            .losses
            .all()
            .iter()
            .any(|weight| !weight.is_finite() || *weight < 0.0)
        {
            return wrong("losses", format!("{:?}", self.losses.all()), "finite and not negative");
        }
        let sweep = [
            ("losses.sweep", self.losses.sweep),
            ("losses.sweep_depth", self.losses.sweep_depth),
        ];
        if let Some((what, weight)) = sweep.into_iter().find(|(_, weight)| *weight > 0.0)
            && network.sweep_depths == 0
        {
            return wrong(
                what,
                weight.to_string(),
                "0 for a configuration without a plane sweep; `compact-sweep` and `compact-wide` have one",
            );
        }
        Ok(())
    }
}

impl DataSettings {
    /// The paths that are named.
    pub(crate) fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let robots = self.robots.iter_mut().map(|robot| &mut robot.urdf);
        let recorded = self.recorded.iter_mut().map(|clips| &mut clips.run);
        let frames = self.frames.iter_mut().map(|frames| &mut frames.folder);
        self.props.iter_mut().chain(robots).chain(recorded).chain(frames)
    }

    /// Checks every setting for a network of this patch side.
    ///
    /// # Errors
    /// The first setting that is out of its range.
    pub fn check(&self, patch: u32) -> Result<()> {
        let wrong = |what, value: String, rule| Err(Error::Setting { what, value, rule });
        let more = self.more_sizes.iter().map(|more| more.size);
        for [height, width] in more.chain([self.size]) {
            if height == 0 || width == 0 || height % patch != 0 || width % patch != 0 || height > 2160 || width > 3840 {
                let rule = "a multiple of the patch side (14)";
                return wrong("data.size", format!("{height} x {width}"), rule);
            }
        }
        let shares: Vec<f64> = self.more_sizes.iter().map(|more| more.share).collect();
        if shares.iter().any(|share| !(0.0..=1.0).contains(share)) || shares.iter().sum::<f64>() > 1.0 + 1e-9 {
            return wrong(
                "data.more_sizes",
                format!("{shares:?}"),
                "shares from 0 to 1, together at most 1",
            );
        }
        let [fewest, most] = self.source_cameras;
        if fewest < 1 || fewest > most || most > 4 {
            return wrong(
                "data.source_cameras",
                format!("{fewest} to {most}"),
                "ascending, from 1 to 4",
            );
        }
        if !(2..=1000).contains(&self.clip_frames) {
            return wrong("data.clip_frames", self.clip_frames.to_string(), "from 2 to 1000");
        }
        let [fewest, most] = self.source_times;
        if fewest < 1 || fewest > most || most > self.clip_frames {
            let rule = "at least 1, ascending, at most the frames of a clip";
            return wrong("data.source_times", format!("{fewest} to {most}"), rule);
        }
        if self.queries == 0 || self.queries > self.clip_frames {
            return wrong(
                "data.queries",
                self.queries.to_string(),
                "from 1 to the frames of a clip",
            );
        }
        if self.images_per_step < self.source_cameras[1] * most {
            let rule = "at least the most cameras times the most source times";
            return wrong("data.images_per_step", self.images_per_step.to_string(), rule);
        }
        if let Some(world) = &self.world {
            world.check()?;
            if self.calibration_noise.is_some() {
                let rule = "absent beside `data.world`, whose table `calibration` says it";
                return wrong("data.calibration_noise", format!("{:?}", self.calibration_noise), rule);
            }
        } else if self.props.is_some() || !self.robots.is_empty() {
            let rule = "beside a table `[data.world]`, which says how often it is used";
            return wrong("data.props or data.robots", "given".into(), rule);
        }
        sources::check(&self.recorded, &self.frames)?;
        for (what, share) in [
            ("data.conditioning_dropout", self.conditioning_dropout),
            ("data.anchoring_dropout", self.anchoring_dropout),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return wrong(what, share.to_string(), "a probability");
            }
        }
        Ok(())
    }
}

/// Refuses numbers that a device has no products of.
///
/// # Errors
/// When products of bfloat16 are asked for on another device than the CPU.
pub(crate) fn check_precision(precision: ProductPrecision, device: &Device) -> Result<()> {
    if precision != ProductPrecision::F32 && !device::is_cpu(device) {
        return Err(Error::Setting {
            what: "precision",
            value: "bf16".into(),
            rule: "`f32` with `--device gpu`",
        });
    }
    Ok(())
}

/// Settings of a TOML file. Relative ones of the paths that they hold are taken from the file's folder and made absolute,
/// so that they still hold when the settings lie in a run's folder.
pub(crate) fn read_toml<T: DeserializeOwned>(path: &Path, paths: fn(&mut T) -> Vec<&mut PathBuf>) -> Result<T> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path))?;
    let mut settings = toml::from_str(&text).map_err(|error| Error::Configuration {
        path: path.to_owned(),
        reason: error.to_string(),
    })?;
    let folder = path.parent().unwrap_or(Path::new("."));
    for named in paths(&mut settings) {
        let joined = folder.join(&*named);
        *named = std::path::absolute(&joined).map_err(Error::io(&joined))?;
    }
    Ok(settings)
}

/// When a run writes and scores. Every kind of settings holds these three numbers itself: serde cannot flatten a struct into
/// one that refuses unknown names.
#[derive(Debug, Clone, Copy)]
pub struct Cadence {
    /// Updates of the whole schedule.
    pub steps: u64,
    /// Updates from one checkpoint to the next.
    pub checkpoint_every: u64,
    /// Updates from one scoring of held-out clips to the next.
    pub evaluate_every: u64,
}

impl Cadence {
    /// Checks that there is something to do.
    ///
    /// # Errors
    /// When there are no updates or an interval is empty.
    pub fn check(&self) -> Result<()> {
        for (what, value) in [
            ("steps", self.steps),
            ("checkpoint_every", self.checkpoint_every),
            ("evaluate_every", self.evaluate_every),
        ] {
            if value == 0 {
                return Err(Error::Setting {
                    what,
                    value: value.to_string(),
                    rule: "at least 1",
                });
            }
        }
        Ok(())
    }
}
