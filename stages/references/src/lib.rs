//! References: what a field is scored against, for clips that come without (`docs/spec/references.md`).
//!
//! From a clip whose cameras have right eyes the stage makes depth of both eyes by classical stereo (`rogs_stereo`), and
//! from the robot maps tracks of points on the robot's visible mesh by forward kinematics. What the clip has already stays,
//! unless the parameters say otherwise. Every reference says what made it.

mod build;
mod params;
mod stage;
mod stereo;
mod tracks;

pub use build::build;
pub use params::{Params, TrackParams, When};
pub use stage::ReferencesStage;
