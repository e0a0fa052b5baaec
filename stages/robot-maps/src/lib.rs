//! Robot maps: where robot and cameras are at every frame of a clip, and what the cameras see of the robot's mesh.
//!
//! The stage reads a clip and a URDF, runs forward kinematics on the recorded joints, resolves the poses of all cameras
//! (hand-eye cameras follow their link), fixes the reconstruction frame at the first source camera and source time, and
//! rasterises mesh depth and link ids for every source camera and frame (`docs/spec/stage1.md` sections 9 and 10).

mod build;
mod params;
mod stage;
mod support;

pub use build::{Robot, build};
pub use params::{Params, SupportRule};
pub use stage::RobotMapsStage;
pub use support::valid_support;
