//! Sizes of the Stage-1 network. One code path serves every configuration.

use rogs_vit::{EncoderSizes, PositionGrid};
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Side of the cells that a level of the stem sees as one pixel.
pub const CELL: usize = 2;
/// Prefix of every tensor of the released network.
pub const PREFIX: &str = "backbone";

/// Special tokens in front of the patches of a frame in the aggregator: time, pose, camera.
const LEADING_TOKENS: usize = 3;

/// Channels of the attribute heads: colour 3, scale 3, rotation 4, opacity 1, confidence 1.
pub const SPLAT_CHANNELS: usize = 12;
/// Numbers of the pose token: translation 3, quaternion 4, fields of view 2.
pub const POSE_NUMBERS: usize = 9;
/// Mean of the RGB normalisation in front of the image encoder.
pub const RGB_MEAN: [f32; 3] = [0.485, 0.456, 0.406];
/// Standard deviation of the RGB normalisation in front of the image encoder.
pub const RGB_STD: [f32; 3] = [0.229, 0.224, 0.225];

/// Sizes of the network (`docs/spec/stage1.md` sections 3 to 6).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage1Config {
    /// Name: `full`, `compact`, or one of your own.
    pub name: String,
    /// Token width C.
    pub width: usize,
    /// Attention heads; the head size `width / heads` is a multiple of 4.
    pub heads: usize,
    /// Patch side, pixels.
    pub patch: usize,
    /// Blocks of the image encoder.
    pub encoder_blocks: usize,
    /// Side of the square grid of learned encoder positions.
    pub position_grid: usize,
    /// Register tokens, in the encoder and in the aggregator.
    pub registers: usize,
    /// Pairs of a frame and a global block.
    pub pairs: usize,
    /// The pairs whose outputs the dense heads read, ascending.
    pub taps: [usize; 4],
    /// Channels of the four levels of a dense head before fusion.
    pub head_channels: [usize; 4],
    /// Channels of a dense head during fusion (even).
    pub head_features: usize,
    /// Channels between the last two convolutions of a dense head and of its shortcut.
    pub head_hidden: usize,
    /// Sine and cosine pairs of the time encoding.
    pub time_frequencies: usize,
    /// Hidden channels of the FK-conditioning branch.
    pub fk_hidden: usize,
    /// Channels of the four levels of the convolutional stem ([`super::stem`]); 0 for a network without one, as the released
    /// one.
    #[serde(default)]
    pub stem_channels: [usize; 4],
    /// Depths at which the stem compares a frame with other cameras ([`super::stem`]); 0 for a network that does not, as the
    /// released one.
    #[serde(default)]
    pub sweep_depths: usize,
    /// Nearest and farthest depth of the sweep, millimetres.
    #[serde(default = "first_range", skip_serializing_if = "is_first_range")]
    pub sweep_range_mm: [u32; 2],
    /// Most frames of other times that the sweep compares a frame with ([`super::sweep`]); 0 for one that compares frames
    /// of one moment only.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub sweep_other_times: usize,
}

/// The range of sweeps whose checkpoints name none.
const FIRST_RANGE_MM: [u32; 2] = [100, 4000];

const fn first_range() -> [u32; 2] {
    FIRST_RANGE_MM
}

fn is_first_range(range: &[u32; 2]) -> bool {
    *range == FIRST_RANGE_MM
}

const fn is_zero(count: &usize) -> bool {
    *count == 0
}

impl Stage1Config {
    /// The released network: 1,041,147,254 parameters (without the FK branch and LoRA).
    #[must_use]
    pub fn full() -> Self {
        Self {
            name: "full".into(),
            width: 1024,
            heads: 16,
            patch: 14,
            encoder_blocks: 24,
            position_grid: 37,
            registers: 4,
            pairs: 24,
            taps: [4, 11, 17, 23],
            head_channels: [256, 512, 1024, 1024],
            head_features: 256,
            head_hidden: 32,
            time_frequencies: 10,
            fk_hidden: 32,
            stem_channels: [0; 4],
            sweep_depths: 0,
            sweep_range_mm: FIRST_RANGE_MM,
            sweep_other_times: 0,
        }
    }

    /// The same architecture at laptop size, with a stem.
    #[must_use]
    pub fn compact() -> Self {
        Self {
            name: "compact".into(),
            width: 192,
            heads: 3,
            patch: 14,
            encoder_blocks: 2,
            position_grid: 20,
            registers: 4,
            pairs: 4,
            taps: [0, 1, 2, 3],
            head_channels: [24, 48, 96, 96],
            head_features: 32,
            head_hidden: 16,
            time_frequencies: 10,
            fk_hidden: 16,
            stem_channels: [32, 48, 64, 96],
            sweep_depths: 0,
            sweep_range_mm: FIRST_RANGE_MM,
            sweep_other_times: 0,
        }
    }

    /// `compact` with a plane sweep in its stem.
    #[must_use]
    pub fn compact_sweep() -> Self {
        Self {
            name: "compact-sweep".into(),
            sweep_depths: 64,
            ..Self::compact()
        }
    }

    /// `compact-sweep` whose sweep reaches through a room and compares frames of other times too.
    #[must_use]
    pub fn compact_wide() -> Self {
        Self {
            name: "compact-wide".into(),
            sweep_range_mm: [100, 8000],
            sweep_other_times: 4,
            ..Self::compact_sweep()
        }
    }

    /// The configuration of that name.
    ///
    /// # Errors
    /// When there is none.
    pub fn by_name(name: &str) -> Result<Self> {
        match name {
            "full" => Ok(Self::full()),
            "compact" => Ok(Self::compact()),
            "compact-sweep" => Ok(Self::compact_sweep()),
            "compact-wide" => Ok(Self::compact_wide()),
            _ => Err(Error::BadConfiguration(format!(
                "unknown configuration `{name}`: expected `full`, `compact`, `compact-sweep` or `compact-wide`"
            ))),
        }
    }

