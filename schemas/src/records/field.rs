//! The Stage-1 field: one Gaussian per source pixel, with its displacement and attributes at query times.

use serde::{Deserialize, Serialize};

use super::check::{Check, area, binary, count, ensure, nonzero, pose, product};
use super::clip::{Clip, SourceView};
use super::robot::RobotMaps;
use crate::ids::ClipId;
use crate::pose::RigidPose;

/// Raw attributes per Gaussian: colour 3, scale 3, rotation (w, x, y, z) 4, opacity 1, before activation.
pub const RAW_CHANNELS: usize = 11;

/// A time-queryable field, written by `lift`. `N = S * H * W`; Gaussian `n` is pixel `(row, column)` of source view `s`
/// with `n = (s * H + row) * W + column`, and keeps that identity at all times.
///
/// Lengths are metres in the reconstruction frame. The raw scale is a pre-activation whose activated value
/// `min(cap, 0.001 * softplus(raw))` is in internal units (`docs/spec/stage1.md` section 7); the cap is 0.3 where
/// [`Field::scale_cap_iu`] has none.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// The clip this belongs to.
    pub clip_id: ClipId,
    /// Number of frames of the clip; normalised time is frame / (frame_count - 1).
    pub frame_count: u32,
    /// Image height of the source views, pixels.
    pub height: u32,
    /// Image width of the source views, pixels.
    pub width: u32,
    /// Source views in token order (camera-major, times ascending). `[S]`
    pub views: Vec<SourceView>,
    /// H, base-to-reconstruction.
    pub recon_from_base: RigidPose,
    /// What the weights were that made it.
    pub weights: WeightsInfo,
    /// Source positions p, reconstruction frame, metres. `[N, 3]`
    pub position_m: Vec<f32>,
    /// Base attributes, raw. `[N, RAW_CHANNELS]`
    pub base_raw: Vec<f32>,
    /// 1 where the Gaussian is anchored on the robot mesh. `[N]`
    pub support: Vec<u8>,
    /// Link id of anchored Gaussians, `NO_LINK` elsewhere. `[N]`
    pub link: Vec<u8>,
    /// Cap of each activated scale axis, internal units: the anchored footprint, or 0.3 of the unit that the Gaussian was
    /// lifted in; infinite where it is the usual 0.3. `[N]`
    pub scale_cap_iu: Vec<f32>,
    /// The field at stored times, ascending in time.
    pub slices: Vec<TimeSlice>,
    /// What the motion heads need to answer other times without the backbone; empty when it was not kept.
    pub query_state: Vec<NamedArray>,
}

/// The field at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeSlice {
    /// Normalised time in [0, 1].
    pub time: f64,
    /// Centre displacement d(t), metres, reconstruction frame. The centre is `position_m + displacement_m`. `[N, 3]`
    pub displacement_m: Vec<f32>,
    /// Motion gates: bit 0, colour, scale and rotation take the query-time value; bit 1, opacity does. `[N]`
    pub gate: Vec<u8>,
    /// Query-time raw attributes of the Gaussians whose gate is not 0, in index order. `[M, RAW_CHANNELS]`
    pub moving_raw: Vec<f32>,
}

/// Bit of [`TimeSlice::gate`]: colour, scale and rotation take the query-time value.
pub const GATE_ATTRIBUTES: u8 = 1;
/// Bit of [`TimeSlice::gate`]: opacity takes the query-time value.
pub const GATE_OPACITY: u8 = 2;

/// Where network weights came from; printed in reports.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WeightsInfo {
    /// True when the weights are trained; false for seeded random weights, which lift nothing.
    pub trained: bool,
    /// Configuration name: `full`, `compact`, ...
    pub configuration: String,
    /// For people: file name and provenance, or the seed.
    pub description: String,
    /// BLAKE3 of the weights file, hex; empty for seeded weights.
    pub hash: String,
}

/// A named f32 array of any shape.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedArray {
    /// Name, ASCII.
    pub name: String,
    /// Shape, row-major.
    pub shape: Vec<u32>,
    /// Values.
    pub data: Vec<f32>,
}

