//! What encoder and aggregator hand to the heads.

use burn::tensor::Tensor;

use super::stem::StemFeatures;

/// What the heads read: the standardised patch tokens of the tapped pairs.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// Per tap, before the affine map of a head's norm. `4 x [S, N, 2C]`
    pub taps: [Tensor<3>; 4],
    /// What the stem says, in a network that has one and for heads that read it.
    pub local: Option<StemFeatures>,
    /// Patch grid, rows and columns.
    pub grid: [usize; 2],
    /// Image height and width.
    pub size: [usize; 2],
}

impl Encoded {
    /// Number of frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.taps[0].dims()[0]
    }

    /// The taps of some frames; heads give the same result however frames are split.
    #[must_use]
    pub fn frames_at(&self, start: usize, count: usize) -> Self {
        Self {
            taps: self.taps.clone().map(|tap| tap.narrow(0, start, count)),
            local: self.local.as_ref().map(|local| local.frames_at(start, count)),
            ..*self
        }
    }
}
