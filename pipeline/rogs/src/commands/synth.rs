//! `rogs synth`: procedural episodes with exact references, and a manifest that runs them.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use rogs_orchestrator::quote::shell_word;
use rogs_schemas::records::robot::RobotSpec;
use rogs_synth::{
    DatasetSummary, Distortions, EPISODES_FOLDER, EstimatorErrors, ROBOT_FOLDER, ROBOT_SPEC_FILE, ROBOT_URDF_FILE,
    Resolution, SynthConfig, generate_episode, write_dataset_with, write_pointworld, write_rollout, write_sidecars,
};
use schemars::JsonSchema;
use serde::Serialize;

use crate::output;

/// Name of the manifest beside a dataset.
pub(crate) const MANIFEST_NAME: &str = "manifest.toml";

/// Folder of the cache of PointWorld in a dataset.
const POINTWORLD_FOLDER: &str = "pointworld";

/// Makes procedural robot episodes with exact depth, tracks and calibration, and `manifest.toml` to run them.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the dataset; episodes that are in it already are kept.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number of episodes.
    #[arg(long, default_value_t = 4)]
    episodes: u32,
    /// Seed of the first episode; the others follow.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Frames of an episode.
    #[arg(long, default_value_t = 33)]
    frames: u32,
    /// Size of all images, WIDTHxHEIGHT; clips are lifted at this size, so both must be multiples of 14.
    #[arg(long, default_value = "280x154", value_parser = parse_size)]
    size: [u32; 2],
    /// Errors of the recorded extrinsics: standard deviations in metres and radians.
    #[arg(long, value_names = ["M", "RAD"], num_args = 2)]
    calibration_noise: Option<Vec<f64>>,
    /// Also write the references of every episode as a cache of PointWorld, into the folder `pointworld` of the dataset
    /// (docs/pointworld.md).
    #[arg(long)]
    pointworld: bool,
    #[command(flatten)]
    sidecars: SidecarArgs,
    #[command(flatten)]
    rollouts: RolloutArgs,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// Depth and tracks for the baseline Shape of Motion.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
struct SidecarArgs {
    /// Also write what depth estimators and a tracker might have said of the episodes, which the manifest names
    /// (docs/sidecars.md): exact.
    #[arg(long)]
    sidecars: bool,
    /// As wrong as such estimators are.
    #[arg(long, requires = "sidecars")]
    sidecar_noise: bool,
}

/// Folder of the sidecars in a dataset.
const SIDECARS_FOLDER: &str = "sidecars";

/// Distortions of procedural rollouts.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
struct RolloutArgs {
    /// Also write rollouts, which the manifest runs beside the recordings: what a world model might have made of the
    /// episodes. Without the distortions below they are the recordings.
    #[arg(long)]
    rollouts: bool,
    /// Blur of the last frame of a rollout, pixels (standard deviation); none at the first.
    #[arg(long, value_name = "PX", default_value_t = 0.0, requires = "rollouts")]
    blur: f64,
    /// How far the first external camera of a rollout has moved at the last frame, metres.
    #[arg(long, value_name = "M", default_value_t = 0.0, requires = "rollouts")]
    drift: f64,
    /// Frames by which the robot of a rollout lags behind.
    #[arg(long, value_name = "FRAMES", default_value_t = 0, requires = "rollouts")]
    lag: u32,
}

/// Folder of the rollouts in a dataset.
const ROLLOUTS_FOLDER: &str = "rollouts";
/// Frames of a clip, and so of its rollout and its sidecars.
const CLIP_FRAMES: usize = 17;

/// `WIDTHxHEIGHT` as `[height, width]`.
fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let parts = text
        .split_once('x')
        .and_then(|(width, height)| Some([height.parse().ok()?, width.parse().ok()?]));
    match parts {
        Some([height, width]) if height > 0 && width > 0 && height % 14 == 0 && width % 14 == 0 => Ok([height, width]),
        _ => Err("write WIDTHxHEIGHT with multiples of 14, for example 280x154".to_owned()),
    }
}

