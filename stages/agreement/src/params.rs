//! Parameters of the stage.

use rogs_schemas::records::robot::RobotSpec;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of `agreement`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Params {
    /// Which joints, meshes and tool of the robot.
    pub robot: RobotSpec,
    /// Whether mistakes of calibration and states are tried where the robot does not lie on recorded images.
    pub explain: bool,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            robot: RobotSpec::default(),
            explain: true,
        }
    }
}
