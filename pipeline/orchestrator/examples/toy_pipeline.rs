//! A pipeline of toy stages in one program, as `rogs` is one: `toy_pipeline stage NAME one|worker|describe ...`.
//!
//! An episode is a text file `NAME.txt`. Its words make stages misbehave: `fail@lift`, `panic@lift`, `abort@lift`,
//! `kill@lift`, `hang@lift`, `stop@lift` (hears no signal but KILL), `io@lift` (fails the first time only), `memory@lift`
//! (takes 300 MB). All records are real ones, small, with pictures in them, so that everything that reads run folders can
//! be tested without the networks.
//!
//! Tests that stop a run at a certain moment set `ROGS_TOY_HOLD=CLIP@STAGE@begin|end` and `ROGS_TOY_FOLDER`: the worker
//! that gets there first writes its process number to `held` in that folder and waits for a file `release`. Every worker
//! holds a shared lock on the file `alive` there, so that a test can wait until all have ended.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use rogs_orchestrator::executor::ProgressMode;
use rogs_orchestrator::programs::StagePrograms;
use rogs_orchestrator::{Error, Exit, Interrupts, Prepared};
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::record::{Record, SchemaId};
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, DepthReference, RobotStates};
use rogs_schemas::records::conditioning::{Conditioning, GripperPrior, ViewConditioning};
use rogs_schemas::records::field::{Field, RAW_CHANNELS, TimeSlice, WeightsInfo};
use rogs_schemas::records::refinement::{Refinement, ScaleResidual};
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps, RobotSpec};
use rogs_schemas::records::scores::{ImageScore, RenderedView, RobotDepthScore, ScoreSheet, Scores, TrackScore};
use rogs_schemas::{Intrinsics, RigidPose};
use rogs_worker::{Context, Stage, StageError, StageResult, stage_main_from};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

const HEIGHT: usize = 22;
const WIDTH: usize = 40;
const FRAMES: usize = 3;

fn input(role: &str, required: bool, kind: &str) -> InputDescription {
    InputDescription {
        role: role.into(),
        required,
        kind: kind.into(),
    }
}

