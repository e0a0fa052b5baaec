//! Parameters of the stage.

use rogs_schemas::Device;
use rogs_schemas::records::refinement::ScaleResidual;
use rogs_stage2::RefinerConfig;
use rogs_weights::Unfiled;
use rogs_worker::{StageError, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bundled::BUILTIN;

/// Most updates a run may ask for; training uses 1 to 4.
pub const MOST_UPDATES: u32 = 64;

/// Parameters of the refinement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RefineParams {
    /// Network preset: `paper`, `cpu` or `ci`. A weights file must be of the same preset.
    pub preset: String,
    /// Number of recurrent updates; null means the preset's (paper 4, cpu 2, ci 2). 0 gives exactly the Stage-1 field.
    pub updates: Option<u32>,
    /// Keep the correction after every update, not only after the last.
    pub keep_intermediate: bool,
    /// Keep the hidden state, so that a later run can resume after the last update.
    pub keep_state: bool,
    /// Smallest contribution mass of a Gaussian that is corrected, in pixels of full contribution.
    pub epsilon: f32,
    /// How scale residuals are added.
    pub scale_residual: ScaleResidual,
    /// Search neighbours at the corrected centres of each update instead of the Stage-1 centres.
    pub recompute_knn: bool,
    /// Seed of seeded weights.
    pub seed: u64,
    /// Where the updater runs: `cpu`, or `gpu` where the program was built with the feature `gpu`.
    pub device: Device,
    /// The network where no weights file is given: `builtin` (also null), or `seeded`, which corrects nothing.
    #[serde(deserialize_with = "unfiled", skip_serializing_if = "Option::is_none")]
    pub weights: Option<Unfiled>,
}

fn unfiled<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Option<Unfiled>, D::Error> {
    Unfiled::read(deserializer, BUILTIN.hash())
}

impl Default for RefineParams {
    fn default() -> Self {
        Self {
            preset: "ci".into(),
            updates: None,
            keep_intermediate: false,
            keep_state: false,
            epsilon: 1e-3,
            scale_residual: ScaleResidual::PreActivation,
            recompute_knn: false,
            seed: 0,
            device: Device::Cpu,
            weights: None,
        }
    }
}

impl RefineParams {
    /// The network's sizes and the number of updates.
    ///
    /// # Errors
    /// When the preset is unknown or a number is out of range.
    pub fn resolve(&self) -> StageResult<(RefinerConfig, u32)> {
        let config = RefinerConfig::preset(&self.preset).map_err(|error| StageError::bad_params(error.to_string()))?;
        let updates = self.updates.unwrap_or(config.updates);
        if updates > MOST_UPDATES {
            return Err(StageError::bad_params(format!(
                "`updates` must be at most {MOST_UPDATES}: {updates}"
            )));
        }
        if !(self.epsilon.is_finite() && self.epsilon >= 0.0) {
            return Err(StageError::bad_params(format!(
                "`epsilon` must be a number of pixels, not negative: {}",
                self.epsilon
            )));
        }
        Ok((config, updates))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn null_updates_mean_those_of_the_preset() {
        for (preset, expected) in [("ci", 2), ("cpu", 2), ("paper", 4)] {
            let params = RefineParams {
                preset: preset.into(),
                ..RefineParams::default()
            };
            assert_eq!(params.resolve().unwrap().1, expected);
        }
        let wrong = RefineParams {
            preset: "big".into(),
            ..RefineParams::default()
        };
        assert!(wrong.resolve().unwrap_err().message.contains("paper, cpu, ci"));
        let on = |device| RefineParams {
            device,
            ..RefineParams::default()
        };
        assert!(on(Device::Gpu).resolve().is_ok());
        if cfg!(not(feature = "gpu")) {
            let error = crate::load_refiner(&on(Device::Gpu), None).err().unwrap();
            assert!(error.message.contains("feature `gpu`"), "{}", error.message);
        }
        assert!(
            RefineParams {
                updates: Some(65),
                ..RefineParams::default()
            }
            .resolve()
            .is_err()
        );
        assert!(
            RefineParams {
                epsilon: f32::NAN,
                ..RefineParams::default()
            }
            .resolve()
            .is_err()
        );
    }
}
