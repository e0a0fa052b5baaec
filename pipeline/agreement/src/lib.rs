//! Does the rendered robot agree with the images? (`docs/spec/agreement.md`)
//!
//! A [`View`] holds an image, the camera that took it, and the robot's surface as the mesh rasteriser draws it from this
//! camera. [`measure`] searches the image's own edges along the normals of the drawn contours; what it finds are
//! [`EdgeSample`]s, from which cameras can be refined. [`Agreement`] sums them up: an offset in pixels and millimetres
//! with its uncertainty, or [`Agreement::CannotTell`] where the robot is hardly visible.
//!
//! Images are `[H, W, 3]` and maps `[H, W]`, row-major; image points are in pixels with pixel centres at `+ 0.5`.

mod agreement;
pub mod audit;
mod colour;
mod contour;
mod following;
mod measure;
mod motion;
mod shift;
mod solve;
mod view;

pub use agreement::{Agreeing, Agreement, DepthAgreement, Why, agreement};
pub use contour::{ContourKind, ContourPoint, contours};
pub use following::{Following, MovedView, follow, link_offsets};
pub use measure::{EdgeSample, Measurement, Settings, measure};
pub use motion::{MotionAgreement, MovingFrame, motion};
pub use shift::{ImageShift, common_shift};
pub use solve::{inverse, solve};
pub use view::{Surface, View};

/// What does not fit together in a view.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what}")]
pub struct Error {
    /// What is wrong, with both sizes.
    pub what: String,
}

/// Result with the crate's error.
pub type Result<T> = std::result::Result<T, Error>;
