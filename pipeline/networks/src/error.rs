//! What can go wrong with weights and inputs.

use std::path::PathBuf;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure, worded for the person who supplied the weights or the input.
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
    /// A configuration is not one this network can have.
    #[error("the network configuration is not possible: {0}")]
    BadConfiguration(String),
    /// The device cannot be used.
    #[error("{0}")]
    Device(String),
    /// An input does not fit the network.
    #[error("{0}")]
    BadInput(String),
}
