//! What is wrong with a pair, read off its images: eyes in the wrong order, rows that do not meet.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::image::Grey;
use crate::params::{MatcherParams, Range};
use crate::rig::Rig;

/// Width and height of the compared block, pixels.
const BLOCK: [usize; 2] = [16, 8];
/// Rows that are searched on either side.
const ROWS: i64 = 6;
/// Blocks along the longer side of the grid.
const GRID: usize = 32;
/// Sum of grey steps, along rows and along columns, that a block needs to be compared.
const TEXTURE: u32 = 6 * (BLOCK[0] * BLOCK[1]) as u32;
/// By how much per cent the second best place must differ more.
const UNIQUENESS_PERCENT: u32 = 25;
/// Fewest matches that say anything.
const FEWEST: usize = 16;
/// Disparities this much below that of infinity lie behind it, pixels.
const BEHIND_PX: f32 = 1.0;
/// Smallest median difference of rows that is told, pixels.
const TOLD_ROWS_PX: f32 = 0.5;

/// What the images of a pair say against its calibration.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Concern {
    /// Most matches lie behind infinity.
    #[error("left and right eyes look swapped: {behind} of {matches} matched blocks have disparities behind infinity")]
    Swapped {
        /// Blocks behind infinity.
        behind: usize,
        /// Blocks that were matched.
        matches: usize,
    },
    /// A surface lies on other rows in the two eyes.
    #[error(
        "the pair is not rectified: rows of the right eye differ from those of the left one by {rows_px:+.1} pixels, down is positive (median of {matches} matched blocks)"
    )]
    Rows {
        /// Median of the difference of rows, right minus left, pixels.
        rows_px: f32,
        /// Blocks that were matched.
        matches: usize,
    },
}

/// A block of the left eye found in the right one.
#[derive(Debug, Clone, Copy)]
struct Found {
    /// `x_left - x_right`, pixels.
    disparity: f32,
    /// `y_right - y_left`, pixels.
    rows: f32,
}

/// Compares some blocks of the left eye with the right one, in all directions, and tells what contradicts a rectified pair.
/// Nothing is said where too few blocks are unmistakable.
///
/// # Errors
/// When the images differ in size or a setting means nothing.
pub fn diagnose(left: &Grey, right: &Grey, rig: &Rig, params: &MatcherParams) -> Result<Vec<Concern>> {
    params.check()?;
    let size = |image: &Grey| [image.width(), image.height()];
    if size(left) != size(right) {
        return Err(Error::Sizes {
            left: size(left),
            right: size(right),
        });
    }
    let range = Range::new(rig, params, left.width());
    let reach = (i64::from(range.first).abs() + range.count as i64).min(left.width() as i64 - 1);
    let found: Vec<Found> = blocks(left)
        .into_par_iter()
        .filter_map(|place| search(left, right, place, reach))
        .collect();
    let mut concerns = Vec::new();
    if found.len() < FEWEST {
        return Ok(concerns);
    }
    let infinity = rig.shift_px as f32;
    let behind = found
        .iter()
        .filter(|found| found.disparity < infinity - BEHIND_PX)
        .count();
    if 2 * behind > found.len() {
        concerns.push(Concern::Swapped {
            behind,
            matches: found.len(),
        });
    }
    let mut rows: Vec<f32> = found.iter().map(|found| found.rows).collect();
    rows.sort_unstable_by(f32::total_cmp);
    let median = rows[rows.len() / 2];
    if median.abs() > TOLD_ROWS_PX {
        concerns.push(Concern::Rows {
            rows_px: median,
            matches: found.len(),
        });
    }
    Ok(concerns)
}

/// Top left corners (column, row) of blocks on a grid that have texture along rows and columns.
fn blocks(image: &Grey) -> Vec<[usize; 2]> {
    let [width, height] = BLOCK;
    let step = (image.width().max(image.height()) / GRID).max(height / 2);
    let last = [
        image.width().saturating_sub(width),
        image.height().saturating_sub(height),
    ];
    let columns = (0..=last[0]).step_by(step);
    let places = columns.flat_map(|column| (0..=last[1]).step_by(step).map(move |row| [column, row]));
    places.filter(|&place| textured(image, place)).collect()
}

fn textured(image: &Grey, [column, row]: [usize; 2]) -> bool {
    let [width, height] = BLOCK;
    if row + height > image.height() || column + width > image.width() {
        return false;
    }
    let line = |row: usize| &image.row(row)[column..column + width];
    let along = |row: usize| -> u32 {
        let steps = line(row).windows(2).map(|pair| u32::from(pair[0].abs_diff(pair[1])));
        steps.sum()
    };
    let across = |row: usize| difference(line(row), line(row + 1));
    let along: u32 = (row..row + height).map(along).sum();
    let across: u32 = (row..row + height - 1).map(across).sum();
    along.min(across) >= TEXTURE
}

/// Sum of absolute differences.
fn difference(a: &[u8], b: &[u8]) -> u32 {
    a.iter().zip(b).map(|(&a, &b)| u32::from(a.abs_diff(b))).sum()
}

/// The place of a block in the right eye, up to `reach` columns and [`ROWS`] rows away; none where another place is as good.
fn search(left: &Grey, right: &Grey, [column, row]: [usize; 2], reach: i64) -> Option<Found> {
    let [width, height] = BLOCK;
    let (columns, rows) = ((2 * reach + 1) as usize, (2 * ROWS + 1) as usize);
    let mut sums = vec![u32::MAX; columns * rows];
    for (index, sum) in sums.iter_mut().enumerate() {
        let (dx, dy) = ((index % columns) as i64 - reach, (index / columns) as i64 - ROWS);
        let (x, y) = (column as i64 + dx, row as i64 + dy);
        let fits = x >= 0 && y >= 0 && x as usize + width <= right.width() && y as usize + height <= right.height();
        if fits {
            let (x, y) = (x as usize, y as usize);
            let line = |at: usize| difference(&left.row(row + at)[column..][..width], &right.row(y + at)[x..][..width]);
            *sum = (0..height).map(line).sum();
        }
    }
    let best = (0..sums.len()).min_by_key(|&index| sums[index])?;
    let (dx, dy) = (best % columns, best / columns);
    let near = |index: usize| (index % columns).abs_diff(dx) <= 2 && (index / columns).abs_diff(dy) <= 2;
    let second = (0..sums.len())
        .filter(|&index| !near(index))
        .map(|index| sums[index])
        .min()?;
    let unique = u64::from(sums[best]) * u64::from(100 + UNIQUENESS_PERCENT) < u64::from(second) * 100;
    if !unique || dy == 0 || dy + 1 == rows {
        return None;
    }
    let [above, here, below] = [best - columns, best, best + columns].map(|index| f64::from(sums[index]));
    // Two lines of opposite slope, as sums of absolute differences have them.
    let steepest = above.max(below) - here;
    let fraction = if steepest > 0.0 {
        (above - below) / (2.0 * steepest)
    } else {
        0.0
    };
    Some(Found {
        disparity: -((dx as i64 - reach) as f32),
        rows: (dy as i64 - ROWS) as f32 + fraction.clamp(-0.5, 0.5) as f32,
    })
}
