//! Parameters of the stage.

use rogs_worker::{StageError, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Most updates a run may ask for.
const MOST_UPDATES: u32 = 100_000;
/// Most rigid motions.
const MOST_BASES: u32 = 64;

/// Parameters of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FitParams {
    /// Updates; each takes all source cameras of one source time. 0 gives the field as the fit starts from it.
    pub updates: u32,
    /// The field that it starts from: `refined`, with the corrections of Stage 2, or `lifted`, that of Stage 1.
    pub start: StartFrom,
    /// Where the displacements of robot Gaussians come from: `field` keeps those of the field bit for bit, `kinematics`
    /// takes those of their links.
    pub robot: RobotMotion,
    /// A Gaussian beside the robot that the field moves less than this belongs to the background, which does not move,
    /// metres.
    pub static_below_m: f64,
    /// Rigid motions of what else moves.
    pub bases: u32,
    /// Learning rates at the start; they fall to a tenth.
    pub rates: Rates,
    /// Pull towards the start per update, as a share of the learning rate of each group; holds what no image speaks of.
    pub hold: f64,
    /// Weight of coverage: how much of the background is seen through the field from a camera beside a source camera, where
    /// no image was taken.
    pub coverage: f64,
    /// How far beside, at most, metres.
    pub beside_m: f64,
    /// Weight of the reference depth of the source views, disparity in 1/m; 0 leaves it unseen.
    pub depth: f64,
    /// Seed of the order of source times.
    pub seed: u64,
}

/// The field that a fit starts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StartFrom {
    /// Stage 1 with the corrections of Stage 2.
    #[default]
    Refined,
    /// Stage 1.
    Lifted,
}

/// Where the displacements of robot Gaussians come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RobotMotion {
    /// The field's, bit for bit.
    #[default]
    Field,
    /// Those of the robot's links: rigid, and exact for exact states.
    Kinematics,
}

/// Learning rates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Rates {
    /// Centres, metres.
    pub position_m: f64,
    /// Natural logarithms of scales.
    pub scale: f64,
    /// Components of quaternions.
    pub rotation: f64,
    /// Raw opacities.
    pub opacity: f64,
    /// Raw colours.
    pub colour: f64,
    /// Logits of the mixture of rigid motions.
    pub mixture: f64,
    /// Rigid motions: the six numbers of rotations, and translations in internal units.
    pub motion: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Self {
            position_m: 2e-3,
            scale: 5e-3,
            rotation: 2e-3,
            opacity: 1e-2,
            colour: 1e-2,
            mixture: 1e-2,
            motion: 5e-4,
        }
    }
}

impl Default for FitParams {
    fn default() -> Self {
        Self {
            updates: 100,
            start: StartFrom::Refined,
            robot: RobotMotion::Field,
            static_below_m: 0.0014,
            bases: 4,
            rates: Rates::default(),
            hold: 0.0,
            coverage: 1.0,
            beside_m: 0.12,
            depth: 0.0,
            seed: 0,
        }
    }
}

impl FitParams {
    /// Refuses numbers out of range.
    ///
    /// # Errors
    /// Names the parameter.
    pub fn check(&self) -> StageResult<()> {
        let positive = |name: &str, value: f64| {
            if value.is_finite() && value >= 0.0 {
                return Ok(());
            }
            Err(StageError::bad_params(format!(
                "`{name}` must be a number, not negative: {value}"
            )))
        };
        if self.updates > MOST_UPDATES {
            return Err(StageError::bad_params(format!(
                "`updates` must be at most {MOST_UPDATES}: {}",
                self.updates
            )));
        }
        if !(1..=MOST_BASES).contains(&self.bases) {
            return Err(StageError::bad_params(format!(
                "`bases` must be 1 to {MOST_BASES}: {}",
                self.bases
            )));
        }
        positive("static_below_m", self.static_below_m)?;
        positive("hold", self.hold)?;
        positive("coverage", self.coverage)?;
        positive("beside_m", self.beside_m)?;
        positive("depth", self.depth)?;
        let rates = &self.rates;
        for (name, rate) in [
            ("position_m", rates.position_m),
            ("scale", rates.scale),
            ("rotation", rates.rotation),
            ("opacity", rates.opacity),
            ("colour", rates.colour),
            ("mixture", rates.mixture),
            ("motion", rates.motion),
        ] {
            positive(&format!("rates.{name}"), rate)?;
        }
        Ok(())
    }
}
