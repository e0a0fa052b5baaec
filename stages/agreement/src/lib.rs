//! Agreement: does the robot, drawn from its mesh and joint states, lie on the robot of the images?
//! (`docs/spec/agreement.md`)
//!
//! The stage measures every source camera at every frame, says how far the robot of the images is off, and where it is off
//! tries which mistake of calibration or states explains that. It warns and never fails a clip that robot maps can be made
//! of. In a rollout it measures how the generated robot follows the commanded one.

mod build;
mod params;
mod stage;

pub use build::{Robot, build};
pub use params::Params;
pub use stage::AgreementStage;
