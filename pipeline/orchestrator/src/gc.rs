//! Removing what no plan needs any more.

use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use rogs_schemas::interim;
use rogs_schemas::ledger::LOG_FILE;
use schemars::JsonSchema;
use serde::Serialize;

use crate::error::{Result, io};
use crate::lock::{RunLock, refuse_active};
use crate::plan::{Plan, WorkUnit, read_plan};

/// What was, or would be, removed.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, JsonSchema)]
pub struct Collected {
    /// Files, relative to the run folder.
    pub files: Vec<PathBuf>,
    /// Their length.
    pub bytes: u64,
    /// True when nothing was removed.
    pub dry_run: bool,
}

/// Removes outputs that the plan of the run does not name (of clips and variants that are gone) and what killed writers
/// left behind. Files that are not ours are never touched, and links are not followed. A dry run writes nothing.
///
/// # Errors
/// When the run is in use or cannot be read or changed.
pub fn collect(run: &Path, dry_run: bool) -> Result<Collected> {
    let mut plan = read_plan(run)?;
    let _lock = if dry_run {
        refuse_active(&plan.run)?;
        None
    } else {
        let lock = RunLock::acquire(&plan.run)?;
        // Nobody else plans from here on.
        plan = read_plan(run)?;
        Some(lock)
    };
    let needed = needed(&plan);
    let mut found = Collected {
        dry_run,
        ..Collected::default()
    };
    // The run folder itself may be a link.
    plan.run = plan.run.canonicalize().map_err(io("cannot find", &plan.run))?;
    let clips = plan.run.join("clips");
    let known: HashSet<&str> = plan.clips.iter().map(|clip| clip.id.as_str()).collect();
    let mut sweep = Sweep {
        run: &plan.run,
        needed: &needed,
        known: &known,
        found: &mut found,
    };
    sweep.clips(&clips, 0)?;
    // Beside the clips: the plan, the manifest, the ledgers, the job scripts, the report.
    sweep.left_behind(&plan.run, 0)?;
    found.files.sort();
    if !dry_run {
        for file in &found.files {
            let path = plan.run.join(file);
            rogs_files::remove_below(&plan.run, &path)?;
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
            .map(move |node| plan.output(WorkUnit { clip, node }, &keys))
            .collect::<Vec<_>>()
    };
    (0..plan.clips.len()).flat_map(of_clip).collect()
}

/// What a look through a run folder needs to know, and what it found.
struct Sweep<'a> {
    run: &'a Path,
    needed: &'a BTreeSet<PathBuf>,
    known: &'a HashSet<&'a str>,
    found: &'a mut Collected,
}

impl Sweep<'_> {
    /// Clip folders are at depth 1, folders named by a key at depth 2; nothing of ours lies deeper.
    fn clips(&mut self, folder: &Path, depth: usize) -> Result<()> {
        let name = folder.file_name().and_then(|name| name.to_str());
        let known = name.is_some_and(|name| self.known.contains(name));
        for entry in list(folder)? {
            let (path, kind) = (entry.path(), entry.file_type().map_err(io("cannot list", folder))?);
            if kind.is_dir() && depth < 2 {
                self.clips(&path, depth + 1)?;
            }
            if !kind.is_file() || depth == 0 {
                continue;
            }
            let name = entry.file_name().to_string_lossy().into_owned();
            let relative = path.strip_prefix(self.run).unwrap_or(&path);
            // Figures and picture of a killed job: not needed without the state that it would resume from.
            let shown = [interim::FIGURES, interim::PICTURE].iter().any(|ending| {
                let stem = name.strip_suffix(ending);
                stem.is_some_and(|stem| stem.len() > 1 && stem.ends_with('.'))
            });
            let ours = name.ends_with(".r4c") || shown;
            let not_needed = ours && !name.starts_with('.') && !self.needed.contains(relative);
            // The log of a clip that is in no plan any more.
            let orphan_log = name == LOG_FILE && depth == 1 && !known;
            if not_needed || orphan_log || rogs_files::is_left_behind(&path) {
                self.take(&path, &entry);
            }
        }
        Ok(())
    }

    /// Only what killed writers left, outside of `clips`: `report/tables` is the deepest folder of ours.
    fn left_behind(&mut self, folder: &Path, depth: usize) -> Result<()> {
        for entry in list(folder)? {
            let (path, kind) = (entry.path(), entry.file_type().map_err(io("cannot list", folder))?);
            if kind.is_dir() && depth < 2 && entry.file_name() != "clips" {
                self.left_behind(&path, depth + 1)?;
            } else if kind.is_file() && rogs_files::is_left_behind(&path) {
                self.take(&path, &entry);
            }
        }
        Ok(())
    }

    fn take(&mut self, path: &Path, entry: &std::fs::DirEntry) {
        self.found.bytes += entry.metadata().map_or(0, |file| file.len());
        self.found
            .files
            .push(path.strip_prefix(self.run).unwrap_or(path).to_owned());
    }
}

/// Entries of a folder; none when it is not there, or a link.
fn list(folder: &Path) -> Result<Vec<std::fs::DirEntry>> {
    if folder.is_symlink() {
        return Ok(Vec::new());
    }
    match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        other => other.and_then(Iterator::collect).map_err(io("cannot list", folder)),
    }
}

fn remove_empty(folder: &Path, depth: usize) {
    if folder.is_symlink() {
        return;
    }
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) && depth < 2 {
            remove_empty(&entry.path(), depth + 1);
            // Only succeeds on an empty folder, which is what is wanted.
            let _ = std::fs::remove_dir(entry.path());
        }
    }
}