impl Field {
    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.views.len() * self.height as usize * self.width as usize
    }

    /// True when there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The stored slice at exactly this normalised time.
    #[must_use]
    pub fn slice_at(&self, time: f64) -> Option<&TimeSlice> {
        self.slices.iter().find(|slice| slice.time == time)
    }
}

impl Field {
    /// The field, the clip and the robot maps are of one clip and of one size, and there are Gaussians.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check_beside(&self, clip: &Clip, robot: &RobotMaps) -> Check {
        let frames = clip.frame_count();
        let problem = if clip.clip_id != self.clip_id || clip.clip_id != robot.clip_id {
            format!(
                "clip `{}`, robot maps of `{}` and field of `{}` do not belong together",
                clip.clip_id, robot.clip_id, self.clip_id
            )
        } else if (clip.height, clip.width) != (self.height, self.width) {
            format!(
                "the field has {} x {} pixels a view, the clip {} x {}",
                self.height, self.width, clip.height, clip.width
            )
        } else if self.frame_count as usize != frames {
            format!("the field counts {} frames, the clip {frames}", self.frame_count)
        } else if robot.base_from_camera.len() != clip.cameras.len() * frames {
            format!(
                "the robot maps have {} camera poses for {} cameras and {frames} frames",
                robot.base_from_camera.len(),
                clip.cameras.len()
            )
        } else if let Some(view) = self.views.iter().find(|view| view.camera.at() >= clip.cameras.len()) {
            format!(
                "the field has a view of camera {}, the clip has {} cameras",
                view.camera,
                clip.cameras.len()
            )
        } else if self.is_empty() {
            "the field has no Gaussians".to_owned()
        } else {
            return Ok(());
        };
        Err(problem)
    }

    /// The arrays agree with the counts, and every number is possible.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        let total = product("Gaussians", &[area(self.height, self.width)?, self.views.len()])?;
        ensure(self.frame_count > 0, || "the clip has no frames".into())?;
        ensure(self.views.iter().all(|view| view.frame.0 < self.frame_count), || {
            format!("a source view lies beyond the {} frames", self.frame_count)
        })?;
        pose("recon_from_base", &self.recon_from_base)?;
        count("positions", self.position_m.len(), 3 * total)?;
        count("base attributes", self.base_raw.len(), RAW_CHANNELS * total)?;
        count("support", self.support.len(), total)?;
        binary("support", &self.support)?;
        count("link ids", self.link.len(), total)?;
        count("scale caps", self.scale_cap_iu.len(), total)?;
        ensure(self.scale_cap_iu.iter().all(|cap| *cap >= 0.0), || {
            "a scale cap is negative or NaN".into()
        })?;
        ensure(self.slices.is_sorted_by(|a, b| a.time < b.time), || {
            "times do not ascend".into()
        })?;
        for slice in &self.slices {
            let here = |what: String| format!("time {}: {what}", slice.time);
            ensure((0.0..=1.0).contains(&slice.time), || here("it is not in 0 to 1".into()))?;
            count("displacements", slice.displacement_m.len(), 3 * total).map_err(here)?;
            count("gates", slice.gate.len(), total).map_err(here)?;
            ensure(
                slice.gate.iter().all(|&gate| gate <= GATE_ATTRIBUTES | GATE_OPACITY),
                || here("unknown gate bit".into()),
            )?;
            count(
                "query-time attributes",
                slice.moving_raw.len(),
                RAW_CHANNELS * nonzero(&slice.gate),
            )
            .map_err(here)?;
        }
        check_arrays(&self.query_state)
    }
}

/// Every array has as many values as its shape says.
///
/// # Errors
/// Which has not.
pub fn check_arrays(arrays: &[NamedArray]) -> Check {
    arrays
        .iter()
        .try_for_each(|array| count(&array.name, array.data.len(), array_length(&array.name, &array.shape)?))
}

/// Number of values of an array of this shape.
///
/// # Errors
/// When it is too large for this machine; the message begins with `name`.
pub fn array_length(name: &str, shape: &[u32]) -> Result<usize, String> {
    let dims: Vec<usize> = shape.iter().map(|&dim| dim as usize).collect();
    product(name, &dims)
}
