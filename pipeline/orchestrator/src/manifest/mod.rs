//! The manifest: what a person asks for, as TOML.

mod check;
mod cut;
mod read;
mod size;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

pub use rogs_schemas::ids::{is_safe_name, safe_name};
use rogs_schemas::overlay;
use rogs_schemas::records::clip::{RECORDED, ROLLOUT};
use rogs_schemas::records::robot::RobotSpec;
use rogs_schemas::robots::{DEFAULT_PRESET, preset};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

pub use self::cut::ClipCount;
pub(crate) use self::cut::Cut;
pub use self::size::parse_size;
use crate::stage::{StageId, WeightsRole};

/// Most worker processes at a time.
pub const MOST_WORKERS: usize = 1024;

/// Clips with pictures in a report that says nothing else.
pub const PICTURE_CLIPS: usize = 24;

/// A table of parameters of one stage; its names are those of `rogs-STAGE describe`.
pub type Params = Map<String, Value>;

/// A manifest as it is written. Paths are relative to the manifest's folder until [`Manifest::load`] made them absolute.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Manifest {
    /// Name and place of the run.
    pub run: Run,
    /// A folder with many episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input: Option<Input>,
    /// Single episodes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub episodes: Vec<Episode>,
    /// The robot in the episodes.
    pub robot: Robot,
    /// Network weights. Without this table the built-in networks run.
    #[serde(default)]
    pub weights: Weights,
    /// What others estimated from the clips' images, for the baseline Shape of Motion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sidecars: Option<Sidecars>,
    /// Latents of a video tokenizer, for runs and variants whose `lift` has `tokens = "latents"`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latents: Option<Latents>,
    /// Rollouts of the clips: frames of a world model to reconstruct instead of the recorded ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollouts: Option<Rollouts>,
    /// Parameters of `ingest`.
    #[serde(default)]
    pub ingest: Params,
    /// Parameters of `robot-maps`.
    #[serde(default)]
    pub robot_maps: Params,
    /// Parameters of `conditioning`.
    #[serde(default)]
    pub conditioning: Params,
    /// Parameters of `agreement`: whether the robot lies on the images. `agreement = false` in `[run]` leaves it out.
    #[serde(default)]
    pub agreement: Params,
    /// Parameters of `references`, which runs where this table is there: depth by stereo and robot tracks by kinematics, for
    /// clips that come without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub references: Option<Params>,
    /// Parameters of `lift` (Stage 1).
    #[serde(default)]
    pub lift: Params,
    /// Parameters of `refine` (Stage 2).
    #[serde(default)]
    pub refine: Params,
    /// Parameters of `fit`, which runs where this table is there: the field of each clip, optimised against its source
    /// images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit: Option<Params>,
    /// Parameters of `score`.
    #[serde(default)]
    pub score: Params,
    /// Ablations and baselines beside the run above. What they have in common with it is computed once.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub variants: Vec<Variant>,
    /// Methods whose predictions are files, scored beside the run by the same code.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub predictions: Vec<Prediction>,
    /// Baselines of the paper that run here, beside the run above and on the same clips: own outputs, own rows.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub baselines: Vec<Baseline>,
    /// How the work is spread over this machine. Nothing here changes a result.
    #[serde(default)]
    pub executor: Executor,
    /// What the job scripts for Slurm ask for.
    #[serde(default)]
    pub slurm: Slurm,
    /// The report.
    #[serde(default)]
    pub report: Report,
}

/// Name and place of the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Run {
    /// Name for titles.
    pub name: String,
    /// The run folder; made when it is not there. Default: `runs/NAME` beside the manifest.
    #[serde(default)]
    pub out: PathBuf,
    /// The last stages to run; default: all. Stages that these need are added.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stages: Vec<StageId>,
    /// Whether the run checks that the robot lies on the images, and warns where it does not (stage `agreement`). Default:
    /// true where `stages` names none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agreement: Option<bool>,
    /// What is reconstructed: `recorded` images, the `rollout` of `[rollouts]`, or `both`, each with scores of its own against
    /// the same recorded references. Default: both where there is `[rollouts]`.
    #[serde(default)]
    pub setting: Option<String>,
}

