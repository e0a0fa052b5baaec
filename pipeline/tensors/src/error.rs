//! What can go wrong with networks and their inputs.

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure, worded for the person who supplied the weights or the input.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A weights file or a tensor of it cannot be used.
    #[error(transparent)]
    Weights(#[from] rogs_weights::Error),
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
