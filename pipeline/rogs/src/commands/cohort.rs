//! `rogs cohort`: an evaluation cohort, chosen before any output exists.

use std::collections::BTreeSet;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use rogs_ingest::{EpisodeFacts, survey};
use rogs_orchestrator::Error;
use rogs_schemas::selection::{ExclusionReason, Selection};
use rogs_score::cohort::{CohortOptions, EpisodeRecord, PointWorldManifest, differences, read_episodes, select};

use crate::output;

/// Selects episodes as the paper does and writes `selection.json`, which a manifest names as `[input] selection`.
///
/// The episodes are those of a list (--episodes), of a folder in any layout that ingest knows (--root), or, without
/// either, those of the PointWorld split itself: then nothing but membership can be checked, and the file says so.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Episode list: a JSON array of records, or one record a line.
    #[arg(long, value_name = "FILE", conflicts_with = "root")]
    episodes: Option<PathBuf>,
    /// Folder of episodes; each is opened and checked.
    #[arg(long, value_name = "FOLDER")]
    root: Option<PathBuf>,
    /// Calibration file for episodes of a folder whose layout has none.
    #[arg(long, value_name = "FILE", requires = "root")]
    calibration: Option<PathBuf>,
    /// Ids of episodes in training or validation lists, one a line; these are excluded.
    #[arg(long, value_name = "FILE")]
    exclude: Option<PathBuf>,
    /// The released PointWorld split (`droid_paper_split_manifest.json`). Without it episodes need not be in its test set.
    #[arg(long, value_name = "FILE", required_unless_present_any = ["episodes", "root"])]
    manifest: Option<PathBuf>,
    /// Where the selection goes. A file of another selection is not overwritten.
    #[arg(long, value_name = "FILE", default_value = "selection.json")]
    out: PathBuf,
    /// Write the episode list that was looked at, one record a line (`--episodes` reads it).
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// Laboratories held out; default ILIAD and PennPAL. `all` takes every laboratory.
    #[arg(long, value_name = "LAB")]
    lab: Vec<String>,
    /// Seed of the permutation.
    #[arg(long, default_value_t = 42)]
    seed: u64,
    /// Episodes to select.
    #[arg(long, default_value_t = 256)]
    take: usize,
    /// Replace the file of another selection.
    #[arg(long)]
    force: bool,
    /// Print one JSON value: the selection.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let mut options = CohortOptions {
        seed: args.seed,
        take: args.take,
        ..CohortOptions::default()
    };
    if args.lab.iter().any(|lab| lab == "all") {
        options.labs.clear();
    } else if !args.lab.is_empty() {
        options.labs.clone_from(&args.lab);
    }
    let manifest = args.manifest.as_deref().map(PointWorldManifest::read).transpose()?;
    let mut episodes = episodes(args, manifest.as_ref(), &mut options)?;
    if let Some(path) = &args.exclude {
        mark_excluded(&mut episodes, path)?;
        options
            .not_checked
            .retain(|reason| *reason != ExclusionReason::TrainOrVal);
    }
    let selection = select(&episodes, manifest.as_ref(), &options)?;
    if let Some(path) = &args.list {
        rogs_files::write_with(path, |out| {
            for episode in &episodes {
                serde_json::to_writer(&mut *out, episode)?;
                out.write_all(b"\n")?;
            }
            Ok(())
        })?;
    }
    write(&selection, &args.out, args.force)?;
    if args.json {
        output::json(&selection)?;
    } else {
        output::text(&describe(&selection, &args.out))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The episodes to choose from; `options` learns what their source says nothing about.
fn episodes(
    args: &Args,
    manifest: Option<&PointWorldManifest>,
    options: &mut CohortOptions,
) -> anyhow::Result<Vec<EpisodeRecord>> {
    if let Some(path) = &args.episodes {
        return Ok(read_episodes(path)?);
    }
    let Some(root) = &args.root else {
        options.source = "manifest".to_owned();
        options.not_checked = PointWorldManifest::says_nothing_of();
        return Ok(manifest.map(PointWorldManifest::as_list).unwrap_or_default());
    };
    options.source = "folder".to_owned();
    options.not_checked = vec![ExclusionReason::TrainOrVal];
    let labs = options.labs.clone();
    let wanted = |id: &str| labs.is_empty() || labs.iter().any(|lab| Some(lab.as_str()) == id.split('+').next());
    let facts = survey(root, args.calibration.as_deref(), |listing| wanted(&listing.episode_id))?;
    if facts.is_empty() {
        let message = format!("`{}` holds no episode of {}", root.display(), options.labs.join(", "));
        return Err(Error::usage(message)
            .with_hint("ids are LAB+...: name laboratories with --lab, or take every episode with --lab all")
            .into());
    }
    Ok(facts.into_iter().map(record).collect())
}

/// What a cohort asks of an episode of a folder.
fn record(facts: EpisodeFacts) -> EpisodeRecord {
    let (content, unreadable) = match facts.content {
        Ok(content) => (Some(content), None),
        Err(why) => (None, Some(why)),
    };
    EpisodeRecord {
        episode_id: facts.listing.episode_id,
        lab: None,
        scene: None,
        clip_name: Some(facts.listing.name),
        train_or_val: false,
        stereo: content.is_some_and(|content| content.stereo),
        frames: content.map_or(0, |content| content.frames),
        // What can be read has calibrated cameras.
        calibration: content.is_some(),
        gripper_range: content.map(|content| content.gripper_range),
        unreadable,
    }
}

/// Marks the episodes that a list of ids names.
fn mark_excluded(episodes: &mut [EpisodeRecord], path: &Path) -> anyhow::Result<()> {
    let text = rogs_files::read_to_string(path).with_context(|| format!("reading `{}`", path.display()))?;
    let ids: BTreeSet<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    for episode in episodes {
        episode.train_or_val |= ids.contains(episode.episode_id.as_str());
    }
    Ok(())
}

/// Writes a selection; a file that holds another one stays as it is, unless `force` says otherwise.
fn write(selection: &Selection, path: &Path, force: bool) -> anyhow::Result<()> {
    if let (Ok(text), false) = (rogs_files::read(path), force) {
        let differ = match serde_json::from_slice::<Selection>(&text) {
            Ok(old) => differences(&old, selection),
            Err(_) => vec!["it holds something else".to_owned()],
        };
        if !differ.is_empty() {
            let message = format!("`{}` holds another selection: {}", path.display(), differ.join("; "));
            return Err(Error::usage(message)
                .with_hint("a cohort is fixed before outputs are seen: name another --out, or replace it with --force")
                .into());
        }
    }
    let mut text = serde_json::to_vec_pretty(selection)?;
    text.push(b'\n');
    rogs_files::write_bytes(path, &text)?;
    Ok(())
}

/// Counts after every step, and why episodes were left out.
fn describe(selection: &Selection, path: &Path) -> String {
    let counts = &selection.counts;
    let mut text = format!(
        "{} reserved, {} cached, {} in the test set, {} eligible, {} selected: {}",
        counts.reserved,
        counts.cached,
        counts.candidates,
        counts.eligible,
        counts.selected,
        path.display()
    );
    for (reason, count) in &selection.exclusion_counts {
        text.push_str(&format!("\n  excluded, {}: {count}", reason.name()));
    }
    let candidates = selection.candidates.as_ref();
    if let Some(candidates) = candidates.filter(|candidates| !candidates.not_checked.is_empty()) {
        let names: Vec<&str> = candidates.not_checked.iter().map(|reason| reason.name()).collect();
        text.push_str(&format!("\n  not checked: {}", names.join(", ")));
    }
    for (id, why) in candidates.iter().flat_map(|candidates| &candidates.unreadable).take(3) {
        text.push_str(&format!("\n  cannot be read: {id}: {why}"));
    }
    text
}