/// A folder with many episodes, in any layout that ingest knows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Input {
    /// The folder.
    pub root: PathBuf,
    /// Take only episodes of this layout (`rogs-episode`, `droid-raw`, `droid-ctrlworld`, `lerobot-v2.1`, `lerobot-v3.0`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layout: Option<String>,
    /// Take only episodes whose id matches one of these patterns (`*`, `?`); default all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub include: Vec<String>,
    /// Leave out episodes whose id matches one of these patterns.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exclude: Vec<String>,
    /// Take the episodes of this `selection.json` that `rogs cohort` wrote, in its order and under its clip names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub selection: Option<PathBuf>,
    /// Take at most this many episodes, in the order of their ids (of the selection, where there is one).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<usize>,
    /// How many clips are cut from each episode: `"all"` that fit, or at most so many. Default: one, where `ingest`
    /// starts it (frame 7, as in the paper, unless the episode has tracks or is too short).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clips: Option<ClipCount>,
    /// Episode frames from the start of one clip to the start of the next; default: the length of a clip.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stride: Option<u32>,
    /// Episode frame at which the first clip starts; default 0 where `clips` is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<u32>,
    /// Calibration file for all of them, where the layout has none of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
    /// Folder with caches of PointWorld; an episode finds its own there by its id.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pointworld: Option<PathBuf>,
    /// Parameters of `ingest` for these episodes only.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub ingest: Params,
}

/// One episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Episode {
    /// The folder that holds it.
    pub root: PathBuf,
    /// Which episode of the folder, by its id or selector; may be left out when there is only one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub select: Option<String>,
    /// Name of the clip (`[A-Za-z0-9._+-]{1,128}`); default: made from the episode's id.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// How many clips are cut from it: `"all"` that fit, or at most so many. Default: one, where `ingest`
    /// starts it (frame 7, as in the paper, unless the episode has tracks or is too short).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clips: Option<ClipCount>,
    /// Episode frames from the start of one clip to the start of the next; default: the length of a clip.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stride: Option<u32>,
    /// Episode frame at which the first clip starts; default 0 where `clips` is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<u32>,
    /// Calibration file, where the layout has none of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
    /// Folder with caches of PointWorld; an episode finds its own there by its id.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pointworld: Option<PathBuf>,
    /// Parameters of `ingest` for this episode only.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub ingest: Params,
}

/// The robot in the episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Robot {
    /// Its URDF. The whole folder it lies in, with the meshes, counts as the robot.
    pub urdf: PathBuf,
    /// A known robot to start from: `panda-robotiq-2f85` (default), `panda-hand`, `ur5e`, `xarm7`, `iiwa`, `so101`,
    /// `viperx-300s`, `kinova-gen3`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// What differs from the preset: joints, meshes, tool (see `RobotSpec`).
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub spec: Params,
}

/// Weights by stage.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Weights {
    /// Stage-1 checkpoint: a file; `builtin` (default), made for images of 154x84; or `seeded`, random values that lift
    /// nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lift: Option<Network>,
    /// Stage-2 checkpoint: a file; `builtin` (default), for `preset = "ci"`; or `seeded`, which corrects nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refine: Option<Network>,
    /// LPIPS weights for scoring.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<PathBuf>,
    /// Adapter that makes Stage-1 tokens of latents; read where `lift` has `tokens = "latents"`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adapter: Option<PathBuf>,
    /// Checkpoint of the baseline MoVieS, imported as Stage 1's; or `seeded`, random values that lift nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub movies: Option<Network>,
    /// Checkpoint of the baseline 4DGT; or `seeded`.
    #[serde(default, rename = "4dgt", skip_serializing_if = "Option::is_none")]
    pub four_dgt: Option<Network>,
    /// Checkpoint of the image encoder of 4DGT (DINOv2 ViT-B/14); or `seeded`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dinov2: Option<Network>,
}

/// Where the weights of a network come from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "PathBuf", into = "PathBuf")]
#[schemars(with = "PathBuf")]
pub enum Network {
    /// `builtin`: the file inside the program.
    Builtin,
    /// `seeded`: random values.
    Seeded,
    /// A file; one that is named as the others are is written `./builtin`.
    File(PathBuf),
}

