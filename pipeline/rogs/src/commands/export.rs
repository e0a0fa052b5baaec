//! `rogs export`: what other programs take from a run. `export_field` has what they take from a field,
//! `export_clip` what they take from a clip.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context as _, ensure};
use rogs_arrays::{npy_bytes, png_bytes};
use rogs_files::Draft;
use rogs_geometry::{Base, Link, Pose, actions, tool_pose};
use rogs_ingest::{Fit, Observations, Params, compose, read_clip};
use rogs_orchestrator::plan::{Plan, WorkUnit, read_plan};
use rogs_orchestrator::stage::StageId;
use rogs_r4c::read_record;
use rogs_schemas::ids::suggestion;
use rogs_schemas::protocol::JobId;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex};
use schemars::JsonSchema;
use serde::Serialize;

use crate::output;

/// Writes what other programs take from a run, a clip or a field.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Field(super::export_field::Args),
    Clip(super::export_clip::Args),
    RolloutInputs(RolloutInputs),
}

/// Writes what an action-conditioned world model (Cosmos 3) is given for each clip: first observation and actions.
///
/// Per clip a folder: `observation.png`, the wrist view above the two external ones at half its size; `actions.npy`, f32
/// [steps, 10]: translation (m), the first two columns of the rotation, gripper (1 open), each step the pose of the link at
/// its end seen from its start, axes turned by 90 degrees about the link's z; `actions.json`, the same with what it means.
#[derive(Debug, clap::Args)]
pub(crate) struct RolloutInputs {
    /// The run folder; `robot-maps` must be done.
    run: PathBuf,
    /// Folder to write to.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Only this clip (by its id or its episode's); may be given several times.
    #[arg(long, value_name = "CLIP")]
    clip: Vec<String>,
    /// Size of the wrist view, even sides; the external views get half of it.
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "640x360", value_parser = size)]
    size: (u32, u32),
    /// Steps of a chunk.
    #[arg(long, default_value_t = 16)]
    steps: u32,
    /// The link whose poses actions are made of.
    #[arg(long, value_name = "LINK", default_value = "panda_link8")]
    link: String,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// `actions.json`.
#[derive(Debug, Serialize)]
struct Chunk<'a> {
    format: &'static str,
    clip: &'a str,
    episode: &'a str,
    task: &'a str,
    frames_per_second: f64,
    /// Episode frames: the first is that of the observation.
    episode_frames: &'a [EpisodeFrame],
    link: &'a str,
    views: [&'a str; 3],
    view_size: [u32; 2],
    convention: &'static str,
    /// Base-from-tool at the first frame, rows of a 4x4 matrix.
    initial_pose: [f64; 16],
    actions: Vec<[f64; 10]>,
}

/// What is printed as JSON.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Folders {
    /// One a clip.
    folders: Vec<PathBuf>,
}

const CONVENTION: &str = "row i: translation (m) and the first two columns of the rotation of inv(T_i) T_(i+1), where T is the \
                          link's pose in the base right-multiplied by Rz(+90 degrees); then 1 - gripper at the end of the step";

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    match &args.what {
        What::Field(args) => super::export_field::run(args),
        What::Clip(args) => super::export_clip::run(args),
        What::RolloutInputs(args) => rollout_inputs(args),
    }
}

