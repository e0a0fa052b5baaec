//! Parameters of the stage.

use rogs_schemas::records::robot::RobotSpec;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of `robot-maps`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Params {
    /// Which joints, meshes and tool of the robot.
    pub robot: RobotSpec,
    /// Which mesh pixels anchor Gaussians.
    pub support: SupportRule,
}

/// Which pixels count as valid robot support (`docs/spec/stage1.md` section 10).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SupportRule {
    /// Nearest mesh depth, metres.
    pub min_depth_m: f32,
    /// Farthest mesh depth, metres.
    pub max_depth_m: f32,
    /// Erode once with a 3x3 window; image borders count as uncovered.
    pub erode: bool,
    /// Drop pixels whose 3x3 neighbourhood spans two links with depths that differ by more than this, metres.
    pub link_boundary_m: f32,
}

impl Default for SupportRule {
    fn default() -> Self {
        Self {
            min_depth_m: 0.05,
            max_depth_m: 5.0,
            erode: true,
            link_boundary_m: 0.03,
        }
    }
}

impl SupportRule {
    /// What is wrong with the numbers, if anything.
    pub(crate) fn problem(&self) -> Option<&'static str> {
        let Self {
            min_depth_m,
            max_depth_m,
            erode: _,
            link_boundary_m,
        } = *self;
        if !(min_depth_m >= 0.0 && min_depth_m < max_depth_m) {
            Some("support.min_depth_m must lie between 0 and support.max_depth_m")
        } else if link_boundary_m.is_nan() || link_boundary_m < 0.0 {
            Some("support.link_boundary_m must not be negative")
        } else {
            None
        }
    }
}
