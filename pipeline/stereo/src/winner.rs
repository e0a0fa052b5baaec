//! The disparity of every pixel of both eyes from the sums.

use std::ops::Range as Places;

use rayon::prelude::*;
use rogs_kernels::vectorised;

use crate::cost::UNITS;
use crate::params::{MatcherParams, Range};

/// What the sums say before anything is checked.
pub(crate) struct Winners {
    /// Disparities of the left eye, pixels, NaN where none is unique. `[H, W]`
    pub(crate) left: Vec<f32>,
    /// Disparities of the right eye, pixels, NaN where none is unique. `[H, W]`
    pub(crate) right: Vec<f32>,
    /// By how many bits the left winner's own cost lies below the mean of all candidates: what the image itself says,
    /// without its neighbours. 0 where there is no winner. `[H, W]`
    pub(crate) evidence: Vec<f32>,
}

/// The winners of a volume of sums and its costs.
pub(crate) fn winners(sums: &[i16], costs: &[u8], width: usize, range: Range, params: &MatcherParams) -> Winners {
    let stride = range.stride();
    let area = sums.len() / stride;
    let mut out = Winners {
        left: vec![f32::NAN; area],
        right: vec![f32::NAN; area],
        evidence: vec![0.0; area],
    };
    let rows = out
        .left
        .par_chunks_mut(width)
        .zip(out.right.par_chunks_mut(width))
        .zip(out.evidence.par_chunks_mut(width));
    let volumes = sums.par_chunks(width * stride).zip(costs.par_chunks(width * stride));
    rows.zip(volumes)
        .for_each(|(((left, right), evidence), (sums, costs))| {
            left_row(sums, costs, range, params, left, evidence);
            right_row(sums, range, params, right);
        });
    out
}

fn left_row(sums: &[i16], costs: &[u8], range: Range, params: &MatcherParams, left: &mut [f32], evidence: &mut [f32]) {
    let (width, stride) = (left.len(), range.stride());
    let uniqueness = i32::from(params.uniqueness_percent);
    let mut scratch = vec![0i16; range.count];
    vectorised(
        #[inline(always)]
        || {
            for (column, out) in left.iter_mut().enumerate() {
                let places = inside(column as i64 - i64::from(range.first), -1, width, range.count);
                let sums = &sums[column * stride..][places.clone()];
                let Some((place, fraction)) = winner(sums, &mut scratch[..sums.len()], uniqueness) else {
                    continue;
                };
                *out = (range.first + (places.start + place) as i32) as f32 + fraction;
                let costs = &costs[column * stride..][places];
                let all: u32 = costs.iter().map(|&cost| u32::from(cost)).sum();
                evidence[column] = (all as f32 / costs.len() as f32 - f32::from(costs[place])) / f32::from(UNITS);
            }
        },
    );
}

fn right_row(sums: &[i16], range: Range, params: &MatcherParams, right: &mut [f32]) {
    let (width, stride) = (right.len(), range.stride());
    let uniqueness = i32::from(params.uniqueness_percent);
    let (mut line, mut scratch) = (vec![0i16; range.count], vec![0i16; range.count]);
    vectorised(
        #[inline(always)]
        || {
            for (column, out) in right.iter_mut().enumerate() {
                let first = column as i64 + i64::from(range.first);
                let places = inside(first, 1, width, range.count);
                let line = &mut line[..places.len()];
                for (out, place) in line.iter_mut().zip(places.clone()) {
                    *out = sums[(first + place as i64) as usize * stride + place];
                }
                if let Some((place, fraction)) = winner(line, &mut scratch[..line.len()], uniqueness) {
                    *out = (range.first + (places.start + place) as i32) as f32 + fraction;
                }
            }
        },
    );
}

/// The places `i` of `0..count` for which the column `from + step i` of the other eye exists; `step` is 1 or -1.
#[inline(always)]
fn inside(from: i64, step: i64, width: usize, count: usize) -> Places<usize> {
    let (width, count) = (width as i64, count as i64);
    let (begin, end) = if step > 0 {
        (-from, width - from)
    } else {
        (from - (width - 1), from + 1)
    };
    let begin = begin.clamp(0, count);
    begin as usize..end.clamp(begin, count) as usize
}

/// The place of the least sum with its fraction; none where the least is at an end, or another place that is no neighbour
/// comes near it.
#[inline(always)]
fn winner(sums: &[i16], scratch: &mut [i16], uniqueness: i32) -> Option<(usize, f32)> {
    let least = sums.iter().fold(i16::MAX, |least, &sum| least.min(sum));
    let place = sums.iter().position(|&sum| sum == least)?;
    if place == 0 || place + 1 >= sums.len() {
        return None;
    }
    scratch.copy_from_slice(sums);
    scratch[place - 1..=place + 1].fill(i16::MAX);
    let second = scratch.iter().fold(i16::MAX, |least, &sum| least.min(sum));
    if i32::from(second) * (100 - uniqueness) <= i32::from(least) * 100 {
        return None;
    }
    Some((place, fraction(sums[place - 1], least, sums[place + 1])))
}

/// How far the minimum lies from the middle of three sums: two lines of opposite slope through them, because a count of
/// differing bits grows with the distance, not with its square. In -0.5..=0.5
#[inline(always)]
fn fraction(before: i16, least: i16, after: i16) -> f32 {
    let (before, after) = (f32::from(before - least), f32::from(after - least));
    let steepest = before.max(after);
    if steepest > 0.0 {
        0.5 * (before - after) / steepest
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fraction_lies_towards_the_lower_neighbour() {
        assert_eq!(fraction(30, 10, 30), 0.0);
        assert_eq!(fraction(30, 10, 10), 0.5);
        assert_eq!(fraction(10, 10, 30), -0.5);
        assert_eq!(fraction(20, 10, 30), -0.25);
        assert_eq!(fraction(10, 10, 10), 0.0);
    }

    #[test]
    fn a_minimum_at_an_end_or_beside_another_is_none() {
        let mut scratch = [0; 6];
        assert_eq!(winner(&[1, 9, 9, 9, 9, 9], &mut scratch, 5), None);
        assert_eq!(winner(&[9, 9, 1, 9, 9, 1], &mut scratch, 5), None);
        assert_eq!(winner(&[9, 9, 2, 9, 9, 9], &mut scratch, 5), Some((2, 0.0)));
        assert_eq!(winner(&[], &mut [], 5), None);
    }

    #[test]
    fn places_are_those_with_a_partner() {
        // Left column 3 of 8 with disparities from -1: right columns 4, 3, 2, 1, 0 exist.
        assert_eq!(inside(4, -1, 8, 16), 0..5);
        // Left column 7, disparities from -1: right column 8 does not exist.
        assert_eq!(inside(8, -1, 8, 16), 1..9);
        // Right column 6, disparities from -1: left columns 5, 6, 7.
        assert_eq!(inside(5, 1, 8, 16), 0..3);
        assert_eq!(inside(-1, 1, 8, 16), 1..9);
    }
}
