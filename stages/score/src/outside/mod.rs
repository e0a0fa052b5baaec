//! Fields of outside methods: 4DGT's polynomial Gaussians and Shape of Motion's motion bases, and the calibrated merging of camera-wise fields in the robot base frame.
//!
//! [`OutsideField`] and [`ImagePredictions`] read what a method left in a folder of files.
//!
//! Lengths are metres; a state at a time is a plain set of Gaussians that the same rasteriser renders.

mod field;
mod images;
mod merge;
mod motion_basis;
mod polynomial;
mod sampled;

use std::path::{Path, PathBuf};

pub use field::{FieldFrame, OutsideField};
pub use images::{CameraImages, ImagePredictions};
pub use merge::{merge, stereo_scale};
pub use motion_basis::{BasisField, read_basis_gaussians};
pub use polynomial::read_polynomials;
use rogs_schemas::FrameIndex;
pub use sampled::SampledField;

/// Why an outside field cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OutsideError {
    /// Arrays that contradict each other.
    #[error("{0}")]
    Contradiction(String),
    /// A frame that the field does not have.
    #[error("the field has {frames} frames, frame {frame} was asked for")]
    NoFrame {
        /// What was asked for.
        frame: usize,
        /// How many there are.
        frames: usize,
    },
    /// A clip frame that was not exported.
    #[error(
        "there is nothing for clip frame {frame}; frames: {}",
        frames.iter().map(FrameIndex::to_string).collect::<Vec<_>>().join(", ")
    )]
    MissingFrame {
        /// What was asked for.
        frame: FrameIndex,
        /// What is there.
        frames: Vec<FrameIndex>,
    },
    /// A file that cannot be used.
    #[error("`{}`: {what}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
}

impl From<rogs_arrays::Error> for OutsideError {
    fn from(error: rogs_arrays::Error) -> Self {
        Self::file(&error.path, error.problem.to_string())
    }
}

impl OutsideError {
    pub(crate) fn file(path: &Path, what: impl Into<String>) -> Self {
        Self::File {
            path: path.to_owned(),
            what: what.into(),
        }
    }
}
