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
            Self::Manifest { hint, .. } | Self::Usage { hint, .. } | Self::Program { hint, .. } => hint.clone(),
            Self::Locked { .. } => {
                Some("wait until it has finished, stop it, or use another `out` folder in the manifest".to_owned())
            }
            Self::Io { source, .. } if source.kind() == std::io::ErrorKind::StorageFull => {
                Some("free some space, then run the same command again: finished outputs are kept".to_owned())
            }
            Self::Io { .. } | Self::Schemas(_) => None,
        }
    }

    /// The same error with a hint.
    #[must_use]
    pub fn with_hint(mut self, text: impl Into<String>) -> Self {
        if let Self::Manifest { hint, .. } | Self::Usage { hint, .. } | Self::Program { hint, .. } = &mut self {
            *hint = Some(text.into());
        }
        self
    }
}

impl From<rogs_r4c::Error> for Error {
    fn from(error: rogs_r4c::Error) -> Self {
        Self::Schemas(with_causes(&error))
    }
}

impl From<rogs_files::Error> for Error {
    fn from(error: rogs_files::Error) -> Self {
        Self::Schemas(with_causes(&error))
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
