//! Calibrates cameras by the robot in their images (`docs/spec/calibration.md`).
//!
//! A [`Take`] is a clip and one of its cameras. [`refine`] moves the camera, and where [`Prior`] says so its focal length,
//! principal point and clock, until the robot drawn from mesh and joint states lies on that of the images; a camera on the
//! hand also until points of the scene keep to their epipolar lines along its known path. [`search`] finds a start where
//! there is none. Whatever is solved for has a covariance, and what the images cannot tell is an error.
//!
//! Poses are in metres, image points in pixels with pixel centres at `+ 0.5`, times in frames.

mod correction;
mod edges;
mod epipolar;
mod moment;
mod outline;
mod overlay;
mod refine;
pub mod rig;
mod scaled;
mod search;
mod silhouettes;
mod solve;
mod take;
mod tracks;

pub use correction::{Correction, Prior, UNKNOWNS, Vector};
pub use overlay::{Picture, overlay};
pub use refine::{Fit, Refined, Settings, refine};
pub use search::{Found, search};
pub use take::Take;

use rogs_agreement::Why;

/// Why a camera is not calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The images do not tell.
    #[error("cannot be calibrated: {why}")]
    CannotTell {
        /// The reason.
        why: Why,
    },
    /// There is one image only.
    #[error("cannot be calibrated: {frames} frame(s) with image and state, expected 2 or more")]
    TooFewFrames {
        /// Number of frames.
        frames: usize,
    },
    /// A search compares what moves.
    #[error("no pose can be searched: the robot, or the image, does not move")]
    StandsStill,
    /// The pose of the camera is recorded for every frame, and a single one is solved for.
    #[error("cannot be calibrated: its pose is recorded for every frame")]
    PoseOfEveryFrame,
    /// Nothing near the given pose makes the robot lie on the images.
    #[error("no pose found at which the drawn robot lies on the images (overlay {overlay:.2} of 1)")]
    NotFound {
        /// The best overlay.
        overlay: f64,
    },
    /// What is given does not fit together.
    #[error("{what}")]
    Input {
        /// What is wrong.
        what: String,
    },
}

impl From<rogs_agreement::Error> for Error {
    fn from(error: rogs_agreement::Error) -> Self {
        Self::Input { what: error.what }
    }
}

impl From<rogs_robot::Error> for Error {
    fn from(error: rogs_robot::Error) -> Self {
        Self::Input { what: error.chain() }
    }
}

/// Result with the crate's error.
pub type Result<T> = std::result::Result<T, Error>;
