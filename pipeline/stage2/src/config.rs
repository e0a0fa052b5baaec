//! Sizes of the Stage-2 network. One code path serves every configuration.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Sizes of the refiner.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefinerConfig {
    /// Name for provenance: `paper`, `cpu`, `ci`, or anything else for other sizes.
    pub name: String,
    /// Width S of the hidden state and of the updater.
    pub state: usize,
    /// Number of neighbour-attention blocks.
    pub blocks: usize,
    /// Width of queries, keys and values in a block.
    pub attention: usize,
    /// Channels of the ResNet's stem and first layer, and of its second layer. ResNet-18 has 64 and 128.
    pub feature_widths: [usize; 2],
    /// Neighbours K of a token, itself included.
    pub neighbours: usize,
    /// A token stands for `token_block x token_block` source pixels. The paper has 1.
    pub token_block: usize,
    /// Recurrent updates at inference, unless a run asks for another number.
    pub updates: u32,
}

impl RefinerConfig {
    /// Names of the presets.
    pub const PRESETS: [&'static str; 3] = ["paper", "cpu", "ci"];

    /// A preset by name (`docs/spec/stage2.md` section C.3).
    ///
    /// # Errors
    /// When there is no such preset.
    pub fn preset(name: &str) -> Result<Self> {
        let (state, blocks, attention, feature_widths, token_block, updates) = match name {
            "paper" => (512, 4, 64, [64, 128], 1, 4),
            "cpu" => (128, 4, 32, [64, 128], 2, 2),
            "ci" => (32, 2, 16, [8, 16], 1, 2),
            _ => {
                let known = Self::PRESETS.join(", ");
                return Err(Error::BadConfiguration(format!(
                    "there is no Stage-2 preset `{name}`; there are {known}"
                )));
            }
        };
        Ok(Self {
            name: name.to_owned(),
            state,
            blocks,
            attention,
            feature_widths,
            neighbours: 8,
            token_block,
            updates,
        })
    }

    /// Channels F of the concatenated feature maps and of the error features.
    #[must_use]
    pub fn features(&self) -> usize {
        2 * self.feature_widths[0] + self.feature_widths[1]
    }

    /// Residual channels of one token: 59 per Gaussian of its block.
    #[must_use]
    pub fn residuals(&self) -> usize {
        rogs_schemas::records::refinement::RESIDUAL_CHANNELS * self.token_block * self.token_block
    }

    /// Channels of the updater's input: attributes, state, feedback.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.residuals() + self.state + self.features()
    }

    /// Refuses sizes that no network can have.
    ///
    /// # Errors
    /// Naming the size that is wrong.
    pub fn validate(&self) -> Result<()> {
        let sizes = [
            ("state", self.state, 4096),
            ("blocks", self.blocks, 64),
            ("attention", self.attention, 4096),
            ("feature_widths", self.feature_widths[0], 4096),
            ("feature_widths", self.feature_widths[1], 4096),
            ("neighbours", self.neighbours, 256),
            ("token_block", self.token_block, 8),
        ];
        for (name, value, limit) in sizes {
            if !(1..=limit).contains(&value) {
                return Err(Error::BadConfiguration(format!(
                    "`{name}` must be between 1 and {limit}: {value}"
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
    fn presets_have_the_sizes_of_the_reference() {
        let paper = RefinerConfig::preset("paper").unwrap();
        assert_eq!((paper.features(), paper.inputs(), paper.residuals()), (256, 827, 59));
        let cpu = RefinerConfig::preset("cpu").unwrap();
        assert_eq!(
            (cpu.features(), cpu.inputs(), cpu.residuals()),
            (256, 4 * 59 + 128 + 256, 236)
        );
        assert_eq!(RefinerConfig::preset("ci").unwrap().features(), 32);
        assert!(
            RefinerConfig::preset("huge")
                .unwrap_err()
                .to_string()
                .contains("paper, cpu, ci")
        );
        assert!(RefinerConfig { neighbours: 0, ..paper }.validate().is_err());
    }
}