/// Waits where a test wants the run to stand still, once: see the head of this file.
fn hold(context: &Context<'_>, stage: &str, moment: &str) {
    let place = format!("{}@{stage}@{moment}", context.clip_id());
    let (Some(folder), Ok(wanted)) = (hold_folder(), std::env::var("ROGS_TOY_HOLD")) else {
        return;
    };
    if wanted != place {
        return;
    }
    // Complete before it has its name, so that nobody reads half a number.
    let (number, held) = (folder.join(format!("held-{}", std::process::id())), folder.join("held"));
    if held.exists() || std::fs::write(&number, std::process::id().to_string()).is_err() {
        return;
    }
    let first = std::fs::hard_link(&number, &held).is_ok();
    let _ = std::fs::remove_file(&number);
    while first && !folder.join("release").exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn hold_folder() -> Option<PathBuf> {
    std::env::var_os("ROGS_TOY_FOLDER").map(PathBuf::from)
}

/// Tells that this worker lives, for as long as it does.
fn keep_alive_lock() {
    let open = |folder: PathBuf| std::fs::File::create(folder.join("alive"));
    if let Some(Ok(file)) = hold_folder().map(open)
        && file.lock_shared().is_ok()
    {
        std::mem::forget(file);
    }
}

/// Writes the output, with a moment behind it at which tests may want to stand.
fn write<T: Record>(context: &mut Context<'_>, stage: &str, record: &T) -> StageResult<()> {
    context.write(record)?;
    hold(context, stage, "end");
    Ok(())
}

/// Does what the episode's words say for this stage; the words travel in the clip's task.
fn misbehave(words: &str, stage: &str, context: &Context<'_>) -> StageResult<()> {
    hold(context, stage, "begin");
    for word in words.split_whitespace() {
        let Some((what, at)) = word.split_once('@') else {
            continue;
        };
        if at != stage {
            continue;
        }
        match what {
            "fail" => {
                return Err(
                    StageError::bad_input(format!("`{}` is made to fail", context.clip_id()))
                        .with_hint("edit the episode"),
                );
            }
            "panic" => panic!("a panic in {stage}"),
            "abort" => std::process::abort(),
            "kill" => drop(
                std::process::Command::new("sh")
                    .args(["-c", &format!("kill -s KILL {}", std::process::id())])
                    .status(),
            ),
            "hang" => std::thread::sleep(Duration::from_secs(600)),
            "stop" => drop(
                std::process::Command::new("sh")
                    .args(["-c", &format!("kill -s STOP {}", std::process::id())])
                    .status(),
            ),
            "memory" => {
                let block = std::hint::black_box(vec![1_u8; 300 << 20]);
                // Where so much is not allowed, Slurm notices within some seconds.
                let allowed = std::env::var("SLURM_MEM_PER_NODE")
                    .ok()
                    .and_then(|text| text.parse().ok());
                if allowed.is_some_and(|mebibytes: u64| mebibytes < 400) {
                    std::thread::sleep(Duration::from_secs(300));
                }
                drop(block);
            }
            "io" => {
                let marker = std::env::temp_dir().join(format!(
                    "rogs-toy-{}-{}",
                    context.clip_id(),
                    std::os::unix::process::parent_id()
                ));
                if std::fs::write(&marker, "").is_ok()
                    && std::fs::hard_link(&marker, marker.with_extension("seen")).is_ok()
                {
                    return Err(StageError::io("the disk hiccups"));
                }
                let _ = (
                    std::fs::remove_file(&marker),
                    std::fs::remove_file(marker.with_extension("seen")),
                );
            }
            _ => return Err(StageError::bad_input(format!("unknown word `{word}`"))),
        }
    }
    Ok(())
}

/// A toy picture: a gradient whose phase depends on the content.
fn picture(seed: u64, frame: usize) -> Vec<u8> {
    let pixel = |index: usize| {
        let (row, column) = (index / WIDTH, index % WIDTH);
        [
            (column * 6) as u8,
            (row * 11) as u8,
            (seed as usize * 37 + frame * 60) as u8,
        ]
    };
    (0..HEIGHT * WIDTH).flat_map(pixel).collect()
}

fn disc(row: usize, column: usize, frame: usize) -> bool {
    let (dy, dx) = (row as f64 - 11.0, column as f64 - 14.0 - 5.0 * frame as f64);
    dx * dx + dy * dy < 49.0
}

fn seed_of(text: &str) -> u64 {
    text.bytes()
        .fold(7_u64, |seed, byte| seed.wrapping_mul(31).wrapping_add(u64::from(byte)))
        % 251
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct IngestParams {
    /// Selector.
    episode: String,
    /// Added to the clip's frame rate.
    faster: f32,
}

struct Ingest(IngestParams);

impl Stage for Ingest {
    const NAME: &'static str = "ingest";
    const SUMMARY: &'static str = "Reads a text file";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Clip::SCHEMA;
    type Params = IngestParams;

    fn inputs() -> Vec<InputDescription> {
        vec![input("episode", true, "folder"), input("calibration", false, "file")]
    }

    fn load(params: &IngestParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self(params.clone()))
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let file = context.input("episode")?.join(format!("{}.txt", self.0.episode));
        let text = std::fs::read_to_string(&file)
            .map_err(|error| StageError::bad_input(format!("cannot read `{}`: {error}", file.display())))?;
        misbehave(&text, Self::NAME, context)?;
        let camera = |id: &str, role, partner| ClipCamera {
            id: id.into(),
            role,
            partner,
            intrinsics: Intrinsics {
                fx: 40.0,
                fy: 40.0,
                cx: 20.0,
                cy: 11.0,
            },
            mount: CameraMount::Fixed {
                base_from_camera: RigidPose::IDENTITY,
            },
            rgb: Some((0..FRAMES).flat_map(|frame| picture(seed_of(&text), frame)).collect()),
            depth: Some(DepthReference {
                depth_m: vec![1.5; FRAMES * HEIGHT * WIDTH],
                range_m: [0.1, 5.0],
            }),
        };
        let clip = Clip {
            clip_id: context.clip_id().into(),
            episode_id: self.0.episode.clone(),
            layout: "toy".into(),
            task: text.clone(),
            calibration_note: "exact".into(),
            fps: 15.0 + f64::from(self.0.faster),
            episode_frames: (0..FRAMES as u32).collect(),
            source_frames: vec![0, 2],
            query_frames: vec![1, 2],
            anchor_frame: 0,
            height: HEIGHT as u32,
            width: WIDTH as u32,
            cameras: vec![
                camera("wrist", CameraRole::Source, None),
                camera("wrist_right", CameraRole::Evaluation, Some(0)),
            ],
            robot: RobotStates {
                joint_names: vec!["j".into()],
                positions: vec![0.1; FRAMES],
                gripper: vec![0.5; FRAMES],
            },
            tracks: None,
        };
        context.progress(0.5, "reading");
        write(context, Self::NAME, &clip)
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct MapsParams {
    /// The robot.
    robot: RobotSpec,
}

struct Maps;

impl Stage for Maps {
    const NAME: &'static str = "robot-maps";
    const SUMMARY: &'static str = "Draws a disc";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = RobotMaps::SCHEMA;
    type Params = MapsParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            input("clip", true, Clip::SCHEMA.name),
            input("robot-model", true, "file"),
        ]
    }

    fn load(_: &MapsParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self)
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        misbehave(&clip.task, Self::NAME, context)?;
        let map = |frame: usize| {
            let hit: Vec<bool> = (0..HEIGHT * WIDTH)
                .map(|index| disc(index / WIDTH, index % WIDTH, frame))
                .collect();
            RobotMap {
                camera: 0,
                frame: frame as u32,
                depth_m: hit
                    .iter()
                    .enumerate()
                    .map(|(index, &hit)| if hit { 1.0 + index as f32 * 1e-3 } else { 0.0 })
                    .collect(),
                link: hit
                    .iter()
                    .enumerate()
                    .map(|(index, &hit)| if hit { (index % WIDTH > 17) as u8 } else { NO_LINK })
                    .collect(),
                support: hit.iter().map(|&hit| u8::from(hit)).collect(),
            }
        };
        write(
            context,
            Self::NAME,
            &RobotMaps {
                clip_id: clip.clip_id,
                link_names: vec!["a".into(), "b".into()],
                base_from_link: vec![RigidPose::IDENTITY; 2 * FRAMES],
                base_from_camera: vec![RigidPose::IDENTITY; 2 * FRAMES],
                recon_from_base: RigidPose::IDENTITY,
                tool_m: vec![0.0; 3 * FRAMES],
                height: HEIGHT as u32,
                width: WIDTH as u32,
                maps: (0..FRAMES).map(map).collect(),
            },
        )
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct SigmaParams {
    /// A number.
    sigma_m: f32,
}

impl Default for SigmaParams {
    fn default() -> Self {
        Self { sigma_m: 0.1 }
    }
}

struct Kappa(SigmaParams);

impl Stage for Kappa {
    const NAME: &'static str = "conditioning";
    const SUMMARY: &'static str = "Conditions on nothing";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Conditioning::SCHEMA;
    type Params = SigmaParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            input("clip", true, Clip::SCHEMA.name),
            input("robot", true, RobotMaps::SCHEMA.name),
        ]
    }

    fn load(params: &SigmaParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self(params.clone()))
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        let _: RobotMaps = context.read("robot")?;
        misbehave(&clip.task, Self::NAME, context)?;
        let queries = clip.field_frames();
        let view = ViewConditioning {
            pixels: vec![5],
            link: vec![0],
            depth_m: vec![1.0],
            displacement_iu: vec![0.0; 3 * queries.len()],
            available: vec![1; queries.len()],
            prior: GripperPrior {
                centre_px: [1.0; 2],
                depth_m: 1.0,
                focal_px: [40.0; 2],
                sigma_m: f64::from(self.0.sigma_m),
            },
        };
        let views = clip.source_views();
        write(
            context,
            Self::NAME,
            &Conditioning {
                clip_id: clip.clip_id.clone(),
                height: clip.height,
                width: clip.width,
                view_maps: vec![view; views.len()],
                views,
                query_frames: queries,
            },
        )
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct LiftParams {
    /// Leave the anchor out.
    no_anchor: bool,
    /// A seed.
    seed: u32,
}

struct Lift(LiftParams);

fn weights() -> WeightsInfo {
    WeightsInfo {
        trained: false,
        configuration: "toy".into(),
        description: "seed 0".into(),
        hash: String::new(),
    }
}

impl Stage for Lift {
    const NAME: &'static str = "lift";
    const SUMMARY: &'static str = "Lifts nothing";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Field::SCHEMA;
    type Params = LiftParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            input("clip", true, Clip::SCHEMA.name),
            input("robot", true, RobotMaps::SCHEMA.name),
            input("conditioning", true, Conditioning::SCHEMA.name),
            input("weights", false, "file"),
        ]
    }

    fn load(params: &LiftParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self(params.clone()))
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        let _: RobotMaps = context.read("robot")?;
        let _: Conditioning = context.read("conditioning")?;
        misbehave(&clip.task, Self::NAME, context)?;
        let views = clip.source_views();
        let count = views.len() * HEIGHT * WIDTH;
        let slice = |frame: u32| TimeSlice {
            time: rogs_schemas::records::clip::time_of_frame(frame, FRAMES),
            displacement_m: vec![0.01 * frame as f32; 3 * count],
            gate: vec![0; count],
            moving_raw: vec![],
        };
        context.warn("the weights are not trained");
        write(
            context,
            Self::NAME,
            &Field {
                clip_id: clip.clip_id.clone(),
                frame_count: FRAMES as u32,
                height: clip.height,
                width: clip.width,
                recon_from_base: RigidPose::IDENTITY,
                weights: weights(),
                position_m: vec![if self.0.no_anchor { 2.0 } else { 1.0 }; 3 * count],
                base_raw: vec![self.0.seed as f32; RAW_CHANNELS * count],
                support: vec![0; count],
                link: vec![NO_LINK; count],
                scale_cap_iu: vec![f32::INFINITY; count],
                slices: clip.field_frames().into_iter().map(slice).collect(),
                query_state: vec![],
                views,
            },
        )
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct NoParams {}