fn rollout_inputs(args: &RolloutInputs) -> anyhow::Result<ExitCode> {
    let plan = read_plan(&args.run)?;
    let clips: Vec<usize> = if args.clip.is_empty() {
        (0..plan.clips.len()).collect()
    } else {
        args.clip
            .iter()
            .map(|name| plan.find_clip(name))
            .collect::<Result<_, _>>()?
    };
    let mut written = Vec::new();
    for clip in clips {
        written.push(export_clip(&plan, clip, args).with_context(|| format!("clip `{}`", plan.clips[clip].id))?);
    }
    if args.json {
        output::json(&Folders { folders: written })?;
    } else {
        for folder in &written {
            output::text(&folder.display().to_string())?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the folder of one clip.
fn export_clip(plan: &Plan, clip: usize, args: &RolloutInputs) -> anyhow::Result<PathBuf> {
    let node = |stage: StageId| plan.nodes.iter().position(|node| node.stage == stage);
    let (ingest, robot) = node(StageId::Ingest)
        .zip(node(StageId::RobotMaps))
        .context("the run has no stage `robot-maps`")?;
    let keys = plan.keys(clip);
    let unit = |node: usize| WorkUnit { clip, node };
    let path = plan.run.join(plan.output(unit(robot), &keys));
    ensure!(
        path.is_file(),
        "`{}` is not there: run the stage `robot-maps`",
        path.display()
    );
    let (maps, _) = read_record::<RobotMaps>(&path)?;
    let job = plan.job(JobId(0), unit(ingest), &keys);
    let recorded = observed(
        &job.params,
        job.inputs.get("episode"),
        job.inputs.get("calibration"),
        args,
        &job.clip_id,
    )?;

    let views = ["wrist", "ext1", "ext2"];
    let first = |id: &&str| -> anyhow::Result<&[u8]> {
        let camera = recorded.cameras.iter().position(|camera| camera.id == **id);
        let target = camera.and_then(|camera| recorded.target(CameraIndex(camera as u32), FrameIndex(0)));
        let ids: Vec<&str> = recorded.cameras.iter().map(|camera| camera.id.as_str()).collect();
        Ok(target
            .with_context(|| format!("there is no image of camera `{id}` (it has {})", ids.join(", ")))?
            .rgb())
    };
    let [wrist, ext1, ext2] = [first(&views[0])?, first(&views[1])?, first(&views[2])?];
    let (size, image) = compose([wrist, ext1, ext2], args.size);

    let poses = link_poses(&maps, &args.link, args.steps)?;
    let chunk = actions(&poses, &recorded.robot.gripper);
    let rows: Vec<[f64; 10]> = chunk.iter().map(rogs_geometry::Action::row).collect();
    let told = Chunk {
        format: "rogs-actions 1",
        clip: &job.clip_id,
        episode: &recorded.episode_id,
        task: &recorded.task,
        frames_per_second: recorded.fps,
        episode_frames: &recorded.episode_frames[..poses.len()],
        link: &args.link,
        views,
        view_size: [args.size.0, args.size.1],
        convention: CONVENTION,
        initial_pose: tool_pose(&poses[0]).to_matrix4(),
        actions: rows.clone(),
    };
    std::fs::create_dir_all(&args.out).with_context(|| format!("making `{}`", args.out.display()))?;
    let folder = args.out.join(&job.clip_id);
    let draft = Draft::begin(&folder)?;
    let values: Vec<f32> = rows.iter().flatten().map(|&value| value as f32).collect();
    draft.write("observation.png", &png_bytes(size, &image)?)?;
    draft.write("actions.npy", &npy_bytes(&[rows.len(), 10], &values))?;
    draft.write("actions.json", &serde_json::to_vec_pretty(&told)?)?;
    draft.publish()?;
    Ok(folder)
}

/// The clip as it was recorded, at the size of the wrist view, nothing cut off.
fn observed(
    params: &serde_json::Value,
    episode: Option<&PathBuf>,
    calibration: Option<&PathBuf>,
    args: &RolloutInputs,
    clip: &str,
) -> anyhow::Result<Clip> {
    let params: Params =
        serde_json::from_value(params.clone()).context("the plan is of another version of `ingest`")?;
    let (width, height) = args.size;
    let params = Params {
        width,
        height,
        fit: Fit::Stretch,
        observations: Observations::Recorded,
        ..params
    };
    let episode = episode.context("the plan names no episode")?;
    let (recorded, _) = read_clip(episode, calibration.map(PathBuf::as_path), &params, clip).map_err(|error| {
        let hint = error.hint.as_ref().map_or(String::new(), |hint| format!(" ({hint})"));
        anyhow::anyhow!("{}{hint}", error.message)
    })?;
    Ok(recorded)
}

/// The poses of a link at the frames of a chunk.
fn link_poses(maps: &RobotMaps, link: &str, steps: u32) -> anyhow::Result<Vec<Pose<Base, Link>>> {
    let links = maps.link_names.len();
    let place = maps.link_names.iter().position(|name| name == link).with_context(|| {
        let meant = suggestion(link, maps.link_names.iter().map(String::as_str));
        format!("the robot has no link `{link}`{meant}; --link names one")
    })?;
    let stored: Vec<_> = maps.base_from_link.iter().skip(place).step_by(links.max(1)).collect();
    let wanted = steps as usize + 1;
    ensure!(
        steps > 0 && stored.len() >= wanted,
        "{steps} steps need {wanted} frames, the clip has {}",
        stored.len()
    );
    stored[..wanted]
        .iter()
        .map(|pose| Ok(Pose::from_rigid(pose)?))
        .collect()
}

/// A size with even sides.
fn size(text: &str) -> Result<(u32, u32), String> {
    let sides = text
        .split_once('x')
        .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    let even = |side: u32| (2..=8192).contains(&side) && side.is_multiple_of(2);
    sides
        .filter(|&(width, height)| even(width) && even(height))
        .ok_or_else(|| format!("invalid size `{text}`: expected even sides, e.g. 640x360"))
}
