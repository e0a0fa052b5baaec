//! Sizes of the network. One code path serves every configuration.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Patch side, pixels.
pub const PATCH: usize = 14;
/// Channels of a pixel that the network sees: RGB, time, Plücker coordinates.
pub const INPUTS: usize = 10;
/// The heads in their order, with their channels.
pub const HEADS: [(&str, usize); 9] = [
    ("depth", 1),
    ("opacity", 1),
    ("scale", 3),
    ("rotation", 4),
    ("dxyzt", 4),
    ("ms3", 16),
    ("cov_t", 1),
    ("omega", 8),
    ("rgb", 4),
];

/// Sizes (`docs/spec/baseline-4dgt.md` sections 3 to 5).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FourDgtConfig {
    /// Name: `full`, or one of your own.
    pub name: String,
    /// Token width.
    pub width: usize,
    /// Blocks.
    pub blocks: usize,
    /// Attention heads.
    pub heads: usize,
    /// Hidden channels of a head per channel of its output.
    pub head_hidden: usize,
    /// Channels of the image encoder's tokens.
    pub encoder_width: usize,
}

impl FourDgtConfig {
    /// The released first-stage network: 404,459,776 parameters.
    #[must_use]
    pub fn full() -> Self {
        Self {
            name: "full".into(),
            width: 1536,
            blocks: 12,
            heads: 16,
            head_hidden: 256,
            encoder_width: 768,
        }
    }

    /// Numbers of a patch before the projection, those of the image encoder among them.
    #[must_use]
    pub fn patch_numbers(&self) -> usize {
        INPUTS * PATCH * PATCH + self.encoder_width
    }

    /// Checks that the sizes fit together.
    ///
    /// # Errors
    /// When they do not.
    pub fn validate(&self) -> Result<()> {
        let sizes = [
            self.width,
            self.blocks,
            self.heads,
            self.head_hidden,
            self.encoder_width,
        ];
        if sizes.iter().any(|size| !(1..=1 << 16).contains(size)) || !self.width.is_multiple_of(self.heads) {
            return Err(Error::BadConfiguration(format!(
                "4DGT needs sizes from 1 to 65536 and a width that its heads divide, not {self:?}"
            )));
        }
        Ok(())
    }
}
