//! Errors of this crate.

use rogs_schemas::FrameIndex;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// What can be wrong with a pose.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A matrix that is not a rigid transform.
    #[error("not a rigid transform: {what}")]
    NotRigid {
        /// Which property fails, with the figure.
        what: String,
    },
    /// A camera that the robot maps have no pose of.
    #[error("the robot maps have no pose of camera `{camera}` at frame {frame}")]
    NoPose {
        /// Its id, or its number where the clip has no such camera.
        camera: String,
        /// Clip frame.
        frame: FrameIndex,
    },
    /// Cameras that make no path, or a camera that cannot look as it is asked to.
    #[error("invalid camera: {what}")]
    Path {
        /// Why.
        what: String,
    },
    /// A frame that the robot maps have no link poses of.
    #[error("the robot maps have no link poses for frame {frame}")]
    MissingLinkPoses {
        /// Clip frame.
        frame: FrameIndex,
    },
}
