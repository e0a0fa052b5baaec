//! The disparity of every pixel of both eyes from the sums.

use rayon::prelude::*;
use rogs_kernels::vectorised;

use crate::cost::UNITS;
use crate::params::{MatcherParams, Range, places};

/// Candidates on either side of a winner that its cost is compared with, without its neighbours.
const AROUND: usize = 4;

/// What the sums say before anything is checked.
pub(crate) struct Winners {
    /// Whole disparities of the left eye, pixels, NaN where none is unique. `[H, W]`
    pub(crate) left: Vec<f32>,
    /// The same of the right eye, of the same sign. `[H, W]`
    pub(crate) right: Vec<f32>,
    /// By how many bits the left winner's own cost lies below the mean of the candidates around it: what the images say
    /// themselves. 0 where there is no winner. `[H, W]`
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
                let places = range.candidates(column, width);
                let sums = &sums[column * stride..][places.clone()];
                if let Some(place) = winner(sums, &mut scratch[..sums.len()], uniqueness) {
                    *out = range.disparity(places.start + place);
                    evidence[column] = lead(&costs[column * stride..][places], place);
                }
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
                // Place `i` of right column `x` is that of left column `x + first + i`.
                let first = column as i64 + i64::from(range.first);
                let places = places(-first, width as i64 - first, range.count);
                let line = &mut line[..places.len()];
                for (out, place) in line.iter_mut().zip(places.clone()) {
                    *out = sums[(first + place as i64) as usize * stride + place];
                }
                if let Some(place) = winner(line, &mut scratch[..line.len()], uniqueness) {
                    *out = range.disparity(places.start + place);
                }
            }
        },
    );
}

/// The place of the least sum; none where the least is at an end, or another place that is no neighbour comes near it.
#[inline(always)]
fn winner(sums: &[i16], scratch: &mut [i16], uniqueness: i32) -> Option<usize> {
    let least = sums.iter().fold(i16::MAX, |least, &sum| least.min(sum));
    let place = first(sums, least)?;
    if place == 0 || place + 1 >= sums.len() {
        return None;
    }
    scratch.copy_from_slice(sums);
    scratch[place - 1..=place + 1].fill(i16::MAX);
    let second = scratch.iter().fold(i16::MAX, |least, &sum| least.min(sum));
    (i32::from(second) * (100 - uniqueness) > i32::from(least) * 100).then_some(place)
}

/// The first place of a value. Vectors are compared at once, so that the branch comes once a vector.
#[inline(always)]
fn first(sums: &[i16], value: i16) -> Option<usize> {
    const VECTOR: usize = 32;
    let has = |part: &[i16]| part.iter().fold(0, |found, &sum| found | i16::from(sum == value)) != 0;
    let (parts, rest) = sums.as_chunks::<VECTOR>();
    let part = parts.iter().position(|part| has(part));
    let (begin, part) = part.map_or((sums.len() - rest.len(), rest), |part| (part * VECTOR, &parts[part]));
    Some(begin + part.iter().position(|&sum| sum == value)?)
}

/// By how many bits the cost at a place lies below the mean of those around it.
#[inline(always)]
fn lead(costs: &[u8], place: usize) -> f32 {
    let below = &costs[place.saturating_sub(AROUND)..place - 1];
    let above = &costs[place + 2..(place + AROUND + 1).min(costs.len())];
    let count = below.len() + above.len();
    if count == 0 {
        return 0.0;
    }
    let sum: u32 = below.iter().chain(above).map(|&cost| u32::from(cost)).sum();
    (sum as f32 / count as f32 - f32::from(costs[place])) / f32::from(UNITS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minimum_at_an_end_or_beside_another_is_none() {
        let mut scratch = [0; 6];
        assert_eq!(winner(&[1, 9, 9, 9, 9, 9], &mut scratch, 5), None);
        assert_eq!(winner(&[9, 9, 1, 9, 9, 1], &mut scratch, 5), None);
        assert_eq!(winner(&[9, 9, 2, 9, 9, 9], &mut scratch, 5), Some(2));
        assert_eq!(winner(&[], &mut [], 5), None);
    }

    #[test]
    fn the_first_place_of_a_value_is_found_in_and_behind_vectors() {
        for count in [1, 31, 32, 33, 70] {
            for place in 0..count {
                let mut sums = vec![5; count];
                sums[place..].fill(2);
                assert_eq!(first(&sums, 2), Some(place), "of {count}");
            }
        }
        assert_eq!(first(&[5; 70], 2), None);
    }

    #[test]
    fn a_flat_line_leads_by_nothing() {
        assert_eq!(lead(&[6; 20], 9), 0.0);
        let mut costs = [20; 20];
        costs[9] = 8;
        assert_eq!(lead(&costs, 9), 6.0, "12 halves of a bit");
        assert_eq!(lead(&[3, 1, 3], 1), 0.0, "nothing to compare with");
    }
}
