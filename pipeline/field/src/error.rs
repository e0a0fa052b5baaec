//! Errors of fields and PLY files.

use std::path::PathBuf;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// What can be wrong with a field or a PLY file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A field is asked for something that it does not hold, or its arrays contradict each other.
    #[error("field of clip `{clip}`: {what}")]
    Field {
        /// Clip id of the field.
        clip: String,
        /// What is wrong.
        what: String,
    },
    /// A PLY file that is not a 3DGS PLY, or is damaged.
    #[error("not a readable 3DGS PLY: {what}")]
    Ply {
        /// What is wrong and where.
        what: String,
    },
    /// The operating system refused.
    #[error("{action} `{}`", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// Why it failed.
        source: std::io::Error,
    },
    /// Gaussians contradict each other.
    #[error(transparent)]
    Splat(#[from] rogs_splat::SplatError),
}

impl From<rogs_files::Error> for Error {
    fn from(error: rogs_files::Error) -> Self {
        let rogs_files::Error { action, path, source } = error;
        Self::Io { action, path, source }
    }
}