/// What `[weights]` says of a role.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chosen<'a> {
    /// A word in place of a file: `builtin` or `seeded`.
    Word(&'static str),
    /// A file.
    File(&'a Path),
}

const BUILTIN: &str = "builtin";
/// Random values in place of a file.
pub(crate) const SEEDED: &str = "seeded";

impl Network {
    fn chosen(&self) -> Chosen<'_> {
        match self {
            Self::Builtin => Chosen::Word(BUILTIN),
            Self::Seeded => Chosen::Word(SEEDED),
            Self::File(path) => Chosen::File(path),
        }
    }
}

impl From<PathBuf> for Network {
    fn from(path: PathBuf) -> Self {
        match path.to_str() {
            Some(BUILTIN) => Self::Builtin,
            Some(SEEDED) => Self::Seeded,
            _ => Self::File(path),
        }
    }
}

impl From<Network> for PathBuf {
    fn from(network: Network) -> Self {
        match network {
            Network::Builtin => BUILTIN.into(),
            Network::Seeded => SEEDED.into(),
            Network::File(path) => path,
        }
    }
}

/// Latents of a video tokenizer, one file a clip. `docs/latents-format.md` says what lies in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Latents {
    /// The folder that holds `CLIP.safetensors` for every clip, named by the clip's id. A clip without one fails where
    /// latents are asked for; everything else is made.
    pub root: PathBuf,
}

/// Depth and tracks that others estimated from the clips' images, one folder a clip. `docs/sidecars.md` says what lies in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Sidecars {
    /// The folder that holds a folder for every clip, named by the clip's id. A clip without one fails where sidecars are asked
    /// for; everything else is made.
    pub root: PathBuf,
}

/// Rollouts of a world model, one video or folder a clip. `docs/rollouts.md` says what may lie in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Rollouts {
    /// The folder that holds a video or a folder for every clip, named by the clip's id or its episode's, or Ctrl-World
    /// replays as they are written. A clip without one fails in its rollout; everything recorded is made.
    pub root: PathBuf,
    /// The world model, in words for reports.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Where the views are: `composite` (Cosmos 3), `views`, `ctrl-world`. Default: told by the files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layout: Option<String>,
    /// Frame of the files that shows clip frame 0. Default 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_frame: Option<u32>,
    /// Frames that every file has. Default: those that the clip needs and no more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames: Option<u32>,
    /// Frames per second of the files, where their headers do not say or are wrong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fps: Option<f64>,
    /// Of padded composites: target height and width, content height and width. Default: told from the frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_size: Option<[u32; 4]>,
    /// The first generated frame must be this close to the first recorded one, dB of PSNR. Default 20.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_first_frame_psnr_db: Option<f64>,
    /// The folder that holds `CLIP.safetensors` with the latents of every rollout, where `lift` has `tokens = "latents"`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latents: Option<PathBuf>,
    /// The folder that holds a folder for every clip with what was estimated from its rollout, for the baseline Shape of Motion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sidecars: Option<PathBuf>,
}

/// What a variant does differently. Parameters are laid over those of the run, name by name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Variant {
    /// Name of its rows in the tables (`[A-Za-z0-9._+-]{1,128}`).
    pub name: String,
    /// Other weights.
    #[serde(default)]
    pub weights: Weights,
    /// Parameters of `ingest`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub ingest: Params,
    /// Parameters of `robot-maps`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub robot_maps: Params,
    /// Parameters of `conditioning`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub conditioning: Params,
    /// Parameters of `agreement`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub agreement: Params,
    /// Parameters of `references`, which runs where this table is there or the run has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub references: Option<Params>,
    /// Parameters of `lift`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub lift: Params,
    /// Parameters of `refine`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub refine: Params,
    /// Parameters of `fit`, which runs where this table is there or the run has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit: Option<Params>,
    /// Parameters of `score`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub score: Params,
}

/// An outside method: its predictions are files, one folder a clip. `docs/predictions.md` says what may lie in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Prediction {
    /// Name of its rows in the tables (`[A-Za-z0-9._+-]{1,128}`, `+` stands for `/`): `movies`, `4dgt`, `som`, your own.
    pub name: String,
    /// The folder that holds a folder of files for every clip, named by the clip's id. A clip without one is left out of
    /// the method's means.
    pub root: PathBuf,
    /// Frame of its fields: `base` (default) or `camera`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
    /// What they were made from: `recorded` or `rollout` observations. Default: the first that the run has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub setting: Option<String>,
    /// How its lengths become metres: `none` (default) or `source-depth`, one factor per camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<String>,
    /// Parameters of `score`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub score: Params,
}

