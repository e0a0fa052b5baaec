//! Errors of this crate.

use std::path::PathBuf;

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can be wrong with a file of another program, or with what is to become one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file says something that is not read.
    #[error("`{}`: {what}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        what: String,
    },
    /// A scene is not one.
    #[error("scene: {what}")]
    Scene {
        /// What is wrong, and where.
        what: String,
    },
    /// The operating system refused.
    #[error("reading `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A form of file cannot hold what it was given.
    #[error("{what}")]
    Unfit {
        /// What, and which part of it.
        what: String,
    },
    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] rogs_files::Error),
    /// A camera has no pose at a frame.
    #[error(transparent)]
    Geometry(#[from] rogs_geometry::Error),
}
