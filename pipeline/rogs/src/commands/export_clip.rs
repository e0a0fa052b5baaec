//! `rogs export clip`: the inputs of a clip for other methods.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{bail, ensure};
use rogs_export::dataset::{Dataset, Masks, Selection, write_colmap, write_nerfstudio};
use rogs_r4c::read_record;
use rogs_schemas::ids::did_you_mean;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, FrameIndex};
use schemars::JsonSchema;
use serde::Serialize;

use super::export_field::AxesArg;
use crate::output;

/// Writes images, lenses, poses, masks, depth and points of a clip for other methods.
///
/// Views that the field is made from (source cameras at source times) are there for training, all others for testing. In a
/// rollout source cameras show what the world model made.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The clip (`clip.r4c`).
    clip: PathBuf,
    /// What is written.
    #[arg(long, value_enum)]
    format: Format,
    /// Folder to write; nothing may have its name.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Clip frames: `source`, `all`, or a list with commas.
    #[arg(long, value_name = "FRAMES", default_value = "source")]
    frames: String,
    /// Cameras: `all`, `source`, or names with commas.
    #[arg(long, value_name = "CAMERAS", default_value = "all")]
    cameras: String,
    /// Frame of poses: the robot's base, or the reconstruction frame (axes of the first source camera).
    #[arg(long, value_enum, default_value = "base")]
    axes: AxesArg,
    /// Which pixels masks let through; source cameras alone have masks.
    #[arg(long, value_enum, default_value = "none")]
    masks: MasksArg,
    /// Robot maps of the clip. Default: `robot.r4c` beside the clip.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// Forms of folders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// `transforms.json` of nerfstudio.
    Nerfstudio,
    /// A model of COLMAP: `sparse/0/*.bin` beside `images`.
    Colmap,
}

/// What masks let through.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum MasksArg {
    /// There are none.
    None,
    /// All but the robot.
    Background,
    /// The robot alone.
    Robot,
}

/// What was written.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct Written {
    /// The folder.
    path: PathBuf,
    /// Images to train on.
    training: usize,
    /// Images held out.
    held_out: usize,
    /// Points to start from.
    points: usize,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    ensure!(
        !args.out.exists(),
        "`{}` is there already: name another folder, or remove it",
        args.out.display()
    );
    let (clip, _) = read_record::<Clip>(&args.clip)?;
    let beside = || args.clip.with_file_name("robot.r4c");
    let (robot, _) = read_record::<RobotMaps>(&args.robot.clone().unwrap_or_else(beside))?;
    let selection = Selection {
        axes: args.axes.into(),
        cameras: cameras(&args.cameras, &clip)?,
        frames: frames(&args.frames, &clip)?,
        masks: match args.masks {
            MasksArg::None => Masks::None,
            MasksArg::Background => Masks::Background,
            MasksArg::Robot => Masks::Robot,
        },
    };
    let data = Dataset::new(&clip, &robot, &selection)?;
    match args.format {
        Format::Nerfstudio => write_nerfstudio(&data, &args.out)?,
        Format::Colmap => write_colmap(&data, &args.out)?,
    }
    let held_out = data.views.iter().filter(|view| view.held_out).count();
    let written = Written {
        path: args.out.clone(),
        training: data.views.len() - held_out,
        held_out,
        points: data.points.len(),
    };
    if args.json {
        output::json(&written)?;
    } else {
        output::text(&args.out.display().to_string())?;
        output::note(&format!(
            "{} views for training, {} held out, {} points",
            written.training, written.held_out, written.points
        ));
    }
    Ok(ExitCode::SUCCESS)
}

fn cameras(asked: &str, clip: &Clip) -> anyhow::Result<Vec<CameraIndex>> {
    match asked {
        "all" => return Ok(CameraIndex::first(clip.cameras.len()).collect()),
        "source" => return Ok(clip.source_cameras()),
        _ => {}
    }
    let names = || clip.cameras.iter().map(|camera| camera.id.as_str());
    let find = |name: &str| {
        if let Some(at) = names().position(|own| own == name) {
            return Ok(CameraIndex(at as u32));
        }
        let meant = did_you_mean(name, names()).map_or(String::new(), |meant| format!("; did you mean `{meant}`?"));
        let all = names().collect::<Vec<_>>().join(", ");
        bail!("the clip has no camera `{name}`{meant} (cameras: {all}; also `all`, `source`)")
    };
    let mut cameras = Vec::new();
    for name in asked.split(',') {
        let camera = find(name.trim())?;
        if !cameras.contains(&camera) {
            cameras.push(camera);
        }
    }
    Ok(cameras)
}

fn frames(asked: &str, clip: &Clip) -> anyhow::Result<Vec<FrameIndex>> {
    let count = clip.frame_count();
    match asked {
        "all" => return Ok(FrameIndex::first(count).collect()),
        "source" => return Ok(clip.source_frames.clone()),
        _ => {}
    }
    let number = |text: &str| {
        let frame: Option<u32> = text.trim().parse().ok();
        match frame {
            Some(frame) if (frame as usize) < count => Ok(FrameIndex(frame)),
            Some(frame) => bail!("frame {frame} is outside the clip, which has frames 0 to {}", count - 1),
            None => bail!("invalid frames `{asked}`: expected `source`, `all`, or a list such as 0,4,8"),
        }
    };
    let mut frames: Vec<FrameIndex> = asked.split(',').map(number).collect::<anyhow::Result<_>>()?;
    frames.sort_unstable();
    frames.dedup();
    Ok(frames)
}
