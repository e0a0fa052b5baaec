//! `rogs audit`: whether calibrations and states fit the images.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use rogs_orchestrator::manifest::{Manifest, Params, Weights};
use rogs_orchestrator::stage::StageId;
use rogs_orchestrator::{Error, Exit};
use rogs_report::Audit;
use rogs_schemas::ids::{did_you_mean, safe_name};

use super::init;
use super::run::{Machine, describe, execute};
use crate::output;

/// Says of every camera whether the robot lies on its images, and which mistake of calibration or states explains that it
/// does not.
///
/// No network is needed. Of every episode one clip is looked at; a manifest may take more (`clips = "all"`), and thousands
/// of episodes: a stopped audit goes on where it was. Verdicts: good, suspect, wrong, cannot tell.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folders with episodes, or manifests (TOML).
    #[arg(required = true, value_name = "EPISODES")]
    episodes: Vec<PathBuf>,
    /// URDF of the robot; by default looked for in the folder and beside it. Manifests name their own.
    #[arg(long, value_name = "URDF")]
    robot: Option<PathBuf>,
    /// Calibration file of the cameras, for data that has none; by default looked for. Manifests name their own.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Folder for the files of the audit, which a second audit takes up.
    #[arg(long, value_name = "DIR", default_value = "rogs-audit")]
    out: PathBuf,
    /// Write a page, too: the verdicts, and the drawn robot on the images.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    #[command(flatten)]
    machine: Machine,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// Name of the manifest in the folder of an audit.
const MANIFEST: &str = "audit.toml";
/// Most entries of a folder among which the one that was meant is looked for.
const MOST_ENTRIES: usize = 4096;

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let mut audit = Audit::default();
    let mut exit = Exit::Done;
    let mut names = Vec::new();
    for episodes in &args.episodes {
        let manifest = make_manifest(args, episodes, &mut names)?;
        let mut prepared = args.machine.prepare(&manifest)?;
        let outcome = execute(&mut prepared, false)?;
        if outcome.summary.exit == Exit::Stopped {
            output::note(&describe(&outcome));
            output::note("stopped; the same command goes on");
            return Ok(ExitCode::from(outcome.summary.exit.code()));
        }
        if outcome.summary.exit != Exit::Done {
            exit = outcome.summary.exit;
        }
        audit.add(&outcome.summary.run)?;
    }
    if let Some(path) = &args.html {
        rogs_files::write_bytes(path, audit.page("rogs audit").as_bytes())?;
    }
    output::after_work(if args.json {
        output::json(&audit.told())
    } else {
        output::text(&audit.text())
    })?;
    if let Some(path) = &args.html {
        output::note(&format!("page: {}", path.display()));
    }
    Ok(ExitCode::from(exit.code()))
}

/// Writes the manifest of an audit: that of the episodes, up to the one stage.
fn make_manifest(args: &Args, episodes: &Path, names: &mut Vec<String>) -> anyhow::Result<PathBuf> {
    if !episodes.exists() {
        return Err(not_there(episodes).into());
    }
    let out = std::path::absolute(&args.out)?;
    let mut manifest = if episodes.is_dir() {
        let (robot, calibration) = (args.robot.as_deref(), args.calibration.as_deref());
        let text = init::manifest_for(episodes, robot, calibration, &out)?;
        let (mut manifest, _) = Manifest::parse(&text, &out.join(MANIFEST), &out)?;
        // The size that the built-in networks are made for; they have no part in this.
        manifest.ingest.remove("height");
        manifest.ingest.remove("width");
        manifest
    } else {
        Manifest::load(episodes)?.0
    };
    let mut name = safe_name(&manifest.run.name);
    while names.contains(&name) {
        name.push('+');
    }
    names.push(name.clone());
    let folder = out.join(&name);
    manifest.run.out = folder.join("run");
    manifest.run.name = name;
    manifest.run.stages = vec![StageId::Agreement];
    manifest.run.agreement = None;
    manifest.weights = Weights::default();
    (manifest.latents, manifest.sidecars) = (None, None);
    if let Some(rollouts) = &mut manifest.rollouts {
        (rollouts.latents, rollouts.sidecars) = (None, None);
    }
    (manifest.variants, manifest.predictions, manifest.baselines) = (Vec::new(), Vec::new(), Vec::new());
    (manifest.lift, manifest.refine, manifest.score) = (Params::new(), Params::new(), Params::new());
    manifest.references = None;
    let text = toml::to_string(&manifest).context("writing the manifest of the audit")?;
    let path = folder.join(MANIFEST);
    std::fs::create_dir_all(&folder).with_context(|| format!("making `{}`", folder.display()))?;
    rogs_files::write_bytes(&path, text.as_bytes())?;
    Ok(path)
}

/// The error for a path that is not there, with the one that was probably meant.
fn not_there(path: &Path) -> Error {
    let error = Error::usage(format!("`{}` is not there", path.display()));
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let entries = std::fs::read_dir(folder.unwrap_or(Path::new(".")))
        .into_iter()
        .flatten();
    let near: Vec<String> = entries
        .take(MOST_ENTRIES)
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .collect();
    match did_you_mean(&name, near.iter().map(String::as_str)) {
        Some(meant) => error.with_hint(format!("did you mean `{meant}`?")),
        None => error.with_hint("give a folder with episodes, or a manifest; `rogs list FOLDER` shows what is in one"),
    }
}
