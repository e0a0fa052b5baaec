//! Removing what no plan needs any more.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::error::{Result, io};
use crate::ledger::LOG_FILE;
use crate::lock::RunLock;
use crate::plan::{Plan, Unit, read_plan};

/// What was, or would be, removed.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Collected {
    /// Files, relative to the run folder.
    pub files: Vec<PathBuf>,
    /// Their length.
    pub bytes: u64,
    /// True when nothing was removed.
    pub dry_run: bool,
}

/// Removes outputs that the plan of the run does not name (of clips and variants that are gone) and what killed writers
/// left behind. Files that are not ours are never touched, and links are not followed.
///
/// # Errors
/// When the run is in use or cannot be read or changed.
pub fn collect(run: &Path, dry_run: bool) -> Result<Collected> {
    let plan = read_plan(run)?;
    let _lock = RunLock::acquire(&plan.run)?;
    let needed = needed(&plan);
    let mut found = Collected {
        dry_run,
        ..Collected::default()
    };
    let clips = plan.run.join("clips");
    visit(&plan, &clips, 0, &needed, &mut found)?;
    found.files.sort();
    if !dry_run {
        for file in &found.files {
            let path = plan.run.join(file);
            std::fs::remove_file(&path).map_err(io("cannot remove", &path))?;
        }
        remove_empty(&clips, 0);
    }
    Ok(found)
}

fn needed(plan: &Plan) -> BTreeSet<PathBuf> {
    let maker = plan.key_maker();
    let of_clip = |clip: usize| {
        let keys = maker.keys(clip);
        (0..plan.nodes.len())
            .map(move |node| plan.output(Unit { clip, node }, &keys))
            .collect::<Vec<_>>()
    };
    (0..plan.clips.len()).flat_map(of_clip).collect()
}

/// Clip folders are at depth 1, folders named by a key at depth 2; nothing of ours lies deeper.
fn visit(plan: &Plan, folder: &Path, depth: usize, needed: &BTreeSet<PathBuf>, found: &mut Collected) -> Result<()> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        other => other.map_err(io("cannot list", folder))?,
    };
    let known = plan
        .clips
        .iter()
        .any(|clip| folder.file_name().is_some_and(|name| name == clip.id.as_str()));
    for entry in entries {
        let entry = entry.map_err(io("cannot list", folder))?;
        let (path, kind) = (entry.path(), entry.file_type().map_err(io("cannot list", folder))?);
        if kind.is_dir() && depth < 2 {
            visit(plan, &path, depth + 1, needed, found)?;
        }
        if !kind.is_file() || depth == 0 {
            continue;
        }
        let name = entry.file_name().to_string_lossy().into_owned();
        let relative = path.strip_prefix(&plan.run).unwrap_or(&path).to_owned();
        let left_over = name.starts_with('.') && name.ends_with(".tmp") && writer_is_gone(&name);
        let not_needed = name.ends_with(".r4c") && !name.starts_with('.') && !needed.contains(&relative);
        // The log of a clip that is in no plan any more.
        let orphan_log = name == LOG_FILE && depth == 1 && !known;
        if left_over || not_needed || orphan_log {
            found.bytes += entry.metadata().map_or(0, |file| file.len());
            found.files.push(relative);
        }
    }
    Ok(())
}

/// A temporary file is named `.NAME.PID.tmp` or `.NAME.PID-N.tmp`.
fn writer_is_gone(name: &str) -> bool {
    let id = name
        .trim_end_matches(".tmp")
        .rsplit('.')
        .next()
        .and_then(|part| part.split('-').next()?.parse::<u32>().ok());
    id.is_some_and(|id| Path::new("/proc/self").exists() && !Path::new("/proc").join(id.to_string()).exists())
}

fn remove_empty(folder: &Path, depth: usize) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) && depth < 2 {
            remove_empty(&entry.path(), depth + 1);
            // Only succeeds on an empty folder, which is what is wanted.
            let _ = std::fs::remove_dir(entry.path());
        }
    }
}
