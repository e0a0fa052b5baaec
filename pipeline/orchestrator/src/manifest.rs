//! The manifest: what a person asks for, as TOML.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use rogs_schemas::records::robot::RobotSpec;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::diagnose::{Text, from_toml_error};
use crate::error::{Error, Result, io};

/// Stages in the order of the pipeline.
pub const STAGES: [&str; 6] = ["ingest", "robot-maps", "conditioning", "lift", "refine", "score"];

/// Most bytes of a manifest that are read: more than 76,000 single episodes with paths of their own. What is made of the
/// text takes some forty times as much memory.
const MOST_BYTES: usize = 16 << 20;

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
    /// Files with network weights. Without one a network runs with seeded weights, which lift nothing; the report says so.
    #[serde(default)]
    pub weights: Weights,
    /// Latents of a video tokenizer, for runs and variants whose `lift` has `tokens = "latents"`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latents: Option<Latents>,
    /// Parameters of `ingest`.
    #[serde(default)]
    pub ingest: Params,
    /// Parameters of `robot-maps`.
    #[serde(default)]
    pub robot_maps: Params,
    /// Parameters of `conditioning`.
    #[serde(default)]
    pub conditioning: Params,
    /// Parameters of `lift` (Stage 1).
    #[serde(default)]
    pub lift: Params,
    /// Parameters of `refine` (Stage 2).
    #[serde(default)]
    pub refine: Params,
    /// Parameters of `score`.
    #[serde(default)]
    pub score: Params,
    /// Ablations and baselines beside the run above. What they have in common with it is computed once.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub variants: Vec<Variant>,
    /// Methods whose predictions are files, scored beside the run by the same code.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub predictions: Vec<Prediction>,
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
    pub stages: Vec<String>,
    /// `recorded` or `rollout`: where the images come from, for the score tables.
    #[serde(default)]
    pub setting: Option<String>,
}

/// A folder with many episodes, in any layout that ingest knows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Input {
    /// The folder.
    pub root: PathBuf,
    /// Take only episodes of this layout (`rogs-episode`, `droid-ctrlworld`, `lerobot-v2.1`, `lerobot-v3.0`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layout: Option<String>,
    /// Take only episodes whose id matches one of these patterns (`*`, `?`); default all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub include: Vec<String>,
    /// Leave out episodes whose id matches one of these patterns.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exclude: Vec<String>,
    /// Take at most this many, in the order of their ids.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<usize>,
    /// Calibration file for all of them, where the layout has none of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
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
    /// Calibration file, where the layout has none of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
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
    /// A known robot to start from: `panda-robotiq-2f85` (default).
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
    /// Stage-1 checkpoint.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lift: Option<PathBuf>,
    /// Stage-2 checkpoint.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refine: Option<PathBuf>,
    /// LPIPS weights for scoring.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<PathBuf>,
    /// Adapter that makes Stage-1 tokens of latents; read where `lift` has `tokens = "latents"`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adapter: Option<PathBuf>,
}

/// Latents of a video tokenizer, one file a clip. `docs/latents-format.md` says what lies in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Latents {
    /// The folder that holds `CLIP.safetensors` for every clip, named by the clip's id. A clip without one fails where
    /// latents are asked for; everything else goes on.
    pub root: PathBuf,
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
    /// Parameters of `lift`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub lift: Params,
    /// Parameters of `refine`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub refine: Params,
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
    /// How its lengths become metres: `none` (default) or `source-depth`, one factor per camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<String>,
    /// Parameters of `score`.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub score: Params,
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
    pub stage_memory: BTreeMap<String, String>,
    /// Seconds after which a clip is given up, by stage. Default: none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub deadline: BTreeMap<String, f64>,
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
    pub cpus: BTreeMap<String, u32>,
    /// Memory of one array element, by stage, `"8 GiB"`; default: what was measured plus a third, else 4 GiB.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub memory: BTreeMap<String, String>,
    /// Generic resources, by stage, `"gpu:1"`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub gres: BTreeMap<String, String>,
    /// More `#SBATCH` options, verbatim, such as `"--qos=low"`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub extra: Vec<String>,
    /// Shell lines before the program starts, such as `"module load ffmpeg"`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub setup: Vec<String>,
}

/// The report.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Report {
    /// Clips with pictures; all clips are in the tables. Default 24.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clips: Option<usize>,
}

/// The text of a manifest file.
fn read(path: &Path) -> Result<String> {
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Error::usage(format!("there is no manifest `{}`", path.display()))
            .with_hint("name a TOML file such as those in `manifests/`, or a run folder"),
        _ => io("cannot read the manifest", path)(error),
    })?;
    file.take(MOST_BYTES as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(io("cannot read the manifest", path))?;
    if bytes.len() > MOST_BYTES {
        let message = format!(
            "the manifest `{}` is larger than {} MiB",
            path.display(),
            MOST_BYTES >> 20
        );
        return Err(Error::usage(message).with_hint(
            "name a folder of episodes under `[input]`; `include` and `exclude` take some of them; or split the run",
        ));
    }
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let line = error.as_bytes()[..at].iter().filter(|&&byte| byte == b'\n').count() + 1;
        Error::usage(format!("`{}` line {line}: no UTF-8 text", path.display())).with_hint("save the manifest as UTF-8")
    })
}

