//! What can go wrong: parameters and files.

use std::path::{Path, PathBuf};

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure as a person will read it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting is out of its range.
    #[error("{what}: `{value}` ({rule})")]
    Config {
        /// Name of the setting.
        what: &'static str,
        /// What was given.
        value: String,
        /// What is allowed.
        rule: &'static str,
    },
    /// The operating system refused.
    #[error("cannot write: `{}`", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Its answer.
        source: std::io::Error,
    },
    /// The output folder holds something this program did not write.
    #[error("there is something else in the way: `{}` (choose another folder or remove it)", path.display())]
    Occupied {
        /// What is in the way.
        path: PathBuf,
    },
    /// A file could not be written.
    #[error(transparent)]
    File(#[from] rogs_files::Error),
    /// An image could not be encoded.
    #[error("cannot encode an image")]
    Image(#[from] image::ImageError),
    /// A description could not be written as JSON.
    #[error("cannot write a description as JSON")]
    Json(#[source] serde_json::Error),
    /// An HDF5 file could not be put together.
    #[error("cannot write an HDF5 file")]
    Hdf5(#[source] hdf5_writer::Error),
    /// A program that packs videos failed or is not there.
    #[error("the program `{program}` failed: {why} (`rogs doctor` looks for it)")]
    Program {
        /// Its name.
        program: &'static str,
        /// What it said.
        why: String,
    },
    /// No motion was found that the arm can follow.
    #[error("seed `{seed}`: no motion found that the arm can follow after {attempts} attempts (use another seed)")]
    NoMotion {
        /// The episode's seed.
        seed: u64,
        /// Attempts made.
        attempts: usize,
    },
}

impl Error {
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    pub(crate) fn hdf5(source: hdf5_writer::Error) -> Self {
        Self::Hdf5(source)
    }

    pub(crate) fn program(program: &'static str, why: String) -> Self {
        Self::Program { program, why }
    }

    pub(crate) fn json(source: serde_json::Error) -> Self {
        Self::Json(source)
    }
}
