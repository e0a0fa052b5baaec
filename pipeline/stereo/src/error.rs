//! Errors of this crate.

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Why a pair cannot be matched.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A buffer that is not an image of the size that its camera says.
    #[error("an image of {width}x{height} pixels needs {expected} bytes, there are {found}")]
    ImageSize {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
        /// Bytes that it should have.
        expected: usize,
        /// Bytes that it has.
        found: usize,
    },
    /// Eyes of different sizes.
    #[error("the eyes have images of different sizes: {left:?} and {right:?} (width, height)")]
    Sizes {
        /// Left width and height.
        left: [usize; 2],
        /// Right width and height.
        right: [usize; 2],
    },
    /// A distance between the eyes that no stereo camera has.
    #[error("the eyes stand {metres} m apart{hint}")]
    Baseline {
        /// Length of the baseline as given, metres.
        metres: f64,
        /// What it may be instead.
        hint: &'static str,
    },
    /// The right eye stands to the left of the left one.
    #[error("left and right eyes look swapped: the right eye stands {metres} m to the LEFT of the left one")]
    Swapped {
        /// Distance, metres.
        metres: f64,
    },
    /// Calibration that does not describe a rectified pair.
    #[error(
        "the pair is not rectified: by its calibration, rows of the two eyes differ by up to {rows_px:.2} pixels and columns at infinity by {columns_px:.2}"
    )]
    NotRectified {
        /// Largest difference of rows, pixels.
        rows_px: f64,
        /// Largest difference of the disparity of points at infinity, pixels.
        columns_px: f64,
    },
    /// A setting that means nothing.
    #[error("{what}")]
    Setting {
        /// Which one, with its value and what it should be.
        what: String,
    },
}