struct Refine;

impl Stage for Refine {
    const NAME: &'static str = "refine";
    const SUMMARY: &'static str = "Refines nothing";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Refinement::SCHEMA;
    type Params = NoParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            input("clip", true, Clip::SCHEMA.name),
            input("robot", true, RobotMaps::SCHEMA.name),
            input("field", true, Field::SCHEMA.name),
        ]
    }

    fn load(_: &NoParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self)
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        let field: Field = context.read("field")?;
        misbehave(&clip.task, Self::NAME, context)?;
        let field_key = context.input_key("field").unwrap_or_default();
        write(
            context,
            Self::NAME,
            &Refinement {
                clip_id: clip.clip_id,
                field_key,
                gaussian_count: field.len() as u64,
                updates: 0,
                preset: "toy".into(),
                weights: weights(),
                scale_residual: ScaleResidual::default(),
                steps: vec![],
                resume_state: vec![],
            },
        )
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct ScoreParams {
    /// Method name.
    method: String,
    /// Setting.
    setting: String,
}

struct Score(ScoreParams);

impl Stage for Score {
    const NAME: &'static str = "score";
    const SUMMARY: &'static str = "Scores a gradient";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Scores::SCHEMA;
    type Params = ScoreParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            input("clip", true, Clip::SCHEMA.name),
            input("robot", true, RobotMaps::SCHEMA.name),
            input("field", true, Field::SCHEMA.name),
            input("refinement", false, Refinement::SCHEMA.name),
            input("lpips", false, "file"),
        ]
    }

    fn load(params: &ScoreParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self(params.clone()))
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        let field: Field = context.read("field")?;
        let refined = context.optional_input("refinement").is_some();
        misbehave(&clip.task, Self::NAME, context)?;
        let seed = seed_of(&clip.task);
        let image = |camera: &str, frame: u32| ImageScore {
            camera: camera.into(),
            source_view: camera == "wrist",
            frame,
            psnr: Some(20.0 + seed as f64 / 100.0 + f64::from(u8::from(refined)) - f64::from(field.position_m[0])),
            ssim: Some(0.5),
            lpips: None,
            absrel: Some(0.2),
            rmse_m: Some(0.1),
            delta1: Some(0.5),
            absrel_scaled: None,
            far_absrel: None,
            support_n: 10,
        };
        let render = |camera: &str, frame: u32| RenderedView {
            camera: camera.into(),
            frame,
            height: clip.height,
            width: clip.width,
            rgb: picture(seed + 3, frame as usize),
            depth_m: (0..HEIGHT * WIDTH).map(|index| 1.0 + index as f32 / 1000.0).collect(),
        };
        let pairs: Vec<(&str, u32)> = ["wrist", "wrist_right"]
            .into_iter()
            .flat_map(|camera| [(camera, 1), (camera, 2)])
            .collect();
        write(
            context,
            Self::NAME,
            &Scores {
                summary: ScoreSheet {
                    clip_id: clip.clip_id.clone(),
                    method: self.0.method.clone(),
                    setting: self.0.setting.clone(),
                    ssim_variant: "toy".into(),
                    lpips_note: Some("no weights".into()),
                    weights: vec![field.weights],
                    images: pairs.iter().map(|&(camera, frame)| image(camera, frame)).collect(),
                    tracks: vec![TrackScore {
                        anchor: 0,
                        frame: 2,
                        epe_mm: None,
                        n_tracks: 0,
                    }],
                    robot_depth: vec![RobotDepthScore {
                        frame: 2,
                        robot_depth_mm: Some(12.5),
                        core_n: 40,
                    }],
                    n_empty_support: 0,
                    invalid_gaussians: 0,
                },
                renders: pairs.iter().map(|&(camera, frame)| render(camera, frame)).collect(),
            },
        )
    }
}

