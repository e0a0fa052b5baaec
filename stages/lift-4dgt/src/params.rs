//! Parameters of the stage; the defaults are the paper's setting of 4DGT.

use std::borrow::Cow;

use rogs_schemas::Device;
use rogs_weights::SEEDED;
use rogs_worker::{StageError, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Patch side of the network, pixels.
const PATCH: u32 = rogs_4dgt::config::PATCH as u32;
/// Largest side of the network's images, pixels.
const MOST_PIXELS: u32 = 4096;

/// What determines a field besides its inputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Lift4dgtParams {
    /// Which frames of a camera the network sees.
    pub frames: InputFrames,
    /// Height of its images, pixels; a multiple of 14.
    pub height: u32,
    /// Width of its images, pixels; a multiple of 14.
    pub width: u32,
    /// Sizes of seeded networks; released weights bring their own.
    pub configuration: Configuration,
    /// Seed of seeded weights.
    pub seed: u64,
    /// Where the network runs: `cpu`, or `gpu` where the program was built with the feature `gpu`.
    pub device: Device,
    /// The network where no file is given: `seeded`, random values. There is none in the program.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<OnlySeeded>,
    /// Its image encoder where no file is given: `seeded`, random values.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder: Option<OnlySeeded>,
}

/// Which frames of a camera the network sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum InputFrames {
    /// All of the clip (17).
    All,
    /// Those at the source times (5).
    Source,
}

/// Sizes of seeded networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Configuration {
    /// The released sizes: 404 million parameters and a ViT-B.
    Full,
    /// A few million parameters, to try the way through.
    Compact,
}

/// Random values, asked for by the word `seeded`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OnlySeeded;

impl<'de> Deserialize<'de> for OnlySeeded {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = Cow::<'de, str>::deserialize(deserializer)?;
        match &*text {
            SEEDED => Ok(Self),
            _ => Err(serde::de::Error::custom(format!(
                "there are no `{text}` weights of 4DGT: it runs with the released files, under [weights] 4dgt = \"FILE\" and \
                 dinov2 = \"FILE\" (docs/baselines.md), or with random values where both say \"{SEEDED}\""
            ))),
        }
    }
}

impl Serialize for OnlySeeded {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(SEEDED)
    }
}

impl JsonSchema for OnlySeeded {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "OnlySeeded".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "string", "enum": [SEEDED] })
    }
}

impl Default for Lift4dgtParams {
    fn default() -> Self {
        Self {
            frames: InputFrames::All,
            height: 182,
            width: 322,
            configuration: Configuration::Full,
            seed: 73,
            device: Device::Cpu,
            weights: None,
            encoder: None,
        }
    }
}

impl Lift4dgtParams {
    /// Checks the values.
    ///
    /// # Errors
    /// The first that is not possible.
    pub fn validate(&self) -> StageResult<()> {
        for (name, side) in [("height", self.height), ("width", self.width)] {
            if side == 0 || side > MOST_PIXELS || !side.is_multiple_of(PATCH) {
                return Err(StageError::bad_params(format!(
                    "invalid `{name}` {side}: expected a multiple of {PATCH} pixels up to {MOST_PIXELS}, e.g. 182"
                )));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_files_or_asked_for_as_random() {
        let parse = |text: &str| rogs_worker::parse_params::<Lift4dgtParams>(&serde_json::json!({"weights": text}));
        assert_eq!(parse("seeded").unwrap().weights, Some(OnlySeeded));
        let error = parse("builtin").unwrap_err().message;
        assert!(error.contains("there are no `builtin` weights of 4DGT"), "{error}");
        let odd = Lift4dgtParams {
            height: 180,
            ..Lift4dgtParams::default()
        };
        assert!(odd.validate().unwrap_err().message.contains("multiple of 14"));
    }
}
