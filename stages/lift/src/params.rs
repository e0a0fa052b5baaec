//! Parameters of the stage; the defaults are the paper's method.

use rogs_field::gates::{MOTION_GATE_IU, MotionGates};
use rogs_schemas::{Device, FrameIndex};
use rogs_stage1::Precision;
use rogs_weights::Unfiled;
use rogs_worker::{StageError, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bundled::builtin_hash;

/// What determines a field besides its inputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LiftParams {
    /// Sizes of seeded networks: `compact`, `compact-sweep`, `compact-wide` or `full`. Trained weights bring their own.
    pub configuration: String,
    /// Seed of seeded weights.
    pub seed: u64,
    /// Mesh source anchoring: source depth of robot pixels is the mesh depth.
    pub anchoring: bool,
    /// Largest activated scale of an anchored Gaussian in source pixels at its depth; null for no cap. Without anchoring
    /// there is none.
    pub footprint_px: Option<f32>,
    /// FK conditioning: the residual branch sees the conditioning maps; otherwise it sees zeros.
    pub fk_conditioning: bool,
    /// What the global blocks attend to.
    pub attention: CrossCamera,
    /// Where the motion of robot pixels comes from.
    pub robot_motion: RobotMotion,
    /// Displacement from which colour, scale and rotation take the query-time value, internal units.
    pub motion_gate_iu: f32,
    /// Displacement from which opacity takes the query-time value, internal units.
    pub opacity_gate_iu: f32,
    /// Area-downsample the source images by this factor and restore their size (1: leave them).
    pub rgb_downsample: u32,
    /// Source times to use, clip frames; null for all of the clip.
    pub source_frames: Option<Vec<FrameIndex>>,
    /// Whether the field keeps what is needed to be asked at other times.
    pub query_state: QueryState,
    /// Precision of the large matrix products of encoder and aggregator.
    pub precision: ProductPrecision,
    /// Where the network runs: `cpu`, or `gpu` where the program was built with the feature `gpu`.
    pub device: Device,
    /// What patch tokens are made from.
    pub tokens: TokenSource,
    /// Pixels per latent that the latents must have (8 or 16); null for what their file says.
    pub latent_stride: Option<u32>,
    /// The network where no weights file is given: `builtin` (also null; one for clips of robots, another for clips in which no
    /// camera sees the robot), or `seeded` for random values.
    #[serde(deserialize_with = "unfiled", skip_serializing_if = "Option::is_none")]
    pub weights: Option<Unfiled>,
}

fn unfiled<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Option<Unfiled>, D::Error> {
    Unfiled::read(deserializer, builtin_hash())
}

/// Precision of large matrix products; sums and everything else are f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ProductPrecision {
    /// f32.
    F32,
    /// Operands rounded to bfloat16: faster on CPUs with AVX512_BF16, the same bits on others, and less exact.
    Bf16,
}

impl From<ProductPrecision> for Precision {
    fn from(numbers: ProductPrecision) -> Self {
        match numbers {
            ProductPrecision::F32 => Self::F32,
            ProductPrecision::Bf16 => Self::Bf16,
        }
    }
}

/// What patch tokens are made from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TokenSource {
    /// The source images.
    Rgb,
    /// Latents of a video tokenizer (input `latents`) through the adapter (input `adapter`). Decoded images are still
    /// needed for the colour shortcut.
    Latents,
}

/// What a token of a global block sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CrossCamera {
    /// Every token of the clip.
    Joint,
    /// Tokens of its own camera; the cameras' fields are merged by calibration.
    WithinCamera,
    /// Every camera is lifted by itself, in a frame and unit of its own with one scale from its stereo depth, and the
    /// cameras' fields are merged by calibration: the camera-wise baseline. Without anchoring and FK conditioning.
    CameraWise,
}

/// Where the motion of robot pixels comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RobotMotion {
    /// The network: visual displacement plus the FK-conditioned residual.
    Network,
    /// Forward kinematics alone (a diagnostic): centres and covariances of robot pixels move with their link.
    Kinematics,
}

/// Whether the field keeps the state of the motion heads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum QueryState {
    /// Where it is small: every configuration but `full`.
    Auto,
    /// Always.
    Keep,
    /// Never.
    Drop,
}