/// The face `list` of ingest: every text file is an episode.
fn list(root: &Path) -> std::io::Result<String> {
    let mut episodes = Vec::new();
    for entry in std::fs::read_dir(root)? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        if let Some(stem) = name.strip_suffix(".txt") {
            episodes.push(serde_json::json!({"episode_id": stem, "layout": "toy", "selector": stem, "files": [name]}));
        }
    }
    Ok(serde_json::Value::Array(episodes).to_string())
}

/// `toy_pipeline run|submit MANIFEST WORKERS THREADS`: the orchestrator as a process of its own, for tests that kill it.
fn run(arguments: &[OsString]) -> ExitCode {
    let number = |index: usize| arguments[index].to_string_lossy().parse().unwrap_or(1);
    let result = StagePrograms::this_program().and_then(|programs| {
        let mut prepared = Prepared::load(Path::new(&arguments[1]), programs)?;
        (prepared.options.workers, prepared.options.threads) = (number(2), number(3));
        prepared.options.interrupts = Interrupts::install().map_err(|error| Error::usage(error.to_string()))?;
        prepared.options.progress = ProgressMode::Lines;
        if arguments[0] == "submit" {
            let program = std::env::current_exe().map_err(|error| Error::usage(error.to_string()))?;
            let finally = ["sh".into(), "-c".into(), finish_line(&program, &prepared.plan.run)];
            let finally = std::env::var_os("ROGS_TOY_FINALLY").is_some().then_some(&finally[..]);
            let submission = rogs_orchestrator::slurm::submit(&prepared, finally, false)?;
            println!(
                "{}",
                serde_json::json!({"ids": submission.ids, "shards": submission.shards})
            );
            return Ok(Exit::Done);
        }
        Ok(prepared.run()?.exit)
    });
    match result {
        Ok(exit) => ExitCode::from(exit.code()),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit().code())
        }
    }
}

