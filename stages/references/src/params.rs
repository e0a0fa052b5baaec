//! Parameters of the stage.

use rogs_stereo::MatcherParams;
use rogs_worker::{StageError, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of `references`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Params {
    /// When depth is made from stereo pairs.
    pub depth: When,
    /// When robot tracks are made by kinematics.
    pub tracks: When,
    /// Depths outside this open interval are not scored, metres.
    pub depth_range_m: [f32; 2],
    /// How pairs are matched.
    pub stereo: MatcherParams,
    /// How tracks are chosen.
    pub robot: TrackParams,
}

/// When references are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum When {
    /// Where the clip has none.
    #[default]
    Missing,
    /// Always, in the place of the clip's own.
    Always,
    /// Never.
    Never,
}

impl When {
    /// Whether to make what the clip has, or has not.
    pub(crate) fn wants(self, there: bool) -> bool {
        match self {
            Self::Missing => !there,
            Self::Always => true,
            Self::Never => false,
        }
    }
}

/// Which points of the robot are tracked (`docs/spec/references.md` section 2).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrackParams {
    /// Distance of neighbouring anchor pixels along rows and columns, pixels. It grows until there are few enough.
    pub spacing_px: u32,
    /// Most tracks of a camera.
    pub most_per_camera: u32,
    /// A point is hidden where the mesh lies this much nearer to the camera, metres.
    pub hidden_m: f32,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            depth: When::Missing,
            tracks: When::Missing,
            depth_range_m: [0.1, 5.0],
            stereo: MatcherParams::default(),
            robot: TrackParams::default(),
        }
    }
}

impl Default for TrackParams {
    fn default() -> Self {
        Self {
            spacing_px: 4,
            most_per_camera: 512,
            hidden_m: 0.02,
        }
    }
}

impl Params {
    /// Checks what does not depend on a clip.
    ///
    /// # Errors
    /// When a number means nothing; with its name.
    pub(crate) fn check(&self) -> StageResult<()> {
        let wrong = |what: String| Err(StageError::bad_params(what));
        let [near, far] = self.depth_range_m;
        if !(near.is_finite() && far.is_finite() && 0.0 <= near && near < far) {
            return wrong(format!("invalid `depth_range_m` {near} to {far}: expected an interval"));
        }
        let TrackParams {
            spacing_px,
            most_per_camera,
            hidden_m,
        } = self.robot;
        if spacing_px == 0 || most_per_camera == 0 {
            return wrong(format!(
                "invalid `robot.spacing_px` {spacing_px} and `robot.most_per_camera` {most_per_camera}: expected 1 or more"
            ));
        }
        if !(hidden_m.is_finite() && hidden_m > 0.0) {
            return wrong(format!("invalid `robot.hidden_m` {hidden_m}: expected metres above 0"));
        }
        let of_stereo = |error: rogs_stereo::Error| StageError::bad_params(format!("`stereo`: {error}"));
        self.stereo.check().map_err(of_stereo)
    }
}
