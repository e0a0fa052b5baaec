//! From a pair to the disparities of both eyes.

use crate::aggregate::aggregate;
use crate::clean::{confirmed, consistent, remove_specks, remove_unsupported, smoothed};
use crate::cost::volume;
use crate::error::{Error, Result};
use crate::fraction::refined;
use crate::image::Grey;
use crate::params::{MatcherParams, Range};
use crate::rig::Rig;
use crate::winner::winners;

/// What a pair gives: `x_left - x_right` of the surface at every pixel, NaN where it is not known.
#[derive(Debug, Clone, PartialEq)]
pub struct StereoMatch {
    /// Disparities of the left eye, pixels. `[H, W]`
    pub left_px: Vec<f32>,
    /// Disparities of the right eye, pixels, of the same sign. `[H, W]`
    pub right_px: Vec<f32>,
}

impl StereoMatch {
    /// Camera-z depths of the left and of the right eye, metres, NaN where unknown. `[H, W]` each
    #[must_use]
    pub fn depths_m(&self, rig: &Rig) -> [Vec<f32>; 2] {
        [&self.left_px, &self.right_px].map(|disparity| disparity.iter().map(|&value| rig.depth_m(value)).collect())
    }
}

/// Matches a pair whose right eye shows everything `rows_px` rows lower, as [`diagnose`](crate::diagnose) measures it.
///
/// # Errors
/// As [`match_pair`], and when the offset is not finite.
pub fn match_offset_pair(
    left: &Grey,
    right: &Grey,
    rows_px: f32,
    rig: &Rig,
    params: &MatcherParams,
) -> Result<StereoMatch> {
    if !rows_px.is_finite() {
        return Err(Error::Setting {
            what: format!("invalid offset of rows {rows_px}: expected pixels"),
        });
    }
    let mut found = match_pair(left, &right.begun_at_row(rows_px), rig, params)?;
    // Back to the rows of the right eye, the nearest ones.
    let (width, rows) = (right.width(), rows_px.round() as i64);
    let moved = |row: i64| {
        let from = usize::try_from(row - rows).ok().filter(|&from| from < right.height());
        let row = from.map(|from| &found.right_px[from * width..(from + 1) * width]);
        row.map_or_else(|| vec![f32::NAN; width], <[f32]>::to_vec)
    };
    found.right_px = (0..right.height() as i64).flat_map(moved).collect();
    Ok(found)
}

/// Matches a rectified pair (`docs/spec/references.md` section 1). The result does not depend on the number of threads.
///
/// # Errors
/// When the images differ in size or a setting means nothing.
pub fn match_pair(left: &Grey, right: &Grey, rig: &Rig, params: &MatcherParams) -> Result<StereoMatch> {
    params.check()?;
    let size = |image: &Grey| [image.width(), image.height()];
    if size(left) != size(right) {
        return Err(Error::Sizes {
            left: size(left),
            right: size(right),
        });
    }
    let width = left.width();
    let range = Range::new(rig, params, width);
    let costs = volume(left, right, range);
    let found = {
        let sums = aggregate(left, &costs, range, params);
        winners(&sums, &costs, width, range, params)
    };
    let tolerance = params.left_right_px;
    let mut left_px = consistent(&found.left, &found.right, width, tolerance);
    remove_unsupported(&mut left_px, &found.evidence, width, params.evidence_bits);
    let mut left_px = refined(&left_px, &costs, width, range);
    drop(costs);
    let mut right_px = confirmed(&found.right, &left_px, width, tolerance);
    let farthest = rig.disparity_px(params.far_m) as f32;
    for disparity in [&mut left_px, &mut right_px] {
        let beyond = disparity.iter_mut().filter(|value| **value < farthest);
        beyond.for_each(|value| *value = f32::NAN);
        remove_specks(disparity, width, params.speckle_px as usize);
        *disparity = smoothed(disparity, width);
    }
    Ok(StereoMatch { left_px, right_px })
}
