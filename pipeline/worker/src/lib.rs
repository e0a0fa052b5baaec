//! The three faces of a stage program: `one`, `worker`, `describe`.
//!
//! A stage implements [`Stage`]; its binary's `main` is one call of [`stage_main`].

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use rogs_schemas::key::{ContentHash, Provenance};
use rogs_schemas::protocol::{FailureCode, InputDescription};
use rogs_schemas::record::{Record, SchemaId};
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Result of a stage.
pub type StageResult<T> = Result<T, StageError>;

/// A failure as a person will read it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct StageError {
    /// Class, for the retry policy.
    pub code: FailureCode,
    /// What, where (file, clip, frame, joint); lower case, no full stop.
    pub message: String,
    /// What to do about it.
    pub hint: Option<String>,
}

impl StageError {
    /// The input is wrong.
    pub fn bad_input(message: impl Into<String>) -> Self {
        Self { code: FailureCode::BadInput, message: message.into(), hint: None }
    }

    /// The parameters are wrong.
    pub fn bad_params(message: impl Into<String>) -> Self {
        Self { code: FailureCode::BadParams, message: message.into(), hint: None }
    }

    /// Reading or writing failed.
    pub fn io(message: impl Into<String>) -> Self {
        Self { code: FailureCode::Io, message: message.into(), hint: None }
    }

    /// The same error with a hint.
    #[must_use]
    pub fn with_hint(self, hint: impl Into<String>) -> Self {
        Self { hint: Some(hint.into()), ..self }
    }
}

impl From<rogs_schemas::Error> for StageError {
    fn from(error: rogs_schemas::Error) -> Self {
        let code = if matches!(error, rogs_schemas::Error::Io { .. }) { FailureCode::Io } else { FailureCode::BadInput };
        let mut message = error.to_string();
        let mut source = std::error::Error::source(&error);
        while let Some(cause) = source {
            message = format!("{message}: {cause}");
            source = cause.source();
        }
        Self { code, message, hint: None }
    }
}

/// One stage of the pipeline: maps the files of one clip to one new file of that clip.
pub trait Stage: Sized {
    /// Name, `robot-maps`; the program is `rogs-NAME`.
    const NAME: &'static str;
    /// One sentence for help texts.
    const SUMMARY: &'static str;
    /// Raised whenever the bytes of the output change for the same inputs and parameters.
    const VERSION: u32;
    /// Schema of the output.
    const OUTPUT: SchemaId;
    /// Parameters; everything that determines the output besides the inputs. `Default` gives the paper's choices.
    type Params: Serialize + DeserializeOwned + Default + JsonSchema + PartialEq + Clone;

    /// The inputs of the stage.
    fn inputs() -> Vec<InputDescription>;

    /// Makes the stage ready for these parameters (loads a checkpoint once; `inputs` are those of the first job).
    ///
    /// # Errors
    /// When the parameters are wrong or a checkpoint cannot be read.
    fn load(params: &Self::Params, inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self>;

    /// Runs one clip and returns what to write.
    ///
    /// # Errors
    /// When the clip cannot be processed; the worker goes on with the next clip.
    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()>;
}

/// What a running stage sees: its inputs, where to put the output, and how to report.
pub struct Context<'a> {
    clip_id: &'a str,
    inputs: &'a BTreeMap<String, PathBuf>,
    output: &'a Path,
    provenance: Provenance,
    progress: &'a mut dyn FnMut(f64, &str),
    warnings: Vec<String>,
    seconds: BTreeMap<String, f64>,
    written: Option<ContentHash>,
}

impl Context<'_> {
    /// The clip's id.
    #[must_use]
    pub fn clip_id(&self) -> &str {
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
    /// When it is missing or damaged.
    pub fn read<T: Record>(&mut self, role: &str) -> StageResult<T> {
        let (record, info) = rogs_schemas::read_record::<T>(self.input(role)?)?;
        self.provenance.input_content.insert(role.to_owned(), info.content);
        Ok(record)
    }

    /// Writes the output with its provenance. Call exactly once.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write<T: Record>(&mut self, record: &T) -> StageResult<()> {
        let info = rogs_schemas::write_record(self.output, record, &self.provenance)?;
        self.written = Some(info.content);
        Ok(())
    }

    /// Reports progress, `fraction` in 0..=1.
    pub fn progress(&mut self, fraction: f64, message: &str) {
        (self.progress)(fraction, message);
    }

    /// Notes something a person should know; the job goes on.
    pub fn warn(&mut self, warning: impl Into<String>) {
        self.warnings.push(warning.into());
    }

    /// Runs a phase and adds its seconds to the report under `name`.
    pub fn timed<T>(&mut self, name: &str, phase: impl FnOnce(&mut Self) -> T) -> T {
        let start = std::time::Instant::now();
        let result = phase(self);
        *self.seconds.entry(name.to_owned()).or_default() += start.elapsed().as_secs_f64();
        result
    }
}

/// The `main` of a stage program.
pub fn stage_main<S: Stage>() -> ExitCode {
    stage_main_from::<S>(std::env::args_os().skip(1).collect())
}

/// The same with given arguments (without the program name); `rogs stage NAME ...` ends here.
pub fn stage_main_from<S: Stage>(_arguments: Vec<OsString>) -> ExitCode {
    unimplemented!()
}
