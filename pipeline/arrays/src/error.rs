//! Why a file cannot be read.

use std::path::{Path, PathBuf};

/// Result of the readers.
pub type Result<T> = std::result::Result<T, Error>;

/// A file that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("`{}`: {problem}", path.display())]
pub struct Error {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub problem: Problem,
}

/// What is wrong with a file; the text does not name it.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// The operating system refused.
    #[error(transparent)]
    Io(std::io::Error),
    /// It is damaged, of another format, or holds something else than was asked for.
    #[error("{0}")]
    Wrong(String),
}

impl Error {
    /// The operating system refused to read `path`.
    pub(crate) fn io(path: &Path, error: std::io::Error) -> Self {
        Self {
            path: path.to_owned(),
            problem: Problem::Io(error),
        }
    }

    /// Something is wrong with the content of `path`.
    pub(crate) fn wrong(path: &Path, what: impl Into<String>) -> Self {
        Self {
            path: path.to_owned(),
            problem: Problem::Wrong(what.into()),
        }
    }
}
