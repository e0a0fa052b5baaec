//! `rogs calibrate`: cameras refined, or found, by the robot in their images.

mod camera;
mod clips;
mod file;
pub(super) mod told;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::Context as _;
use rogs_orchestrator::Error;
use rogs_orchestrator::manifest::Manifest;

use self::clips::{Clips, Robot};
use crate::output;

/// Calibrates cameras by the robot in their images and writes a calibration file.
///
/// Moves each camera until the robot, drawn from its mesh and the joint states, lies on that of the images; a camera on the
/// hand also until points of the scene keep to their epipolar lines along its path. Every number comes with a standard
/// deviation. Episodes that are named together must have been filmed by cameras that stayed where they are.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder with episodes, in any layout that `rogs list` shows; by default that of the manifest.
    #[arg(required_unless_present = "manifest")]
    folder: Option<PathBuf>,
    /// Manifest whose robot, calibration and parameters of `ingest` hold here too.
    #[arg(long, value_name = "FILE")]
    manifest: Option<PathBuf>,
    /// Episode to look at, by its selector or id (`rogs list`); repeat for more. By default up to 8 of the folder.
    #[arg(long, value_name = "EPISODE")]
    episode: Vec<String>,
    /// Calibration file to start from, for data that has none itself.
    #[arg(long, value_name = "FILE", conflicts_with = "new")]
    calibration: Option<PathBuf>,
    /// Start from nothing: search the poses of fixed cameras; wrist cameras of DROID start from the mean of 28 rigs.
    #[arg(long)]
    new: bool,
    /// Search the poses of fixed cameras, whatever the start.
    #[arg(long)]
    search: bool,
    /// With `--new`: horizontal field of view of the cameras, degrees. By default that of DROID's cameras.
    #[arg(long, value_name = "DEGREES", requires = "new", value_parser = degrees)]
    field_of_view: Option<f64>,
    /// URDF of the robot; by default looked for in the folder and beside it.
    #[arg(long, value_name = "URDF")]
    robot: Option<PathBuf>,
    /// Camera to calibrate, by its name in the clip; repeat for more. By default all; others are kept as they are.
    #[arg(long, value_name = "CAMERA")]
    camera: Vec<String>,
    /// Solve for the focal length too.
    #[arg(long)]
    focal: bool,
    /// Solve for the principal point too.
    #[arg(long)]
    principal_point: bool,
    /// Solve for the delay between images and states too. It is told; calibration files have no place for it.
    #[arg(long)]
    lag: bool,
    /// Size at which images are read; its aspect should be that of the camera's sensor.
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "320x180", value_parser = super::render::size)]
    size: (u32, u32),
    /// Most images of a camera that edges are searched in.
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = clap::value_parser!(u32).range(2..=1000))]
    frames: u32,
    /// Where the calibration file goes. A file that is there is not overwritten.
    #[arg(long, value_name = "FILE", default_value = "calibration.json")]
    out: PathBuf,
    /// Replace the file.
    #[arg(long)]
    force: bool,
    /// Folder for pictures of every camera: the robot's outline over the images, before and after.
    #[arg(long, value_name = "FOLDER")]
    overlays: Option<PathBuf>,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

fn degrees(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| (5.0..=170.0).contains(value));
    value.ok_or_else(|| format!("invalid field of view `{text}`: expected degrees, e.g. 69"))
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let started = Instant::now();
    if args.out.exists() && !args.force {
        let error = Error::usage(format!("`{}` is there already", args.out.display()));
        return Err(error
            .with_hint("name another file with --out, or replace it with --force")
            .into());
    }
    let told = args.manifest.as_deref().map(Manifest::load).transpose()?;
    let manifest = told.as_ref().map(|(manifest, _)| manifest);
    let of_manifest = manifest
        .and_then(|manifest| manifest.input.as_ref())
        .map(|input| &input.root);
    let Some(folder) = args.folder.as_ref().or(of_manifest) else {
        let error = Error::usage("the manifest has no `[input]` with a folder of episodes");
        return Err(error.with_hint("name the folder").into());
    };
    let folder = std::path::absolute(folder)?;
    let episodes = clips::chosen(&folder, &args.episode)?;
    let robot = match (manifest, &args.robot) {
        (Some(manifest), None) => Robot::of_manifest(manifest)?,
        (_, named) => Robot::find(named.as_deref(), &folder, &episodes[0])?,
    };
    let clips = Clips::read(&folder, &episodes, &robot, manifest, args)?;
    let cameras = camera::calibrate_all(&clips, &robot, args)?;
    let calibrated = cameras.iter().filter(|camera| camera.refined.is_ok()).count();
    for camera in &cameras {
        if let Err(why) = &camera.refined {
            let kept = if args.new { "left out" } else { "kept as it is" };
            output::note(&format!("warning: camera `{}` {why}; it is {kept}", camera.name));
        }
    }
    if calibrated == 0 {
        let error = Error::usage("no camera could be calibrated: nothing was written");
        return Err(error.with_hint("look at what is said of each camera above").into());
    }
    let pictures = match &args.overlays {
        Some(folder) => pictures(&clips, &robot, &cameras, folder)?,
        None => Vec::new(),
    };
    let text = file::calibration(&clips, &cameras, args);
    rogs_files::write_bytes(&args.out, text.as_bytes()).with_context(|| format!("writing `{}`", args.out.display()))?;
    let told = told::Told::of(&clips, &cameras, args, pictures, started.elapsed().as_secs_f64());
    if args.json {
        output::json(&told)?;
    } else {
        output::text(&told.text())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Draws every calibrated camera over three moments of the first clip.
fn pictures(
    clips: &Clips,
    robot: &Robot,
    cameras: &[camera::Calibrated],
    folder: &Path,
) -> anyhow::Result<Vec<(String, PathBuf)>> {
    std::fs::create_dir_all(folder).with_context(|| format!("making `{}`", folder.display()))?;
    let mut written = Vec::new();
    for camera in cameras {
        let Ok(refined) = &camera.refined else { continue };
        let picture = camera.picture(clips, robot, refined)?;
        let path = folder.join(format!("{}.png", rogs_schemas::ids::safe_name(&camera.name)));
        rogs_arrays::write_png(&path, (picture.width, picture.height), &picture.rgb)?;
        written.push((camera.name.clone(), path));
    }
    Ok(written)
}
