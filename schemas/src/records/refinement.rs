//! The Stage-2 correction: time-shared residuals of a field, and nothing else.

use serde::{Deserialize, Serialize};

use super::check::{Check, binary, count, ensure, nonzero};
use super::field::{NamedArray, WeightsInfo, check_arrays};
use crate::ids::ClipId;
use crate::key::CacheKey;

/// Residual channels per Gaussian: position 3, scale 3, rotation 4, opacity 1, SH 48 (16 of R, then G, then B).
pub const RESIDUAL_CHANNELS: usize = 59;

/// How the scale residual of a Gaussian is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScaleResidual {
    /// Added to the pre-activation of Stage 1: `min(0.3, 0.001 softplus(raw + residual))`, internal units.
    #[default]
    PreActivation,
    /// Added to the standard deviation: `max(1e-6, scale + residual)`, internal units.
    Linear,
}

/// Written by `refine`. It holds no displacement: displacements stay those of the field, bit for bit, because the
/// corrected centre at time t is `(position_m + delta) + displacement_m(t)` (paper, equations 8 and 9).
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The clip this belongs to.
    pub clip_id: ClipId,
    /// Key of the field file that it corrects.
    pub field_key: CacheKey,
    /// Number of Gaussians of that field.
    pub gaussian_count: u64,
    /// Number of updates of the last step (0 means: the field itself).
    pub updates: u32,
    /// Preset name: `paper`, `cpu`, `ci`.
    pub preset: String,
    /// What the weights were that made it.
    pub weights: WeightsInfo,
    /// How the scale residuals are meant.
    pub scale_residual: ScaleResidual,
    /// Accumulated corrections after some updates, ascending; the last is the result, the others are kept on request.
    pub steps: Vec<RefinementStep>,
    /// The hidden state after the last step, from which another run can continue; empty when it was not kept.
    pub resume_state: Vec<NamedArray>,
}

/// Accumulated corrections after `update` updates.
#[derive(Debug, Clone, PartialEq)]
pub struct RefinementStep {
    /// Number of updates applied.
    pub update: u32,
    /// 1 for Gaussians that have a correction. `[N]`
    pub touched: Vec<u8>,
    /// Corrections of the touched Gaussians in index order: position in METRES (bounded by 0.05 m), the others in the
    /// Stage-1 pre-activation parameterisation (`docs/spec/stage2.md` section B.2). `[M, RESIDUAL_CHANNELS]`
    pub values: Vec<f32>,
}

impl Refinement {
    /// The correction is one of the field whose file has this key; another field of as many Gaussians is not its own.
    ///
    /// # Errors
    /// That it corrects another field, in words.
    pub fn check_corrects(&self, field: CacheKey) -> Check {
        ensure(self.field_key == field, || {
            format!("the refinement corrects field {}, not {field}", self.field_key)
        })
    }

    /// The arrays agree with the counts, and every number is possible.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        ensure(self.steps.is_sorted_by(|a, b| a.update < b.update), || {
            "steps do not ascend".into()
        })?;
        ensure(self.steps.last().is_none_or(|last| last.update == self.updates), || {
            format!("the last step is not update {}", self.updates)
        })?;
        for step in &self.steps {
            let here = |what: String| format!("update {}: {what}", step.update);
            ensure(step.touched.len() as u64 == self.gaussian_count, || {
                here(format!(
                    "{} flags for {} Gaussians",
                    step.touched.len(),
                    self.gaussian_count
                ))
            })?;
            binary("touched", &step.touched).map_err(here)?;
            count(
                "corrections",
                step.values.len(),
                RESIDUAL_CHANNELS * nonzero(&step.touched),
            )
            .map_err(here)?;
        }
        check_arrays(&self.resume_state)
    }
}
