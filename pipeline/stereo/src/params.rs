//! Settings of the matcher.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::rig::Rig;

/// Most disparities that are compared: the volumes of an image grow with it.
pub const MAX_DISPARITIES: usize = 512;

/// How a pair is matched (`docs/spec/references.md` section 1). The defaults are for images as a clip has them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MatcherParams {
    /// Nearest depth that is searched, metres.
    pub near_m: f64,
    /// Farthest depth that is searched, metres.
    pub far_m: f64,
    /// Most disparities that are searched; where the nearest depth asks for more, nearer surfaces stay unknown.
    pub max_disparities: u32,
    /// Penalty of a step of one pixel between neighbours, in bits of the census.
    pub small_step: u16,
    /// Penalty of a larger step where the image has no edge, in bits of the census.
    pub large_step: u16,
    /// By how much per cent the second best disparity must cost more.
    pub uniqueness_percent: u16,
    /// Largest difference between the two eyes' disparities of one surface, pixels.
    pub left_right_px: f32,
    /// How many bits of the census must speak for a disparity against the mean of all candidates, on average over a window;
    /// what has less is unknown.
    pub evidence_bits: f32,
    /// Smallest patch of like disparity that is kept, pixels.
    pub speckle_px: u32,
}

impl Default for MatcherParams {
    fn default() -> Self {
        Self {
            near_m: 0.1,
            far_m: 20.0,
            max_disparities: 256,
            small_step: 30,
            large_step: 200,
            uniqueness_percent: 8,
            left_right_px: 1.0,
            evidence_bits: 2.0,
            speckle_px: 120,
        }
    }
}

impl MatcherParams {
    /// What is wrong with the numbers, if anything.
    ///
    /// # Errors
    /// When one of them means nothing.
    pub fn check(&self) -> Result<()> {
        let wrong = |what: String| Err(Error::Setting { what });
        if !(self.far_m.is_finite() && 0.0 < self.near_m && self.near_m < self.far_m) {
            return wrong(format!(
                "invalid depths `near_m` {} and `far_m` {}: expected metres above 0, ascending",
                self.near_m, self.far_m
            ));
        }
        if !(16..=MAX_DISPARITIES as u32).contains(&self.max_disparities) {
            return wrong(format!(
                "invalid `max_disparities` {}: expected 16 to {MAX_DISPARITIES}",
                self.max_disparities
            ));
        }
        if self.small_step > self.large_step || self.large_step > 1000 {
            return wrong(format!(
                "invalid steps {} and {}: expected `small_step` up to `large_step`, and that up to 1000",
                self.small_step, self.large_step
            ));
        }
        if self.uniqueness_percent >= 100 {
            return wrong(format!(
                "invalid `uniqueness_percent` {}: expected less than 100",
                self.uniqueness_percent
            ));
        }
        if !(self.evidence_bits.is_finite() && self.evidence_bits >= 0.0) {
            return wrong(format!(
                "invalid `evidence_bits` {}: expected bits, 0 or more",
                self.evidence_bits
            ));
        }
        if !(self.left_right_px.is_finite() && self.left_right_px >= 0.0) {
            return wrong(format!(
                "invalid `left_right_px` {}: expected pixels, 0 or more",
                self.left_right_px
            ));
        }
        Ok(())
    }
}

/// The disparities that are compared: `first..first + count`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Range {
    pub(crate) first: i32,
    pub(crate) count: usize,
}

impl Range {
    /// From the farthest depth to the nearest, with one beyond either end: a winner has two neighbours.
    pub(crate) fn new(rig: &Rig, params: &MatcherParams, width: usize) -> Self {
        let first = rig.disparity_px(params.far_m).floor() as i32 - 1;
        let last = rig.disparity_px(params.near_m).ceil().min(width as f64) as i32 + 1;
        let count = (last - first + 1).clamp(4, params.max_disparities as i32);
        Self {
            first,
            count: count as usize,
        }
    }

    /// The disparity of a place, pixels.
    pub(crate) fn disparity(self, place: usize) -> f32 {
        (self.first + place as i32) as f32
    }

    /// The places of a left column whose right column `column - first - i` exists.
    #[inline(always)]
    pub(crate) fn candidates(self, column: usize, width: usize) -> std::ops::Range<usize> {
        let place = column as i64 - i64::from(self.first);
        places(place - (width as i64 - 1), place + 1, self.count)
    }

    /// The number of places in a volume: rounded up, so that vectors are full.
    pub(crate) fn stride(self) -> usize {
        self.count.next_multiple_of(LANES)
    }
}

/// The part of `begin..end` that lies in `0..count`.
#[inline(always)]
pub(crate) fn places(begin: i64, end: i64, count: usize) -> std::ops::Range<usize> {
    let begin = begin.clamp(0, count as i64);
    begin as usize..end.clamp(begin, count as i64) as usize
}

/// Values of 16 bits in the widest vector.
const LANES: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn candidates_are_those_with_a_partner() {
        let range = Range { first: -1, count: 16 };
        // Left column 3 of 8 with disparities from -1: right columns 4, 3, 2, 1, 0 exist.
        assert_eq!(range.candidates(3, 8), 0..5);
        // Left column 7: right column 8 does not exist.
        assert_eq!(range.candidates(7, 8), 1..9);
        assert_eq!(Range { first: 40, count: 16 }.candidates(3, 8), 0..0);
    }

    #[test]
    fn the_range_spans_the_depths() {
        let rig = Rig {
            focal_px: 100.0,
            baseline_m: 0.1,
            shift_px: 2.5,
        };
        let range = Range::new(&rig, &MatcherParams::default(), 280);
        assert_eq!(
            (range.first, range.count, range.stride()),
            (2, 103, 128),
            "3 to 102.5 pixels"
        );
        let few = MatcherParams {
            max_disparities: 32,
            ..MatcherParams::default()
        };
        assert_eq!(Range::new(&rig, &few, 280).count, 32);
    }
}
