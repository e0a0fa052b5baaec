//! Errors of the rasteriser.

/// Result of this crate.
pub type Result<T> = std::result::Result<T, SplatError>;

/// What can be wrong with a call.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SplatError {
    /// An array does not have the length that the number of Gaussians, pixels or channels asks for.
    #[error("{array} has {found} values, expected {expected} ({meaning})")]
    Shape {
        /// Which array.
        array: &'static str,
        /// Its length.
        found: usize,
        /// The length it must have.
        expected: usize,
        /// How the expected length comes about.
        meaning: String,
    },
    /// A camera or a setting that no image can be rendered with.
    #[error("{what}: {value}")]
    Setting {
        /// What is wrong, with what would be right.
        what: &'static str,
        /// The value found.
        value: String,
    },
    /// There is no GPU, or it cannot do what was asked.
    #[error("GPU: {what}")]
    Gpu {
        /// What is wrong.
        what: String,
    },
}

impl SplatError {
    /// An error of the GPU.
    #[cfg(feature = "gpu")]
    pub(crate) fn gpu(what: impl Into<String>) -> Self {
        Self::Gpu { what: what.into() }
    }

    /// Checks an array's length.
    pub(crate) fn check(array: &'static str, found: usize, expected: usize, meaning: &str) -> Result<()> {
        if found == expected {
            Ok(())
        } else {
            Err(Self::Shape {
                array,
                found,
                expected,
                meaning: meaning.to_owned(),
            })
        }
    }
}