/// A baseline of the paper that runs here. `docs/baselines.md` says what each needs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Baseline {
    /// Which: `movies`, `4dgt` or `som`.
    pub method: String,
    /// Name of its rows in the tables (`[A-Za-z0-9._+-]{1,128}`, `+` stands for `/`). Default: the method.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Parameters of the stage that makes its field: of `lift` for MoVieS, of `lift-4dgt` for 4DGT, of `lift-som` for Shape of
    /// Motion.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub lift: Params,
    /// Parameters of `score`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub score: Params,
}

impl Baseline {
    /// Name of its rows as the manifest writes it.
    #[must_use]
    pub fn name(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.method)
    }
}

/// How the work is spread over this machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Executor {
    /// Worker processes at a time. Default: one per two cores, at least one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub workers: Option<usize>,
    /// Threads of each worker. Default: cores / workers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    /// Memory that all workers together may take, `"12 GiB"`. Default: 85 % of what is free.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<String>,
    /// Memory that one worker of a stage is expected to take, by stage, until it has been measured.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub stage_memory: BTreeMap<StageId, String>,
    /// Seconds after which a clip is given up, by stage. Default: none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub deadline: BTreeMap<StageId, f64>,
    /// Seconds that clips in hand may still take after Ctrl-C. Default 10.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grace: Option<f64>,
    /// Folder with the programs `rogs-STAGE`. Default: the stages inside `rogs` itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub programs: Option<PathBuf>,
}

/// What the job scripts for Slurm ask for.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Slurm {
    /// Array elements; each takes the same number of clips. Default: one per 16 clips, at most 1000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shards: Option<u32>,
    /// Array elements of a stage that may run at the same time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_once: Option<u32>,
    /// Partition.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub partition: Option<String>,
    /// Account.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub account: Option<String>,
    /// Wall time of one array element, `"04:00:00"`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<String>,
    /// Cores of one array element, by stage; default 1.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub cpus: BTreeMap<StageId, u32>,
    /// Memory of one array element, by stage, `"8 GiB"`; default: what was measured plus a third, else 4 GiB.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub memory: BTreeMap<StageId, String>,
    /// Generic resources, by stage, `"gpu:1"`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub gres: BTreeMap<StageId, String>,
    /// More `#SBATCH` options, verbatim, such as `"--qos=low"`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub extra: Vec<String>,
    /// Shell lines before the program starts, such as `"module load ffmpeg"`. The first that fails ends the job.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub setup: Vec<String>,
    /// What runs the scripts, default `"/bin/sh"`; `"/bin/bash -l"` where `module` is a function of a login shell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shell: Option<String>,
    /// How memory is asked for: `node` (default, `--mem`), `cpu` (`--mem-per-cpu`), or `none` where the site gives it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_by: Option<MemoryBy>,
    /// Words before the program, such as `["apptainer", "exec", "--bind", "/scratch", "rogs.sif"]`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub wrap: Vec<String>,
    /// The program `rogs` as jobs call it, such as `"rogs"` inside a container. Default: the one that submits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<String>,
}

/// How job scripts ask for memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MemoryBy {
    /// For an array element as a whole.
    #[default]
    Node,
    /// For each of its cores.
    Cpu,
    /// Not at all.
    None,
}

/// The report.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Report {
    /// Clips with pictures; all clips are in the tables. Default 24.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clips: Option<usize>,
}

/// Parameters of a stage whose table is not there.
static NO_PARAMS: LazyLock<Params> = LazyLock::new(Params::new);

/// `params(stage)` for a table that has one table per stage. serde could flatten a shared struct into both, but then its
/// errors lose their line, their column and the names that are known.
macro_rules! stage_tables {
    ($table:ty) => {
        impl $table {
            /// Whether it asks for a stage that has to be asked for.
            #[must_use]
            pub fn asks(&self, stage: StageId) -> bool {
                match stage {
                    StageId::References => self.references.is_some(),
                    StageId::Fit => self.fit.is_some(),
                    _ => false,
                }
            }

            /// Parameters that it gives a stage.
            #[must_use]
            pub fn params(&self, stage: StageId) -> &Params {
                match stage {
                    StageId::Ingest => &self.ingest,
                    StageId::RobotMaps => &self.robot_maps,
                    StageId::Conditioning => &self.conditioning,
                    StageId::Agreement => &self.agreement,
                    StageId::References => self.references.as_ref().unwrap_or(&NO_PARAMS),
                    StageId::Lift => &self.lift,
                    // Their parameters are those of a baseline.
                    StageId::Lift4dgt | StageId::LiftSom => &NO_PARAMS,
                    StageId::Refine => &self.refine,
                    StageId::Fit => self.fit.as_ref().unwrap_or(&NO_PARAMS),
                    StageId::Score => &self.score,
                }
            }
        }
    };
}