impl Manifest {
    /// Reads and checks a manifest file and makes its paths absolute.
    ///
    /// # Errors
    /// When it cannot be read, is no TOML, has unknown names or wrong values; with line and column.
    pub fn load(path: &Path) -> Result<(Self, Text)> {
        let text = read(path)?;
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let folder = std::path::absolute(folder).map_err(io("cannot find", folder))?;
        Self::parse(&text, path, &folder)
    }

    /// The same from text; relative paths are taken from `folder`.
    ///
    /// # Errors
    /// See [`Manifest::load`].
    pub fn parse(text: &str, path: &Path, folder: &Path) -> Result<(Self, Text)> {
        let source = Text::new(path, text);
        let mut manifest: Self = toml::from_str(text).map_err(|error| from_toml_error(&source, &error))?;
        manifest.make_absolute(folder);
        manifest.check(&source)?;
        Ok((manifest, source))
    }

    /// Parameters of a stage in the run itself.
    #[must_use]
    pub fn params(&self, stage: &str) -> &Params {
        match stage {
            "ingest" => &self.ingest,
            "robot-maps" => &self.robot_maps,
            "conditioning" => &self.conditioning,
            "lift" => &self.lift,
            "refine" => &self.refine,
            _ => &self.score,
        }
    }

    /// The robot's spec: the preset with the manifest's changes. Its names are checked when the manifest is read.
    ///
    /// # Errors
    /// When a value has the wrong type.
    pub fn robot_spec(&self) -> std::result::Result<RobotSpec, String> {
        serde_json::from_value(Value::Object(self.robot.spec.clone())).map_err(|error| error.to_string())
    }

    /// JSON schema of manifests, for editors.
    #[must_use]
    pub fn json_schema() -> Value {
        schemars::schema_for!(Self).to_value()
    }

    fn make_absolute(&mut self, folder: &Path) {
        let fix = |path: &mut PathBuf| *path = normalise(&folder.join(&*path));
        let fix_some = |path: &mut Option<PathBuf>| path.iter_mut().for_each(fix);
        if self.run.out.as_os_str().is_empty() {
            self.run.out = Path::new("runs").join(safe_name(&self.run.name));
        }
        fix(&mut self.run.out);
        fix(&mut self.robot.urdf);
        if let Some(input) = &mut self.input {
            fix(&mut input.root);
            fix_some(&mut input.calibration);
        }
        for episode in &mut self.episodes {
            fix(&mut episode.root);
            fix_some(&mut episode.calibration);
        }
        self.predictions
            .iter_mut()
            .for_each(|prediction| fix(&mut prediction.root));
        self.latents.iter_mut().for_each(|latents| fix(&mut latents.root));
        let weights =
            std::iter::once(&mut self.weights).chain(self.variants.iter_mut().map(|variant| &mut variant.weights));
        for weights in weights {
            for path in [
                &mut weights.lift,
                &mut weights.refine,
                &mut weights.lpips,
                &mut weights.adapter,
            ] {
                fix_some(path);
            }
        }
        fix_some(&mut self.executor.programs);
    }

