//! Why images cannot be scored.

use std::path::PathBuf;

use crate::metrics::MetricError;
use crate::pictures::{EXTENSIONS, PictureError};

/// Why images cannot be scored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// A file cannot be read.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// A path that does not exist.
    #[error("there is no file or folder `{}`", path.display())]
    Nothing {
        /// The path.
        path: PathBuf,
    },
    /// A file against a folder.
    #[error("`{}` and `{}` must both be files or both be folders", prediction.display(), reference.display())]
    Mixed {
        /// Prediction.
        prediction: PathBuf,
        /// Reference.
        reference: PathBuf,
    },
    /// The folders, or files of arrays, have no name in common.
    #[error(
        "`{}` and `{}` have no image in common by name (files of {}); the first holds {}, the second {}",
        prediction.display(), reference.display(), EXTENSIONS.join(", "), some(own), some(other)
    )]
    NothingInCommon {
        /// Prediction.
        prediction: PathBuf,
        /// Reference.
        reference: PathBuf,
        /// What is there of the prediction.
        own: Vec<String>,
        /// What is there of the reference.
        other: Vec<String>,
    },
    /// Two images cannot be compared.
    #[error("`{name}` cannot be scored")]
    Pair {
        /// File name.
        name: String,
        /// Why.
        source: MetricError,
    },
    /// Two pictures cannot be compared.
    #[error("`{name}` cannot be scored: {what}")]
    Unlike {
        /// File name.
        name: String,
        /// Why.
        what: String,
    },
}

/// A few names of a list.
fn some(names: &[String]) -> String {
    match names {
        [] => "none".to_owned(),
        [first] => format!("`{first}`"),
        [first, .., last] => format!("{}, `{first}` to `{last}`", names.len()),
    }
}