stage_tables!(Manifest);
stage_tables!(Variant);

impl Manifest {
    /// The robot's spec: the preset with the manifest's changes. Its names are checked when the manifest is read.
    ///
    /// # Errors
    /// When a value has the wrong type.
    pub fn robot_spec(&self) -> std::result::Result<RobotSpec, String> {
        let name = self.robot.preset.as_deref().unwrap_or(DEFAULT_PRESET);
        let known = preset(name).ok_or_else(|| format!("unknown robot preset `{name}`"))?;
        let mut spec = serde_json::to_value(known.spec()).map_err(|error| error.to_string())?;
        overlay(&mut spec, &Value::Object(self.robot.spec.clone()));
        serde_json::from_value(spec).map_err(|error| error.to_string())
    }

    /// JSON schema of manifests, for editors.
    #[must_use]
    pub fn json_schema() -> Value {
        schemars::schema_for!(Self).to_value()
    }
}

impl Prediction {
    /// How its files are meant, as the stage that scores them takes it.
    pub(crate) fn options(&self) -> Params {
        let given = [("frame", &self.frame), ("scale", &self.scale)];
        let given = given
            .into_iter()
            .filter_map(|(name, value)| Some((name.to_owned(), value.clone()?.into())));
        given.collect()
    }
}

impl Rollouts {
    /// How its files lie, as the stage that reads them takes it.
    pub(crate) fn options(&self) -> Params {
        let given: [(&str, Option<Value>); 7] = [
            ("model", self.model.clone().map(Value::from)),
            ("layout", self.layout.clone().map(Value::from)),
            ("first_frame", self.first_frame.map(Value::from)),
            ("frames", self.frames.map(Value::from)),
            ("fps", self.fps.map(Value::from)),
            ("image_size", self.image_size.map(|size| Value::from(size.to_vec()))),
            ("min_first_frame_psnr_db", self.min_first_frame_psnr_db.map(Value::from)),
        ];
        let given = given
            .into_iter()
            .filter_map(|(name, value)| Some((name.to_owned(), value?)));
        given.collect()
    }
}

/// What a run reconstructs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Setting {
    /// Recorded images.
    Recorded,
    /// Frames of a world model.
    Rollout,
}

impl Setting {
    /// Its name in manifests, parameters and score sheets.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Recorded => RECORDED,
            Self::Rollout => ROLLOUT,
        }
    }
}

/// [`Run::setting`] for a run of both settings.
const BOTH: &str = "both";

impl Manifest {
    /// What the run reconstructs, each with outputs and scores of its own; at least one.
    pub(crate) fn settings(&self) -> &'static [Setting] {
        match self.run.setting.as_deref() {
            Some(RECORDED) => &[Setting::Recorded],
            Some(ROLLOUT) => &[Setting::Rollout],
            Some(_) => &[Setting::Recorded, Setting::Rollout],
            None if self.rollouts.is_some() => &[Setting::Recorded, Setting::Rollout],
            None => &[Setting::Recorded],
        }
    }
}

impl Weights {
    /// The file for a role, or the word in place of one.
    #[must_use]
    pub fn get(&self, role: WeightsRole) -> Option<Chosen<'_>> {
        match role {
            WeightsRole::Lift => self.lift.as_ref().map(Network::chosen),
            WeightsRole::Refine => self.refine.as_ref().map(Network::chosen),
            WeightsRole::Lpips => self.lpips.as_deref().map(Chosen::File),
            WeightsRole::Adapter => self.adapter.as_deref().map(Chosen::File),
            WeightsRole::Movies => self.movies.as_ref().map(Network::chosen),
            WeightsRole::FourDgt => self.four_dgt.as_ref().map(Network::chosen),
            WeightsRole::Dinov2 => self.dinov2.as_ref().map(Network::chosen),
        }
    }
}
