//! From a manifest file to a plan that can be run.

use std::path::Path;
use std::sync::Arc;

use crate::error::{Error, Result};
use crate::executor::RunOptions;
use crate::manifest::Manifest;
use crate::plan::{PLAN_FILE, Plan, make_plan, read_header, read_plan};
use crate::programs::StagePrograms;
use crate::sources::SourceCache;

/// Name of the manifest's copy in a run folder.
pub const MANIFEST_FILE: &str = "manifest.toml";

/// Name of the remembered source hashes in a run folder.
pub const SOURCES_FILE: &str = "sources.json";

/// A manifest with its plan.
#[derive(Debug, Clone)]
pub struct Prepared {
    /// The manifest, paths absolute.
    pub manifest: Manifest,
    /// Its text as it was read.
    pub text: String,
    /// The plan.
    pub plan: Plan,
    /// How to run it on this machine; change what the command line says otherwise.
    pub options: RunOptions,
    /// Content of the sources, to be remembered when something is run.
    sources: Arc<SourceCache>,
}

impl Prepared {
    /// Reads a manifest (or the one in a run folder), asks the stage programs, hashes sources, and plans. Writes nothing.
    ///
    /// `programs` are used when the manifest names none of its own; see [`StagePrograms::this_program`].
    ///
    /// # Errors
    /// When the manifest is wrong, a source is missing, or a stage program does not answer.
    pub fn load(path: &Path, programs: StagePrograms) -> Result<Self> {
        let in_run = path.join(PLAN_FILE);
        let path = if in_run.is_file() {
            read_plan(path)?.manifest
        } else {
            path.to_owned()
        };
        let (manifest, text) = Manifest::load(&path)?;
        let programs = manifest
            .executor
            .programs
            .clone()
            .map_or(programs, StagePrograms::Directory);
        let cache_file = manifest.run.out.join(SOURCES_FILE);
        let sources = SourceCache::open(&cache_file);
        let plan = make_plan(&manifest, &text, &programs, &sources)?;
        same_selection(&plan)?;
        let options = RunOptions::of(&manifest, programs);
        Ok(Self {
            manifest,
            text: text.text,
            plan,
            options,
            sources: Arc::new(sources),
        })
    }

    /// Remembers the content of the sources in the run folder, where there is one, so that the next plan need not read
    /// them again. It only saves time, so it may fail.
    pub(crate) fn remember_sources(&self) {
        if self.plan.run.is_dir() {
            let _ = self.sources.save();
        }
    }

    /// Runs what is not up to date: [`crate::executor::execute`], with a copy of the manifest in the run folder.
    ///
    /// # Errors
    /// See [`crate::executor::execute`].
    pub fn run(&self) -> Result<crate::executor::RunSummary> {
        self.remember_sources();
        let summary = crate::executor::execute(&self.plan, &self.options)?;
        rogs_files::write_bytes(&self.plan.run.join(MANIFEST_FILE), self.text.as_bytes())?;
        self.remember_sources();
        Ok(summary)
    }
}

/// Refuses a run folder that was begun with another selection: its outputs would be of two cohorts.
fn same_selection(plan: &Plan) -> Result<()> {
    if !plan.run.join(PLAN_FILE).is_file() {
        return Ok(());
    }
    // A plan that cannot be read is made again.
    let Some(old) = read_header(&plan.run).ok().and_then(|old| old.selection) else {
        return Ok(());
    };
    match &plan.selection {
        Some(new) if new.source.content != old.source.content => Err(Error::usage(format!(
            "the run folder `{}` was begun with another selection: {}; the manifest names {}",
            plan.run.display(),
            old.describe(),
            new.describe()
        ))
        .with_hint("a cohort is fixed before outputs are seen: name another `out` in [run], or the old selection")),
        _ => Ok(()),
    }
}
