//! The frame of what moves.

use rogs_geometry::Frame;

/// The frame of a rigid body: a link of the robot, an object or a piece of scenery.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyFrame {}

impl Frame for BodyFrame {
    const NAME: &'static str = "body";
}
