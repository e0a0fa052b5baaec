//! What a running stage sees.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use rogs_r4c::Record;
use rogs_schemas::ClipId;
use rogs_schemas::interim::{self, Figures, Interim};
use rogs_schemas::key::{CacheKey, ContentHash, Provenance};
use rogs_schemas::records::progress::Progress;

use crate::error::{StageError, StageResult};
use crate::observer::Observer;

/// What a running stage sees: its inputs, where to put the output, and how to report.
pub struct Context<'a> {
    clip_id: &'a ClipId,
    inputs: &'a BTreeMap<String, PathBuf>,
    output: &'a Path,
    provenance: Provenance,
    progress: &'a mut dyn FnMut(f64, &str),
    warnings: Vec<String>,
    seconds: BTreeMap<String, f64>,
    written: Option<ContentHash>,
}

/// What is left of a context after the stage ran.
pub(crate) struct Outcome {
    pub(crate) warnings: Vec<String>,
    pub(crate) seconds: BTreeMap<String, f64>,
    pub(crate) written: Option<ContentHash>,
}

impl<'a> Context<'a> {
    pub(crate) fn new(
        clip_id: &'a ClipId,
        inputs: &'a BTreeMap<String, PathBuf>,
        output: &'a Path,
        provenance: Provenance,
        progress: &'a mut dyn FnMut(f64, &str),
    ) -> Self {
        let (warnings, seconds, written) = Default::default();
        Self {
            clip_id,
            inputs,
            output,
            provenance,
            progress,
            warnings,
            seconds,
            written,
        }
    }

    pub(crate) fn into_outcome(self) -> Outcome {
        Outcome {
            warnings: self.warnings,
            seconds: self.seconds,
            written: self.written,
        }
    }
}

impl Context<'_> {
    /// The clip's id.
    #[must_use]
    pub fn clip_id(&self) -> &ClipId {
        self.clip_id
    }

    /// Path of a required input.
    ///
    /// # Errors
    /// When the job does not name it.
    pub fn input(&self, role: &str) -> StageResult<&Path> {
        self.optional_input(role)
            .ok_or_else(|| StageError::bad_params(format!("the job names no input `{role}`")))
    }

    /// Path of an optional input.
    #[must_use]
    pub fn optional_input(&self, role: &str) -> Option<&Path> {
        self.inputs.get(role).map(PathBuf::as_path)
    }

    /// Reads a required container input and notes its content hash in the provenance of the output.
    ///
    /// # Errors
    /// When it is missing or damaged, or is not the file that the plan names by its key.
    pub fn read<T: Record>(&mut self, role: &str) -> StageResult<T> {
        let (record, info) = rogs_r4c::read_record::<T>(self.input(role)?)?;
        let planned = self
            .provenance
            .material
            .inputs
            .get(role)
            .and_then(|id| id.parse::<CacheKey>().ok());
        let found = info.provenance.key();
        if let Some(planned) = planned.filter(|planned| *planned != found) {
            let path = self.input(role)?.display();
            return Err(
                StageError::bad_input(format!("`{path}` has key {found}, but the plan names {planned}"))
                    .with_hint("the file changed after planning; run again"),
            );
        }
        self.provenance.input_content.insert(role.to_owned(), info.content);
        Ok(record)
    }

    /// The key by which the plan names a container input; `None` for inputs that are not containers.
    #[must_use]
    pub fn input_key(&self, role: &str) -> Option<CacheKey> {
        self.provenance.material.inputs.get(role)?.parse().ok()
    }

    /// Writes the output with its provenance. Call exactly once.
    ///
    /// # Errors
    /// When writing fails, or the stage writes a second time.
    pub fn write<T: Record>(&mut self, record: &T) -> StageResult<()> {
        if self.written.is_some() {
            return Err(StageError::internal("the stage wrote its output twice"));
        }
        let start = Instant::now();
        let info = rogs_r4c::write_record(self.output, record, &self.provenance)?;
        *self.seconds.entry("write".to_owned()).or_default() += start.elapsed().as_secs_f64();
        self.written = Some(info.content);
        Ok(())
    }

    /// What a run of this very job (same key) kept with [`keep`](Self::keep) before it was killed. A file that is damaged, or
    /// of another key, counts as none: the job then begins at its beginning.
    #[must_use]
    pub fn kept(&self) -> Option<Progress> {
        let (progress, info) = rogs_r4c::read_record::<Progress>(&interim::beside(self.output, interim::STATE)).ok()?;
        (info.provenance.material == self.provenance.material).then_some(progress)
    }

    /// Keeps how far the job has come beside its output, in place of what was kept before. It is taken away when the job has
    /// ended; where it is killed, [`kept`](Self::kept) gives it to the next run of the same job.
    ///
    /// # Errors
    /// When writing fails.
    pub fn keep(&mut self, progress: &Progress) -> StageResult<()> {
        let start = Instant::now();
        rogs_r4c::write_record(
            &interim::beside(self.output, interim::STATE),
            progress,
            &self.provenance,
        )?;
        *self.seconds.entry("keep".to_owned()).or_default() += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Shows how far the job has come beside its output, in place of what was shown before: figures, and a picture as the bytes
    /// of a PNG. Both are taken away with what was [kept](Self::keep). The job goes on where they cannot be written.
    pub fn show(&mut self, figures: &Figures, picture_png: &[u8]) {
        let interim = Interim {
            key: self.provenance.key(),
            figures: figures.clone(),
        };
        let figures = serde_json::to_vec(&interim).unwrap_or_default();
        let files = [(interim::PICTURE, picture_png), (interim::FIGURES, figures.as_slice())];
        for (ending, bytes) in files {
            if let Err(error) = rogs_files::write_bytes(&interim::beside(self.output, ending), bytes) {
                let warning = format!("how far the job is cannot be shown: {error}");
                if !self.warnings.contains(&warning) {
                    self.warn(warning);
                }
            }
        }
    }

    /// Reports progress, `fraction` in 0..=1.
    pub fn progress(&mut self, fraction: f64, message: &str) {
        (self.progress)(fraction, message);
    }

    /// Notes something a person should know; the job continues.
    pub fn warn(&mut self, warning: impl Into<String>) {
        self.warnings.push(warning.into());
    }

    /// Runs a phase and adds its seconds to the report under `name`.
    pub fn timed<T>(&mut self, name: &str, phase: impl FnOnce(&mut Self) -> T) -> T {
        let start = Instant::now();
        let result = phase(self);
        self.add_seconds(name, start.elapsed().as_secs_f64());
        result
    }

    /// Adds seconds that were measured elsewhere to the report under `name`.
    pub fn add_seconds(&mut self, name: &str, seconds: f64) {
        *self.seconds.entry(name.to_owned()).or_default() += seconds;
    }
}

impl Observer for Context<'_> {
    fn progress(&mut self, fraction: f64, what: &str) {
        Context::progress(self, fraction, what);
    }

    fn add_seconds(&mut self, name: &str, seconds: f64) {
        Context::add_seconds(self, name, seconds);
    }

    fn warn(&mut self, warning: String) {
        Context::warn(self, warning);
    }

    fn keep(&mut self, progress: &Progress) -> StageResult<()> {
        Context::keep(self, progress)
    }

    fn show(&mut self, figures: &Figures, picture_png: &[u8]) {
        Context::show(self, figures, picture_png);
    }
}