    /// Checks that the sizes fit together.
    ///
    /// # Errors
    /// Names the size that does not.
    pub fn validate(&self) -> Result<()> {
        let fail = |reason: String| Err(Error::BadConfiguration(reason));
        let sizes = [
            self.width,
            self.heads,
            self.patch,
            self.position_grid,
            self.pairs,
            self.head_features,
        ];
        if sizes.contains(&0) || self.head_hidden == 0 || self.time_frequencies == 0 || self.fk_hidden == 0 {
            return fail("a size is 0".into());
        }
        if sizes.iter().any(|&size| size > 1 << 14) || self.encoder_blocks > 1 << 10 {
            return fail("a size is larger than any network this program can run".into());
        }
        let stem = self.stem_channels;
        if self.has_stem() && (stem.contains(&0) || stem.iter().any(|&channels| channels > 1 << 10)) {
            return fail(format!("a stem of {stem:?} channels: all are 0, or all from 1 to 1024"));
        }
        let depths = self.sweep_depths;
        if depths > 1 << 10 || (depths > 0 && !self.has_stem()) {
            return fail(format!(
                "a sweep of {depths} depths: it needs a stem, and at most 1024 of them"
            ));
        }
        let [near, far] = self.sweep_range_mm;
        if near == 0 || near >= far {
            return fail(format!("a sweep from {near} to {far} mm: it goes from near to far"));
        }
        if self.sweep_other_times > 1 << 6 || (self.sweep_other_times > 0 && depths == 0) {
            let frames = self.sweep_other_times;
            return fail(format!(
                "a sweep over {frames} frames of other times: it needs depths, and at most 64 of them"
            ));
        }
        if self.has_stem() && !self.patch.is_multiple_of(CELL) {
            let patch = self.patch;
            return fail(format!("a stem needs patches of an even side, not {patch}"));
        }
        if !self.width.is_multiple_of(self.heads) || !(self.width / self.heads).is_multiple_of(4) {
            let (width, heads) = (self.width, self.heads);
            return fail(format!(
                "width {width} does not split into {heads} heads of a multiple of 4 channels"
            ));
        }
        if self.taps.windows(2).any(|pair| pair[0] >= pair[1]) || self.taps[3] >= self.pairs {
            return fail(format!(
                "taps {:?} are not ascending indices below {}",
                self.taps, self.pairs
            ));
        }
        if self
            .head_channels
            .iter()
            .any(|&channels| channels == 0 || channels % 4 != 0)
            || !self.head_features.is_multiple_of(8)
        {
            return fail("head channels must be multiples of 4 and head features of 8".into());
        }
        Ok(())
    }

    /// Whether the network has a convolutional stem.
    #[must_use]
    pub fn has_stem(&self) -> bool {
        self.stem_channels != [0; 4]
    }

    /// Channels of one attention head.
    #[must_use]
    pub fn head_size(&self) -> usize {
        self.width / self.heads
    }

    /// Index of the first patch token of a frame in the aggregator (7 with four registers).
    #[must_use]
    pub fn patch_start(&self) -> usize {
        LEADING_TOKENS + self.registers
    }

    /// Numbers of the time encoding.
    #[must_use]
    pub fn time_numbers(&self) -> usize {
        2 * self.time_frequencies
    }

    /// Patch grid (rows, columns) of an image.
    ///
    /// # Errors
    /// When the image is not a whole number of patches.
    pub fn grid(&self, height: usize, width: usize) -> Result<[usize; 2]> {
        self.encoder().grid(height, width)
    }

    /// Sizes of the image encoder.
    #[must_use]
    pub fn encoder(&self) -> EncoderSizes {
        EncoderSizes {
            width: self.width,
            heads: self.heads,
            patch: self.patch,
            blocks: self.encoder_blocks,
            position_grid: self.position_grid,
            registers: self.registers,
            positions: PositionGrid::Antialiased,
        }
    }
}

/// One of the four dense heads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeadKind {
    /// Depth and its confidence, once per clip.
    Depth,
    /// Base attributes, once per clip, with the RGB shortcut.
    Splat,
    /// Displacement at a query time.
    Motion,
    /// Attributes at a query time, with a shortcut from the base attributes.
    MotionSplat,
}

impl HeadKind {
    /// All heads in the order of the checkpoint.
    pub const ALL: [Self; 4] = [Self::Depth, Self::Splat, Self::Motion, Self::MotionSplat];

    /// Name in the checkpoint.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth_head",
            Self::Splat => "splat_head",
            Self::Motion => "motion_head",
            Self::MotionSplat => "motion_splat_head",
        }
    }

    /// Output channels, confidence last.
    #[must_use]
    pub fn channels(self) -> usize {
        match self {
            Self::Depth => 2,
            Self::Motion => 4,
            Self::Splat | Self::MotionSplat => SPLAT_CHANNELS,
        }
    }

    /// Channels of the full-resolution shortcut input, if there is one.
    #[must_use]
    pub fn shortcut_channels(self) -> Option<usize> {
        match self {
            Self::Splat => Some(3),
            Self::MotionSplat => Some(SPLAT_CHANNELS - 1),
            Self::Depth | Self::Motion => None,
        }
    }

    /// Whether the head reads the features of the stem, in a network that has one. Those asked at any later time do not, so
    /// that a field need not keep images.
    #[must_use]
    pub fn reads_stem(self) -> bool {
        !self.timed()
    }

    /// Whether the head is modulated by a query time.
    #[must_use]
    pub fn timed(self) -> bool {
        matches!(self, Self::Motion | Self::MotionSplat)
    }
}