    fn check(&self, text: &Text) -> Result<()> {
        if self.input.is_none() && self.episodes.is_empty() {
            let error = text.error(&[], "the manifest names no episodes");
            return Err(error.with_hint("add [[episodes]] with root = \"FOLDER\", or [input] with root = \"FOLDER\""));
        }
        for stage in &self.run.stages {
            text.check_stage(&["run", "stages"], stage)?;
        }
        if self
            .run
            .setting
            .as_deref()
            .is_some_and(|setting| !["recorded", "rollout"].contains(&setting))
        {
            return Err(text.error(&["run", "setting"], "`setting` must be `recorded` or `rollout`"));
        }
        let known = ["panda-robotiq-2f85"];
        if let Some(preset) = self.robot.preset.as_deref().filter(|preset| !known.contains(preset)) {
            let error = text.error(&["robot", "preset"], format!("unknown robot preset `{preset}`"));
            return Err(error.with_hint(format!("known: {}; describe others in [robot.spec]", known.join(", "))));
        }
        self.robot_spec()
            .map_err(|why| text.unknown(&["robot", "spec"], &why))?;
        let mut names = std::collections::BTreeSet::from(["main".to_owned()]);
        for variant in &self.variants {
            if !is_safe_name(&variant.name) {
                let message = format!(
                    "`{}` is no name for a variant: use letters, digits and . _ + -",
                    variant.name
                );
                return Err(text.error(&["variants"], message));
            }
            if !names.insert(variant.name.to_lowercase()) {
                return Err(text.error(&["variants"], format!("two variants are named `{}`", variant.name)));
            }
        }
        let mut names = std::collections::BTreeSet::new();
        for prediction in &self.predictions {
            if !is_safe_name(&prediction.name) {
                let message = format!(
                    "`{}` is no name for predictions: use letters, digits and . _ + -",
                    prediction.name
                );
                return Err(text.error(&["predictions"], message));
            }
            if !names.insert(prediction.name.to_lowercase()) {
                let message = format!("two predictions are named `{}`", prediction.name);
                return Err(text.error(&["predictions"], message));
            }
        }
        for id in self.episodes.iter().filter_map(|episode| episode.id.as_deref()) {
            if !is_safe_name(id) {
                let message = format!("`{id}` is no name for a clip: use 1 to 128 letters, digits and . _ + -");
                return Err(text.error(&["episodes"], message));
            }
        }
        let executor = &self.executor;
        for (table, stages) in [
            ("stage-memory", executor.stage_memory.keys().collect()),
            ("deadline", executor.deadline.keys().collect::<Vec<_>>()),
        ] {
            for stage in stages {
                text.check_stage(&["executor", table, stage], stage)?;
            }
        }
        let sizes = executor
            .memory
            .iter()
            .chain(executor.stage_memory.values())
            .chain(self.slurm.memory.values());
        for size in sizes {
            parse_size(size).map_err(|why| text.error(&["executor"], why))?;
        }
        if executor.workers == Some(0) || executor.threads == Some(0) {
            return Err(text.error(&["executor"], "workers and threads must be at least 1"));
        }
        let slurm = self
            .slurm
            .cpus
            .keys()
            .chain(self.slurm.memory.keys())
            .chain(self.slurm.gres.keys());
        for stage in slurm {
            text.check_stage(&["slurm"], stage)?;
        }
        Ok(())
    }
}

impl Variant {
    /// What the variant changes in the parameters of a stage.
    #[must_use]
    pub fn params(&self, stage: &str) -> &Params {
        match stage {
            "ingest" => &self.ingest,
            "robot-maps" => &self.robot_maps,
            "conditioning" => &self.conditioning,
            "lift" => &self.lift,
            "refine" => &self.refine,
            _ => &self.score,
        }
    }
}

impl Weights {
    /// The file for an input role of a stage.
    #[must_use]
    pub fn of(&self, stage: &str, role: &str) -> Option<&PathBuf> {
        match (stage, role) {
            ("lift", "weights") => self.lift.as_ref(),
            ("refine", "weights") => self.refine.as_ref(),
            ("score", "lpips") => self.lpips.as_ref(),
            ("lift", "adapter") => self.adapter.as_ref(),
            _ => None,
        }
    }
}

/// Bytes of a size such as `12 GiB`, `800MB` or `1.5 GiB`.
///
/// # Errors
/// When it is no size.
pub fn parse_size(text: &str) -> std::result::Result<u64, String> {
    let trimmed = text.trim();
    let digits = trimmed
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(trimmed.len());
    let unit: f64 = match trimmed[digits..].trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        "k" | "kib" => 1024.0,
        "m" | "mib" => 1_048_576.0,
        "g" | "gib" => 1_073_741_824.0,
        "t" | "tib" => 1_099_511_627_776.0,
        _ => return Err(format!("`{text}` is no size; write for example \"12 GiB\"")),
    };
    let number: f64 = trimmed[..digits]
        .parse()
        .map_err(|_| format!("`{text}` is no size; write for example \"12 GiB\""))?;
    Ok((number * unit) as u64)
}

/// True for names that are safe as file names everywhere: `[A-Za-z0-9._+-]{1,128}`, not starting with `.` or `-`.
#[must_use]
pub fn is_safe_name(name: &str) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"._+-".contains(&byte);
    (1..=128).contains(&name.len()) && name.bytes().all(allowed) && !name.starts_with(['.', '-'])
}

/// A safe name made from any text: other characters become `_`.
#[must_use]
pub fn safe_name(text: &str) -> String {
    let safe = |c: char| {
        if c.is_ascii_alphanumeric() || "._+-".contains(c) {
            c
        } else {
            '_'
        }
    };
    let mut name: String = text.chars().take(128).map(safe).collect();
    if name.is_empty() || name.starts_with(['.', '-']) {
        name.insert(0, '_');
        name.truncate(128);
    }
    name
}

/// Removes `.` and `x/..` from a path by its text alone.
fn normalise(path: &Path) -> PathBuf {
    use std::path::Component;
    let mut out = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            // A link may point elsewhere, so only a plain name before `..` that is no link may be dropped.
            Component::ParentDir if out.file_name().is_some() && !out.is_symlink() => {
                out.pop();
            }
            other => out.push(other),
        }
    }
    out
}
