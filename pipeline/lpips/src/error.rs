//! What can go wrong with weights and images.

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure, worded for the person who supplied the weights or the images.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The weights cannot be used.
    #[error(transparent)]
    Weights(#[from] rogs_weights::Error),
    /// Images cannot be compared.
    #[error("{0}")]
    BadInput(String),
}
