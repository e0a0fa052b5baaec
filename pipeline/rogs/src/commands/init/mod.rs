//! `rogs init`: a manifest for the episodes of a folder, with what is found there and what is missing said in comments.

pub(super) mod robot;
mod text;

use std::fs::DirEntry;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use clap::CommandFactory as _;
use rogs_ingest::{EpisodeListing, EpisodeOutline, count_frames, list_episodes, list_references, outline};
use rogs_orchestrator::Error;
use rogs_orchestrator::quote::shell_word;
use rogs_schemas::ids::safe_name;
use schemars::JsonSchema;
use serde::Serialize;

use self::robot::FoundRobot;
use super::{CommandLine, stage_error};
use crate::output;

/// Writes a manifest for the episodes of a folder and asks nothing: what it finds is filled in, what is missing is said.
///
/// Any layout that `rogs list` shows. The robot's URDF and a calibration file are looked for in the folder and beside it.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The folder with episodes.
    #[arg(default_value = ".")]
    folder: PathBuf,
    /// URDF of the robot; by default looked for in the folder and beside it.
    #[arg(long, value_name = "URDF")]
    robot: Option<PathBuf>,
    /// Calibration file of the cameras, for data that has none; by default looked for.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// The manifest to write; by default the folder's name with `.toml`, here.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// What a manifest is written from.
struct Found {
    /// Name of the run.
    name: String,
    /// The folder, as the manifest writes it.
    root: String,
    /// Its episodes, with frames.
    episodes: Vec<EpisodeListing>,
    /// What the first says of itself.
    outline: EpisodeOutline,
    robot: FoundRobot,
    /// Calibration file, as the manifest writes it.
    calibration: Option<String>,
    /// Folder with caches of PointWorld, as the manifest writes it.
    pointworld: Option<String>,
}

/// What is printed.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Written {
    /// The manifest written.
    manifest: PathBuf,
    /// Layouts of the episodes, as `rogs list` names them.
    layouts: Vec<String>,
    /// Number of episodes.
    episodes: usize,
    /// The URDF, as the manifest writes it.
    urdf: Option<String>,
    /// Name of the preset that fits it.
    preset: Option<&'static str>,
    /// The calibration file, as the manifest writes it.
    calibration: Option<String>,
    /// What the manifest still lacks, and how to get it.
    missing: Vec<String>,
}

