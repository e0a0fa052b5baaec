//! Errors of the orchestrator.

use std::fmt;
use std::path::{Path, PathBuf};

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// What can stop the orchestrator itself. Failures of single clips are never errors here; they are outcomes.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Something is wrong in the manifest.
    #[error("{}{place}: {message}", path.display())]
    Manifest {
        /// The manifest.
        path: PathBuf,
        /// Where in it.
        place: Place,
        /// What is wrong.
        message: String,
        /// What to do.
        hint: Option<String>,
    },
    /// What was asked for makes no sense, or a run folder does not hold what it should.
    #[error("{message}")]
    Usage {
        /// What is wrong.
        message: String,
        /// What to do.
        hint: Option<String>,
    },
    /// A stage program cannot be started or does not answer as it should.
    #[error("stage program `{program}`: {message}")]
    Program {
        /// The command.
        program: String,
        /// What is wrong.
        message: String,
        /// What to do.
        hint: Option<String>,
    },
    /// Another program that we call - a client of Slurm - does not do what it was asked to.
    #[error("`{tool}`: {message}")]
    Tool {
        /// The program.
        tool: &'static str,
        /// What is wrong.
        message: String,
        /// What to do.
        hint: Option<String>,
    },
    /// The machine changed under us, or took something away that was there when the work began.
    #[error("{message}")]
    Environment {
        /// What is wrong.
        message: String,
        /// What to do.
        hint: Option<String>,
    },
    /// Another process works in the run folder.
    #[error("`{}` is in use by {holder}", run.display())]
    Locked {
        /// The run folder.
        run: PathBuf,
        /// Who holds it.
        holder: String,
    },
    /// The operating system refused.
    #[error("{action} `{}`: {source}", path.display())]
    Io {
        /// What was tried, for example `cannot write`.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// Why it failed.
        source: std::io::Error,
    },
    /// A container or source could not be read or written.
    #[error("{0}")]
    Schemas(String),
}

/// A place in a text file; empty when it is not known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Place {
    /// Line and column, from 1.
    pub at: Option<(usize, usize)>,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.at.map_or(Ok(()), |(line, column)| write!(f, ":{line}:{column}"))
    }
}

impl Error {
    /// A [`Error::Usage`] without a hint.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::Usage {
            message: message.into(),
            hint: None,
        }
    }

    /// What to do about it, where something is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Manifest { hint, .. }
            | Self::Usage { hint, .. }
            | Self::Program { hint, .. }
            | Self::Tool { hint, .. }
            | Self::Environment { hint, .. } => hint.clone(),
            Self::Locked { .. } => {
                Some("wait until it has finished, stop it, or use another `out` folder in the manifest".to_owned())
            }
            Self::Io { source, .. } => rogs_files::hint(source).map(str::to_owned),
            Self::Schemas(_) => None,
        }
    }

    /// The same error with a hint.
    #[must_use]
    pub fn with_hint(mut self, text: impl Into<String>) -> Self {
        if let Self::Manifest { hint, .. }
        | Self::Usage { hint, .. }
        | Self::Program { hint, .. }
        | Self::Tool { hint, .. }
        | Self::Environment { hint, .. } = &mut self
        {
            *hint = Some(text.into());
        }
        self
    }

    /// The same error, found when the work had begun already: what was right then is wrong now, so that it is no mistake
    /// of whoever asked.
    #[must_use]
    pub fn after_start(self) -> Self {
        match self {
            Self::Usage { message, hint } => Self::Environment {
                message,
                hint: hint.or_else(|| Some("does something else change the run folder? Run again".to_owned())),
            },
            other => other,
        }
    }
}

impl From<rogs_r4c::Error> for Error {
    fn from(error: rogs_r4c::Error) -> Self {
        match error {
            rogs_r4c::Error::Io { action, path, source } => Self::Io { action, path, source },
            other => Self::Schemas(with_causes(&other)),
        }
    }
}

impl From<rogs_files::Error> for Error {
    fn from(error: rogs_files::Error) -> Self {
        let rogs_files::Error { action, path, source } = error;
        Self::Io { action, path, source }
    }
}

/// An error and its causes in one line.
fn with_causes(error: &dyn std::error::Error) -> String {
    let mut message = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        message = format!("{message}: {cause}");
        source = cause.source();
    }
    message
}

/// For `map_err`: an [`Error::Io`] about this path.
pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let path = path.to_owned();
    move |source| Error::Io { action, path, source }
}