/// What is printed as JSON.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Made {
    /// The episodes and their robot.
    dataset: DatasetSummary,
    /// The manifest that runs them.
    manifest: PathBuf,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let noise = args.calibration_noise.as_deref();
    let config = SynthConfig {
        calibration_noise: noise.map(|values| [values[0], values[1]]),
        ..config(args.frames, args.size)
    };
    let (summary, manifest) = make(&args.out, "synth", args.episodes, args.seed, &config)?;
    if args.pointworld {
        for seed in (args.seed..).take(args.episodes as usize) {
            write_pointworld(&args.out.join(POINTWORLD_FOLDER), &generate_episode(&config, seed)?)?;
        }
    }
    if args.sidecars.sidecars {
        make_sidecars(args, &config, &manifest)?;
    }
    if args.rollouts.rollouts {
        make_rollouts(args, &config, &manifest)?;
    }
    if args.json {
        output::json(&Made {
            dataset: summary,
            manifest,
        })?;
    } else {
        output::text(&format!(
            "{} episodes of {} frames, {} new\nrun them: rogs run {}",
            summary.episodes.len(),
            summary.frames,
            summary.written,
            shell_word(&manifest.display().to_string())
        ))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the sidecars of every episode and names their folder in the manifest. Those that are there are kept.
fn make_sidecars(args: &Args, config: &SynthConfig, manifest: &Path) -> anyhow::Result<()> {
    let errors = match args.sidecars.sidecar_noise {
        true => EstimatorErrors::REAL,
        false => EstimatorErrors::NONE,
    };
    let root = args.out.join(SIDECARS_FOLDER);
    for seed in (args.seed..).take(args.episodes as usize) {
        let episode = generate_episode(config, seed)?;
        let place = root.join(episode.id());
        write_sidecars(&place, &episode, config.anchor() as usize, CLIP_FRAMES, &errors)?;
        output::note(&format!("sidecars {}", place.display()));
    }
    let text = rogs_files::read_to_string(manifest).with_context(|| format!("reading `{}`", manifest.display()))?;
    if !text.contains("\n[sidecars]") {
        let text = format!("{text}\n[sidecars]\nroot = \"{SIDECARS_FOLDER}\"\n");
        rogs_files::write_bytes(manifest, text.as_bytes())?;
    }
    Ok(())
}

/// Writes a rollout of every episode and names their folder in the manifest. Those that are there are kept.
fn make_rollouts(args: &Args, config: &SynthConfig, manifest: &Path) -> anyhow::Result<()> {
    let RolloutArgs { blur, drift, lag, .. } = args.rollouts;
    let distortions = Distortions {
        blur_px: blur,
        drift_m: drift,
        lag_frames: lag,
    };
    let root = args.out.join(ROLLOUTS_FOLDER);
    for seed in (args.seed..).take(args.episodes as usize) {
        let episode = generate_episode(config, seed)?;
        let place = root.join(episode.id());
        write_rollout(&place, &episode, config.anchor() as usize, CLIP_FRAMES, &distortions)?;
        output::note(&format!("rollout {}", place.display()));
    }
    let text = rogs_files::read_to_string(manifest).with_context(|| format!("reading `{}`", manifest.display()))?;
    if !text.contains("\n[rollouts]") {
        let model = format!("none: blur {blur} px, drift {drift} m, lag {lag} frames");
        let text = format!("{text}\n[rollouts]\nroot = \"{ROLLOUTS_FOLDER}\"\nmodel = \"{model}\"\n");
        rogs_files::write_bytes(manifest, text.as_bytes())?;
    }
    Ok(())
}

/// Episodes of so many frames, all images of one size.
pub(crate) fn config(frames: u32, size: [u32; 2]) -> SynthConfig {
    SynthConfig {
        frames,
        resolution: Resolution {
            wrist: size,
            external: size,
        },
        ..SynthConfig::default()
    }
}

/// Writes a dataset and a manifest; both are kept when they are there.
pub(crate) fn make(
    folder: &Path,
    name: &str,
    episodes: u32,
    seed: u64,
    config: &SynthConfig,
) -> anyhow::Result<(DatasetSummary, PathBuf)> {
    let done = |path: &Path| output::note(&format!("episode {}", path.display()));
    let summary = write_dataset_with(folder, episodes, seed, config, &done)?;
    let manifest = folder.join(MANIFEST_NAME);
    if !manifest.exists() {
        let text = manifest_text(folder, name, config.resolution.wrist)?;
        rogs_files::write_bytes(&manifest, text.as_bytes())?;
    }
    Ok((summary, manifest))
}

fn manifest_text(folder: &Path, name: &str, [height, width]: [u32; 2]) -> anyhow::Result<String> {
    let path = folder.join(ROBOT_FOLDER).join(ROBOT_SPEC_FILE);
    let spec = rogs_files::read_to_string(&path).with_context(|| format!("reading `{}`", path.display()))?;
    let spec: RobotSpec = serde_json::from_str(&spec).with_context(|| format!("reading `{}`", path.display()))?;
    Ok(format!(
        "# Procedural episodes through every stage. Run it with: rogs run {MANIFEST_NAME}\n\
         [run]\nname = \"{name}\"\nout = \"run\"\n\n\
         [input]\nroot = \"{EPISODES_FOLDER}\"\n\n\
         [robot]\nurdf = \"{ROBOT_FOLDER}/{ROBOT_URDF_FILE}\"\n\n\
         [robot.spec]\n{}\n\
         [ingest]\nheight = {height}\nwidth = {width}\n\n\
         # The built-in networks, trained on procedural clips like these. A file of your own: lift = \"FILE\".\n\
         [weights]\nlift = \"builtin\"\nrefine = \"builtin\"\n\n\
         [refine]\npreset = \"ci\"\nupdates = 4\n",
        toml::to_string(&spec)?
    ))
}