/// What the job at the end of a submission runs: it keeps the state of the run as a text.
fn finish_line(program: &Path, run: &Path) -> String {
    format!(
        "{} status {} > {}",
        program.display(),
        run.display(),
        run.join("final.txt").display()
    )
}

fn main() -> ExitCode {
    let mut arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
    if arguments.len() == 4 && (arguments[0] == "run" || arguments[0] == "submit") {
        return run(&arguments);
    }
    if arguments.len() == 2 && arguments[0] == "status" {
        return match rogs_orchestrator::status::status(Path::new(&arguments[1])) {
            Ok(status) => {
                print!("{}", status.table());
                ExitCode::from(status.exit.code())
            }
            Err(error) => {
                eprintln!("error: {error}");
                ExitCode::from(error.exit().code())
            }
        };
    }
    if arguments.len() < 2 || arguments[0] != "stage" {
        // `cargo test` starts examples without arguments nowhere; a person gets told.
        eprintln!("usage: toy_pipeline stage NAME one|worker|describe ...");
        return ExitCode::from(2);
    }
    let stage = arguments.remove(1).to_string_lossy().into_owned();
    arguments.remove(0);
    if arguments
        .first()
        .is_some_and(|face| face == "worker" || face == "batch")
    {
        keep_alive_lock();
    }
    match stage.as_str() {
        "ingest" if arguments.first().is_some_and(|word| word == "list") => match list(Path::new(&arguments[1])) {
            Ok(text) => {
                println!("{text}");
                ExitCode::SUCCESS
            }
            Err(error) => {
                eprintln!("error: {error}");
                ExitCode::from(2)
            }
        },
        "ingest" => stage_main_from::<Ingest>(arguments),
        "robot-maps" => stage_main_from::<Maps>(arguments),
        "conditioning" => stage_main_from::<Kappa>(arguments),
        "lift" => stage_main_from::<Lift>(arguments),
        "refine" => stage_main_from::<Refine>(arguments),
        "score" => stage_main_from::<Score>(arguments),
        other => {
            eprintln!("error: no stage `{other}`");
            ExitCode::from(2)
        }
    }
}
