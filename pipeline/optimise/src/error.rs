//! Errors of the optimisation.

/// Result of this crate.
pub type Result<T> = std::result::Result<T, OptimiseError>;

/// What can be wrong with a call.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OptimiseError {
    /// An array does not have the length that the others ask for.
    #[error("{array} has {found} values, expected {expected}")]
    Length {
        /// Which array.
        array: &'static str,
        /// Its length.
        found: usize,
        /// The length it must have.
        expected: usize,
    },
    /// An image too small for what is computed on it.
    #[error("{what} needs an image of at least {least} x {least} pixels, found {width} x {height}")]
    TooSmall {
        /// What is computed.
        what: &'static str,
        /// Smallest side, pixels.
        least: usize,
        /// Width found, pixels.
        width: usize,
        /// Height found, pixels.
        height: usize,
    },
    /// A setting or a number of things that leaves nothing to compute.
    #[error("{what}")]
    Empty {
        /// What is missing.
        what: &'static str,
    },
}

/// Checks an array's length.
pub(crate) fn expect(array: &'static str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        Ok(())
    } else {
        Err(OptimiseError::Length { array, found, expected })
    }
}
