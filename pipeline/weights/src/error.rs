//! What can go wrong with weights.

use std::path::PathBuf;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure, worded for the person who supplied the weights.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A parameter the configuration needs is not in the weights.
    #[error("the weights lack the tensor `{name}`")]
    MissingTensor {
        /// Full name of the parameter.
        name: String,
    },
    /// A parameter has another shape than the configuration says.
    #[error("the tensor `{name}` has shape {found:?}, the configuration needs {expected:?}")]
    WrongShape {
        /// Full name of the parameter.
        name: String,
        /// Shape in the weights.
        found: Vec<usize>,
        /// Shape the configuration needs.
        expected: Vec<usize>,
    },
    /// A weights file cannot be understood.
    #[error("{}: {reason}", path.display())]
    BadFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Reading or writing a file failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// What is asked for cannot be done with these files.
    #[error("{0}")]
    BadInput(String),
}

impl From<rogs_files::Error> for Error {
    fn from(error: rogs_files::Error) -> Self {
        Self::Io {
            path: error.path,
            source: error.source,
        }
    }
}