/// Most entries of a folder that are looked at, and most folders.
const MOST_ENTRIES: usize = 4096;
const MOST_FOLDERS: usize = 64;
/// Most episodes whose descriptions are read.
const MOST_OUTLINES: usize = 64;

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let folder = std::path::absolute(&args.folder)?;
    let manifest = (args.out.clone()).unwrap_or_else(|| PathBuf::from(format!("{}.toml", run_name(&folder))));
    let place = std::path::absolute(&manifest)?;
    let Some(place) = place.parent() else {
        bail!("invalid manifest `{}`: expected a file", manifest.display());
    };
    let episodes = listed(&folder)?;
    if manifest.exists() {
        let error = Error::usage(format!("`{}` is there already", manifest.display()));
        return Err(error.with_hint("name another file with --out, or remove it").into());
    }
    let found = find(
        &folder,
        episodes,
        args.robot.as_deref(),
        args.calibration.as_deref(),
        place,
    )?;
    rogs_files::write_bytes(&manifest, text::manifest(&found, &manifest).as_bytes())?;
    let told = Written {
        layouts: found.layouts(),
        episodes: found.episodes.len(),
        urdf: found.robot.urdf.clone(),
        preset: found.robot.preset.map(|preset| preset.name),
        calibration: found.calibration.clone(),
        missing: found.missing(),
        manifest,
    };
    if args.json {
        output::json(&told)?;
    } else {
        output::text(&told.text())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The episodes of a folder, with their frames.
fn listed(folder: &Path) -> anyhow::Result<Vec<EpisodeListing>> {
    let mut episodes = match list_episodes(folder) {
        Ok(episodes) => episodes,
        Err(error) => return Err(only_references(folder).unwrap_or_else(|| stage_error(error))),
    };
    count_frames(folder, &mut episodes);
    Ok(episodes)
}

/// What a manifest in `place` is written from.
fn find(
    folder: &Path,
    episodes: Vec<EpisodeListing>,
    robot: Option<&Path>,
    calibration: Option<&Path>,
    place: &Path,
) -> anyhow::Result<Found> {
    let first = episodes.first().context("there is no episode")?;
    let mut outline = outline(folder, first).map_err(stage_error)?;
    outline.calibrated = episodes
        .iter()
        .take(MOST_OUTLINES)
        .all(|episode| is_calibrated(folder, episode));
    let written = |path: &Path| as_written(path, place);
    let robot = robot::find(robot, folder, &outline, &written)?;
    Ok(Found {
        root: written(folder),
        calibration: calibration_file(calibration, folder, &episodes, &outline).map(|path| written(&path)),
        pointworld: pointworld(folder).map(|path| written(&path)),
        name: run_name(folder),
        episodes,
        outline,
        robot,
    })
}

/// The manifest for the episodes of a folder, as `rogs init` would write it into `place`.
///
/// # Errors
/// When there are no episodes, or something is missing that has to be named: a robot, a calibration.
pub(crate) fn manifest_for(
    folder: &Path,
    robot: Option<&Path>,
    calibration: Option<&Path>,
    place: &Path,
) -> anyhow::Result<String> {
    let folder = std::path::absolute(folder)?;
    let found = find(&folder, listed(&folder)?, robot, calibration, place)?;
    let missing = found.missing();
    if !missing.is_empty() {
        let error = Error::usage(format!("`{}`: {}", folder.display(), missing.join("; ")));
        return Err(error
            .with_hint("`rogs init` writes a manifest to complete; then give that manifest")
            .into());
    }
    Ok(text::manifest(&found, Path::new("audit.toml")))
}

impl Found {
    fn layouts(&self) -> Vec<String> {
        let mut layouts: Vec<String> = self.episodes.iter().map(|episode| episode.layout.clone()).collect();
        layouts.sort();
        layouts.dedup();
        layouts
    }

    /// What the manifest still lacks, and how to get it.
    fn missing(&self) -> Vec<String> {
        let mut missing = self.robot.problems.clone();
        if self.calibration.is_none() && !self.outline.calibrated {
            missing.push(format!(
                "of some episodes it is not known where the cameras are: {}",
                how_to_calibrate()
            ));
        }
        missing
    }
}

/// How to get a calibration file, by what this program can do.
fn how_to_calibrate() -> String {
    let command = CommandLine::command();
    match command.find_subcommand("calibrate") {
        Some(_) => "`rogs calibrate --help` says how to estimate it; then name the file with --calibration".to_owned(),
        None => "write a calibration file (docs/calibration-format.md) and name it with --calibration".to_owned(),
    }
}

impl Written {
    fn text(&self) -> String {
        let mut lines = vec![format!(
            "wrote {}: {} episodes ({})",
            self.manifest.display(),
            self.episodes,
            self.layouts.join(", ")
        )];
        lines.extend(self.urdf.iter().map(|urdf| match self.preset {
            Some(preset) => format!("robot: {urdf} (preset `{preset}`)"),
            None => format!("robot: {urdf}; check its names in the manifest"),
        }));
        lines.extend(self.calibration.iter().map(|file| format!("calibration: {file}")));
        lines.extend(self.missing.iter().map(|missing| format!("missing: {missing}")));
        lines.push(format!(
            "next: rogs plan {0}, then rogs run {0}",
            shell_word(&self.manifest.display().to_string())
        ));
        lines.join("\n")
    }
}

/// The error for a folder that holds references and no episode.
fn only_references(folder: &Path) -> Option<anyhow::Error> {
    let found = list_references(folder).ok().filter(|found| !found.is_empty())?;
    let error = Error::usage(format!(
        "`{}` holds references of PointWorld for {} episodes, and no episode",
        folder.display(),
        found.len()
    ));
    let hint = "make the manifest for the folder of raw DROID episodes; there, pointworld = \"FOLDER\" under [input] names this";
    Some(error.with_hint(hint).into())
}

/// A path as a manifest in `place` writes it: relative where it lies below, with `/` between folders.
fn as_written(path: &Path, place: &Path) -> String {
    let full = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let (path, place) = (full(path), full(place));
    let text = |path: &Path| path.to_string_lossy().replace(std::path::MAIN_SEPARATOR, "/");
    if let Ok(below) = path.strip_prefix(&place) {
        return if below.as_os_str().is_empty() {
            ".".to_owned()
        } else {
            text(below)
        };
    }
    // Beside it, one folder up.
    match place.parent().and_then(|above| path.strip_prefix(above).ok()) {
        Some(beside) => format!("../{}", text(beside)),
        None => text(&path),
    }
}

/// A name for the run: that of the folder, or of the one above where the folder is called as any other.
fn run_name(folder: &Path) -> String {
    let usual = ["episodes", "data", "dataset", "recordings"];
    let mut names = folder.ancestors().filter_map(|above| above.file_name()?.to_str());
    let name = names.find(|name| !usual.contains(name)).unwrap_or("run");
    safe_name(name)
}

/// Whether an episode comes with the poses of its cameras; one that cannot be read says so when it is run.
fn is_calibrated(folder: &Path, episode: &EpisodeListing) -> bool {
    rogs_ingest::outline(folder, episode).map_or(true, |outline| outline.calibrated)
}

/// The calibration file that is named, or else the only one that lies in the folder or beside it.
fn calibration_file(
    named: Option<&Path>,
    folder: &Path,
    episodes: &[EpisodeListing],
    outline: &EpisodeOutline,
) -> Option<PathBuf> {
    if named.is_some() || outline.calibrated {
        return named.map(Path::to_owned);
    }
    // `calibration_0007.json` lies beside the episode `0007` and is found without being named.
    let of_episode = |name: &str| {
        episodes
            .iter()
            .any(|episode| name == format!("calibration_{}.json", episode.selector))
    };
    let is_one = |path: &Path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("calibration") && name.ends_with(".json") && !of_episode(&name)
    };
    let near = [Some(folder), folder.parent()].into_iter().flatten();
    near.filter_map(|folder| <[PathBuf; 1]>::try_from(files(folder, &is_one)).ok())
        .map(|[file]| file)
        .next()
}