impl Default for LiftParams {
    fn default() -> Self {
        Self {
            configuration: "compact".into(),
            seed: 73,
            anchoring: true,
            footprint_px: Some(1.5),
            fk_conditioning: true,
            attention: CrossCamera::Joint,
            robot_motion: RobotMotion::Network,
            motion_gate_iu: MOTION_GATE_IU,
            opacity_gate_iu: MOTION_GATE_IU,
            rgb_downsample: 1,
            source_frames: None,
            query_state: QueryState::Auto,
            precision: ProductPrecision::F32,
            device: Device::Cpu,
            tokens: TokenSource::Rgb,
            latent_stride: None,
            weights: None,
        }
    }
}

impl LiftParams {
    /// Checks the values.
    ///
    /// # Errors
    /// Names the parameter that is out of range.
    pub fn validate(&self) -> StageResult<()> {
        let threshold = |value: f32| value.is_finite() && value >= 0.0;
        if !threshold(self.motion_gate_iu) || !threshold(self.opacity_gate_iu) {
            return Err(StageError::bad_params(
                "`motion_gate_iu` and `opacity_gate_iu` must be 0 or more",
            ));
        }
        if self
            .footprint_px
            .is_some_and(|pixels| !(pixels.is_finite() && pixels > 0.0))
        {
            return Err(StageError::bad_params("`footprint_px` must be more than 0, or null"));
        }
        if !(1..=64).contains(&self.rgb_downsample) {
            return Err(StageError::bad_params("`rgb_downsample` must be from 1 to 64"));
        }
        if self
            .source_frames
            .as_ref()
            .is_some_and(|frames| frames.is_empty() || frames.windows(2).any(|pair| pair[0] >= pair[1]))
        {
            return Err(StageError::bad_params(
                "`source_frames` must name at least one frame, in ascending order",
            ));
        }
        if self.latent_stride.is_some_and(|stride| ![8, 16].contains(&stride)) {
            return Err(StageError::bad_params("`latent_stride` must be 8 or 16, or null"));
        }
        if self.device != Device::Cpu && self.precision == ProductPrecision::Bf16 {
            return Err(StageError::bad_params(
                "`precision = \"bf16\"` needs the CPU: GPUs are programmed in WGSL here, which has no \
                 bfloat16 numbers",
            )
            .with_hint("leave `precision` at \"f32\", or choose `device = \"cpu\"`"));
        }
        let plain = !self.anchoring
            && !self.fk_conditioning
            && self.robot_motion == RobotMotion::Network
            && self.tokens == TokenSource::Rgb
            && self.query_state != QueryState::Keep;
        if self.attention == CrossCamera::CameraWise && !plain {
            return Err(StageError::bad_params(
                "`attention = \"camera-wise\"` is the baseline without robot knowledge: it needs `anchoring = false`, \
                 `fk_conditioning = false`, `robot_motion = \"network\"`, RGB tokens, and keeps no query state",
            ));
        }
        Ok(())
    }

    /// Whether the built-in network is chosen for each clip: where neither weights nor a configuration are named.
    pub(crate) fn chooses_by_clip(&self) -> bool {
        self.weights != Some(Unfiled::Seeded) && self.configuration == Self::default().configuration
    }

    /// The motion gates.
    #[must_use]
    pub fn gates(&self) -> MotionGates {
        MotionGates {
            attributes_iu: self.motion_gate_iu,
            opacity_iu: self.opacity_gate_iu,
        }
    }

    /// Whether fields of this configuration keep their query state.
    #[must_use]
    pub fn keeps_query_state(&self, configuration: &str) -> bool {
        match self.query_state {
            QueryState::Auto => configuration != "full" && self.attention != CrossCamera::CameraWise,
            QueryState::Keep => true,
            QueryState::Drop => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_one_that_there_is() {
        let on = |device, precision| LiftParams {
            device,
            precision,
            ..LiftParams::default()
        };
        assert!(on(Device::Cpu, ProductPrecision::Bf16).validate().is_ok());
        assert!(on(Device::Gpu, ProductPrecision::F32).validate().is_ok());
        let error = on(Device::Gpu, ProductPrecision::Bf16).validate().unwrap_err();
        assert!(error.message.contains("no bfloat16"), "{}", error.message);
        let error = rogs_worker::parse_params::<LiftParams>(&serde_json::json!({"device": "gup"})).unwrap_err();
        assert!(error.message.contains("did you mean `gpu`?"), "{}", error.message);
        if cfg!(not(feature = "gpu")) {
            let error = crate::load_model(&on(Device::Gpu, ProductPrecision::F32), None)
                .err()
                .unwrap();
            assert!(error.message.contains("feature `gpu`"), "{}", error.message);
        }
    }
}
