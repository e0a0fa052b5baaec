//! Scores of one field on one clip, with the renders they were measured on.

use serde::{Deserialize, Serialize};

use super::check::{Check, area, count, ensure};
use super::field::WeightsInfo;
use crate::ids::ClipId;
use crate::index::FrameIndex;
use crate::records::origin::ReferenceUse;

/// Written by `score`. A metric that cannot be measured is `None`, never 0 (`docs/spec/scoring.md` section 11).
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// Numbers.
    pub summary: ScoreSheet,
    /// Renders at the query plan, empty when they were not kept.
    pub renders: Vec<RenderedView>,
}

/// Every number of one clip and method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScoreSheet {
    /// The clip.
    pub clip_id: ClipId,
    /// Method name of the table row, for example `stage1` or `stage1+2`.
    pub method: String,
    /// `recorded` or `rollout`.
    pub setting: String,
    /// SSIM variant name.
    pub ssim_variant: String,
    /// Why LPIPS is missing, if it is.
    pub lpips_note: Option<String>,
    /// What the weights behind the field were.
    pub weights: Vec<WeightsInfo>,
    /// Per (camera, query frame).
    pub images: Vec<ImageScore>,
    /// Per (anchor, query frame): displacement errors.
    pub tracks: Vec<TrackScore>,
    /// Per query frame: robot depth errors.
    pub robot_depth: Vec<RobotDepthScore>,
    /// Number of (camera, time) pairs whose depth support was empty.
    pub n_empty_support: u32,
    /// Gaussians dropped as invalid by the rasteriser, largest count over the renders.
    pub invalid_gaussians: u64,
    /// What it was measured against: depth by camera, then tracks. It lies in a stream of its own.
    #[serde(skip)]
    pub references: Vec<ReferenceUse>,
    /// How well the observations agree with each other: the image of every source camera against the field of the others,
    /// at the query frames. It lies in a stream of its own.
    #[serde(skip)]
    pub cross_view: Vec<CrossViewScore>,
}

/// An observation against what the field of the other source cameras shows there (`docs/spec/scoring.md` section 14).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CrossViewScore {
    /// Id of the camera that is left out.
    pub camera: String,
    /// Clip frame.
    pub frame: FrameIndex,
    /// PSNR over the pixels that the others show, dB; `None` where they are too few.
    pub psnr: Option<f64>,
    /// Share of the pixels that the others show, in 0..=1.
    pub shown: f64,
}

/// Scores of one rendered image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ImageScore {
    /// Camera id.
    pub camera: String,
    /// True for source cameras, false for held-out (novel) ones.
    pub source_view: bool,
    /// Clip frame.
    pub frame: FrameIndex,
    /// PSNR, dB.
    pub psnr: Option<f64>,
    /// SSIM.
    pub ssim: Option<f64>,
    /// LPIPS-VGG.
    pub lpips: Option<f64>,
    /// Depth AbsRel.
    pub absrel: Option<f64>,
    /// Depth RMSE, metres.
    pub rmse_m: Option<f64>,
    /// Depth delta1 as a fraction in 0..=1.
    pub delta1: Option<f64>,
    /// AbsRel after per-image median scaling (diagnostic).
    pub absrel_scaled: Option<f64>,
    /// AbsRel on reference depths between 1.5 and 5 m.
    pub far_absrel: Option<f64>,
    /// Pixels of depth support.
    pub support_n: u64,
}

/// Robot displacement error of one (anchor, query) pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackScore {
    /// Anchor clip frame.
    pub anchor: FrameIndex,
    /// Query clip frame.
    pub frame: FrameIndex,
    /// End-point error of displacements, millimetres.
    pub epe_mm: Option<f64>,
    /// Tracks it was pooled over.
    pub n_tracks: u64,
}

/// Robot depth error of one query time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotDepthScore {
    /// Query clip frame.
    pub frame: FrameIndex,
    /// Mean absolute depth error on the robot core, millimetres.
    pub robot_depth_mm: Option<f64>,
    /// Pixels of the core.
    pub core_n: u64,
}

/// One render kept for people to look at; scores are computed on the unquantised render.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderedView {
    /// Camera id.
    pub camera: String,
    /// Clip frame.
    pub frame: FrameIndex,
    /// Height, pixels.
    pub height: u32,
    /// Width, pixels.
    pub width: u32,
    /// RGB, 8 bit. `[H, W, 3]`
    pub rgb: Vec<u8>,
    /// Expected camera-z depth, metres, 0 where nothing was hit. `[H, W]`
    pub depth_m: Vec<f32>,
}

impl Scores {
    /// The arrays agree with the counts, and every number is possible.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        for own in &self.summary.cross_view {
            ensure((0.0..=1.0).contains(&own.shown), || {
                format!(
                    "camera `{}` at frame {}: a share of {}",
                    own.camera, own.frame, own.shown
                )
            })?;
        }
        for view in &self.renders {
            let area = area(view.height, view.width)?;
            let here = |what: String| format!("render of `{}` at frame {}: {what}", view.camera, view.frame);
            count("rgb", view.rgb.len(), 3 * area).map_err(here)?;
            count("depth", view.depth_m.len(), area).map_err(here)?;
        }
        Ok(())
    }
}
