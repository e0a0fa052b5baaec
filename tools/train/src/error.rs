//! What can go wrong in training.

use std::path::{Path, PathBuf};

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// A message for the person who trains: what, where, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A setting is out of its range.
    #[error("`{what}` is {value}; it must be {rule}")]
    Setting {
        /// Name of the setting, with its table.
        what: &'static str,
        /// What was given.
        value: String,
        /// What is possible.
        rule: &'static str,
    },
    /// A configuration file cannot be understood.
    #[error("{}: {reason}", path.display())]
    Configuration {
        /// The file.
        path: PathBuf,
        /// Line and column, and what is wrong.
        reason: String,
    },
    /// A folder of an earlier run does not fit what is asked now.
    #[error("{}: {reason}", path.display())]
    Folder {
        /// The folder or file.
        path: PathBuf,
        /// What is wrong and what to do.
        reason: String,
    },
    /// Reading or writing failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The loss or a gradient is not a number any more.
    #[error(
        "step {step}: {what} is not finite; the last checkpoint is whole, resume from it with a lower learning rate"
    )]
    Diverged {
        /// The update.
        step: u64,
        /// Which number.
        what: String,
    },
    /// A network or checkpoint error.
    #[error(transparent)]
    Network(#[from] rogs_tensors::Error),
    /// A weights file cannot be used.
    #[error(transparent)]
    Weights(#[from] rogs_weights::Error),
    /// The generator failed.
    #[error(transparent)]
    Synth(#[from] rogs_synth::Error),
    /// Lifting or refining a clip failed.
    #[error("{0}")]
    Stage(String),
    /// A recorded pose is missing or not a rigid transform.
    #[error(transparent)]
    Geometry(#[from] rogs_geometry::Error),
    /// The rasteriser failed.
    #[error(transparent)]
    Splat(#[from] rogs_splat::SplatError),
    /// A field cannot be used.
    #[error(transparent)]
    Field(#[from] rogs_field::Error),
}

impl From<rogs_files::Error> for Error {
    fn from(error: rogs_files::Error) -> Self {
        Self::Io {
            path: error.path,
            source: error.source,
        }
    }
}

impl From<rogs_worker::StageError> for Error {
    fn from(error: rogs_worker::StageError) -> Self {
        Self::Stage(error.to_string())
    }
}

impl Error {
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self + '_ {
        move |source| Self::Io {
            path: path.to_owned(),
            source,
        }
    }
}
