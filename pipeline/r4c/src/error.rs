//! Errors of containers and records.

use std::path::PathBuf;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// What can be wrong with a container file or a record.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused.
    #[error("{action} `{}`", path.display())]
    Io {
        /// What was tried, for example `opening`.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// Why it failed.
        source: std::io::Error,
    },
    /// A check of the container failed.
    #[error("`{}` is damaged at byte {offset}: {check}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where in the file, bytes from its start.
        offset: u64,
        /// The check that failed, with stream and chunk where they are known.
        check: String,
    },
    /// The file is whole but is something else than was asked for.
    #[error("`{}` holds {found}, expected {expected}", path.display())]
    WrongKind {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: String,
        /// What it should be.
        expected: String,
    },
    /// A record whose arrays contradict each other.
    #[error("record `{schema}`: {what}")]
    Inconsistent {
        /// Schema name.
        schema: &'static str,
        /// What contradicts what.
        what: String,
    },
}

impl From<rogs_files::Error> for Error {
    fn from(error: rogs_files::Error) -> Self {
        let rogs_files::Error { action, path, source } = error;
        Self::Io { action, path, source }
    }
}
