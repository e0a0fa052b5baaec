//! The Stage-2 correction: time-shared residuals of a field, and nothing else.

use crate::key::CacheKey;

/// Residual channels per Gaussian: position 3, scale 3, rotation 4, opacity 1, SH 48 (16 of R, then G, then B).
pub const RESIDUAL_CHANNELS: usize = 59;

/// Written by `refine`. It holds no displacement: displacements stay those of the field, bit for bit, because the
/// corrected centre at time t is `(position_m + delta) + displacement_m(t)` (paper, equations 8 and 9).
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The clip this belongs to.
    pub clip_id: String,
    /// Key of the field file that it corrects.
    pub field_key: CacheKey,
    /// Number of Gaussians of that field.
    pub gaussian_count: u64,
    /// Number of updates of the last step (0 means: the field itself).
    pub updates: u32,
    /// Preset name: `paper`, `cpu`, `ci`.
    pub preset: String,
    /// What the weights were that made it.
    pub weights: crate::records::field::WeightsInfo,
    /// Accumulated corrections after some updates, ascending; the last is the result, the others are kept on request.
    pub steps: Vec<RefinementStep>,
}

/// Accumulated corrections after `update` updates.
#[derive(Debug, Clone, PartialEq)]
pub struct RefinementStep {
    /// Number of updates applied.
    pub update: u32,
    /// 1 for Gaussians that have a correction. `[N]`
    pub touched: Vec<u8>,
    /// Corrections of the touched Gaussians in index order: position in METRES (bounded by 0.05 m), the others in the
    /// Stage-1 pre-activation parameterisation (`stage2-network.md` section B.2). `[M, RESIDUAL_CHANNELS]`
    pub values: Vec<f32>,
}