/// A folder with caches of PointWorld in the folder or beside it.
fn pointworld(folder: &Path) -> Option<PathBuf> {
    let near = [folder.join("pointworld"), folder.with_file_name("pointworld")];
    let has_some = |path: &PathBuf| list_references(path).is_ok_and(|found| !found.is_empty());
    near.into_iter().filter(|path| path.is_dir()).find(has_some)
}

/// Files of a folder that fit, in the order of their names.
fn files(folder: &Path, fits: &dyn Fn(&Path) -> bool) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = entries(folder).map(|entry| entry.path()).collect();
    found.retain(|path| path.is_file() && fits(path));
    found.sort();
    found
}

fn entries(folder: &Path) -> impl Iterator<Item = DirEntry> {
    let entries = rogs_files::entries(folder).into_iter().flatten();
    entries.filter_map(Result::ok).take(MOST_ENTRIES)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_relative_where_that_is_short() {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path().join("work");
        std::fs::create_dir_all(here.join("a/b")).unwrap();
        std::fs::create_dir_all(folder.path().join("data")).unwrap();
        let written = |path: &Path| as_written(path, &here);
        assert_eq!(written(&here), ".");
        assert_eq!(written(&here.join("a/b")), "a/b");
        assert_eq!(written(&here.join("a/../a")), "a");
        assert_eq!(written(&folder.path().join("data")), "../data");
        assert!(Path::new(&as_written(folder.path(), &here.join("a/b"))).is_absolute());
    }
}
