//! Semi-global aggregation: costs summed along eight paths to every pixel, each the cheapest way there under penalties on
//! steps of disparity. Integers throughout, so that the order of sums and the number of threads do not matter.

use rayon::prelude::*;
use rogs_kernels::vectorised;

use crate::cost::UNITS;
use crate::image::Grey;
use crate::params::{MatcherParams, Range};

/// More than any path costs, with room for a penalty on top.
const NEVER: i16 = 16_000;
/// Columns that one thread takes at a time.
const COLUMNS: usize = 96;
/// Grey step at which the penalty of large steps is half of what it is without an edge.
const EDGE: i32 = 16;
/// Directions of a sweep over the rows: from the row before, one column left, the same, one column right.
const DIRECTIONS: usize = 3;

/// Penalties of a pair.
#[derive(Debug, Clone, Copy)]
struct Penalties {
    small: i16,
    large: i16,
}

impl Penalties {
    /// The penalty of a large step between two pixels: less across an edge of the image.
    fn large(self, a: u8, b: u8) -> i16 {
        let step = (i32::from(a) - i32::from(b)).abs();
        let reduced = i32::from(self.large) * EDGE / (EDGE + step);
        (reduced as i16).max(self.small)
    }
}

/// The sums of all pixels. `[H, W, stride]`
pub(crate) fn aggregate(image: &Grey, costs: &[u8], range: Range, params: &MatcherParams) -> Vec<i16> {
    let penalties = Penalties {
        small: i16::from(UNITS) * params.small_step as i16,
        large: i16::from(UNITS) * params.large_step as i16,
    };
    let mut sums = vec![0i16; costs.len()];
    along_rows(image, costs, &mut sums, range.stride(), penalties);
    over_rows(image, costs, &mut sums, range.stride(), penalties, false);
    over_rows(image, costs, &mut sums, range.stride(), penalties, true);
    sums
}

/// The two paths along every row.
fn along_rows(image: &Grey, costs: &[u8], sums: &mut [i16], stride: usize, penalties: Penalties) {
    let width = image.width();
    let rows = sums
        .par_chunks_mut(width * stride)
        .zip(costs.par_chunks(width * stride));
    rows.enumerate().for_each(|(row, (sums, costs))| {
        let grey = image.row(row);
        for backwards in [false, true] {
            let (mut before, mut here) = (vec![NEVER; stride + 2], vec![NEVER; stride + 2]);
            let mut least = 0;
            vectorised(
                #[inline(always)]
                || {
                    for step in 0..width {
                        let (column, last) = if backwards {
                            (width - 1 - step, width - step)
                        } else {
                            (step, step.wrapping_sub(1))
                        };
                        let costs = &costs[column * stride..][..stride];
                        let sums = &mut sums[column * stride..][..stride];
                        least = if step == 0 {
                            begin(costs, &mut here, sums)
                        } else {
                            let large = penalties.large(grey[column], grey[last]);
                            advance(costs, &before, least, penalties.small, large, &mut here, sums)
                        };
                        std::mem::swap(&mut before, &mut here);
                    }
                },
            );
        }
    });
}

/// The three paths that come from the row above, or from the row below where `upwards`.
fn over_rows(image: &Grey, costs: &[u8], sums: &mut [i16], stride: usize, penalties: Penalties, upwards: bool) {
    let (width, height) = (image.width(), image.height());
    let place = DIRECTIONS * (stride + 2);
    let (mut before, mut here) = (vec![NEVER; width * place], vec![NEVER; width * place]);
    let (mut least_before, mut least_here) = (vec![0i16; width * DIRECTIONS], vec![0i16; width * DIRECTIONS]);
    for step in 0..height {
        let row = if upwards { height - 1 - step } else { step };
        let grey = image.row(row);
        let last = (step > 0).then(|| image.row(if upwards { row + 1 } else { row - 1 }));
        let costs = &costs[row * width * stride..][..width * stride];
        let sums = &mut sums[row * width * stride..][..width * stride];
        let pieces = here
            .par_chunks_mut(COLUMNS * place)
            .zip(least_here.par_chunks_mut(COLUMNS * DIRECTIONS))
            .zip(sums.par_chunks_mut(COLUMNS * stride))
            .zip(costs.par_chunks(COLUMNS * stride));
        pieces
            .enumerate()
            .for_each(|(piece, (((here, least_here), sums), costs))| {
                vectorised(
                    #[inline(always)]
                    || {
                        let pixels = here
                            .chunks_exact_mut(place)
                            .zip(least_here.chunks_exact_mut(DIRECTIONS))
                            .zip(sums.chunks_exact_mut(stride).zip(costs.chunks_exact(stride)));
                        for (column, ((here, least_here), (sums, costs))) in pieces_at(piece).zip(pixels) {
                            if let Some(last) = last.filter(|_| column > 0 && column + 1 < width) {
                                // All three at once: costs and sums are fetched once.
                                let from = column - 1;
                                let before = &before[from * place..][..DIRECTIONS * place];
                                let own = stride + 2;
                                let paths = [0, 1, 2].map(|direction| Path {
                                    before: &before[direction * place + direction * own..][..own],
                                    least: least_before[(from + direction) * DIRECTIONS + direction],
                                    large: penalties.large(grey[column], last[from + direction]),
                                });
                                let (first, rest) = here.split_at_mut(own);
                                let (second, third) = rest.split_at_mut(own);
                                let least = advance_all(costs, paths, penalties.small, first, second, third, sums);
                                least_here.copy_from_slice(&least);
                                continue;
                            }
                            for direction in 0..DIRECTIONS {
                                let here = &mut here[direction * (stride + 2)..][..stride + 2];
                                // Column 0 has no column to its left: it wraps beyond the width.
                                let from = (column + direction).wrapping_sub(1);
                                least_here[direction] = match last.and_then(|last| last.get(from)) {
                                    None => begin(costs, here, sums),
                                    Some(&other) => {
                                        let at = from * place + direction * (stride + 2);
                                        let large = penalties.large(grey[column], other);
                                        let least = least_before[from * DIRECTIONS + direction];
                                        let before = &before[at..][..stride + 2];
                                        advance(costs, before, least, penalties.small, large, here, sums)
                                    }
                                };
                            }
                        }
                    },
                );
            });
        std::mem::swap(&mut before, &mut here);
        std::mem::swap(&mut least_before, &mut least_here);
    }
}

/// What a path brings to its next pixel.
#[derive(Clone, Copy)]
struct Path<'a> {
    /// Its values at the pixel before.
    before: &'a [i16],
    /// The least of them.
    least: i16,
    /// The penalty of a large step from there.
    large: i16,
}

/// The columns of a piece.
#[inline(always)]
fn pieces_at(piece: usize) -> std::ops::RangeFrom<usize> {
    piece * COLUMNS..
}

/// The first pixel of a path: its own costs. Returns the least of them.
#[inline(always)]
fn begin(costs: &[u8], here: &mut [i16], sums: &mut [i16]) -> i16 {
    let inner = here.len() - 1;
    let mut least = NEVER;
    for ((here, sum), &cost) in here[1..inner].iter_mut().zip(sums).zip(costs) {
        *here = i16::from(cost);
        *sum += i16::from(cost);
        least = least.min(i16::from(cost));
    }
    least
}

/// The next pixel of a path: `C(d) + min(L(d), L(d - 1) + P1, L(d + 1) + P1, min L + P2) - min L`. Returns the least value.
/// `before` and `here` have one place beyond either end that no path takes.
#[inline(always)]
fn advance(
    costs: &[u8],
    before: &[i16],
    least_before: i16,
    small: i16,
    large: i16,
    here: &mut [i16],
    sums: &mut [i16],
) -> i16 {
    let count = costs.len();
    let (lower, same, upper) = (&before[..count], &before[1..=count], &before[2..count + 2]);
    let (here, sums) = (&mut here[1..=count], &mut sums[..count]);
    let jump = least_before + large;
    let mut least = NEVER;
    for at in 0..count {
        let step = lower[at].min(upper[at]) + small;
        let value = i16::from(costs[at]) + same[at].min(step).min(jump) - least_before;
        here[at] = value;
        sums[at] += value;
        least = least.min(value);
    }
    least
}

/// [`advance`] of three paths at once.
#[inline(always)]
fn advance_all(
    costs: &[u8],
    paths: [Path<'_>; DIRECTIONS],
    small: i16,
    first: &mut [i16],
    second: &mut [i16],
    third: &mut [i16],
    sums: &mut [i16],
) -> [i16; DIRECTIONS] {
    let count = costs.len();
    let [a, b, c] = paths;
    let (a_lower, a_same, a_upper) = (&a.before[..count], &a.before[1..=count], &a.before[2..count + 2]);
    let (b_lower, b_same, b_upper) = (&b.before[..count], &b.before[1..=count], &b.before[2..count + 2]);
    let (c_lower, c_same, c_upper) = (&c.before[..count], &c.before[1..=count], &c.before[2..count + 2]);
    let (first, second, third) = (&mut first[1..=count], &mut second[1..=count], &mut third[1..=count]);
    let sums = &mut sums[..count];
    let jumps = [a, b, c].map(|path| path.least + path.large);
    let mut least = [NEVER; DIRECTIONS];
    for at in 0..count {
        let cost = i16::from(costs[at]);
        let one = cost + a_same[at].min(a_lower[at].min(a_upper[at]) + small).min(jumps[0]) - a.least;
        let two = cost + b_same[at].min(b_lower[at].min(b_upper[at]) + small).min(jumps[1]) - b.least;
        let three = cost + c_same[at].min(c_lower[at].min(c_upper[at]) + small).min(jumps[2]) - c.least;
        (first[at], second[at], third[at]) = (one, two, three);
        sums[at] += one + two + three;
        least = [least[0].min(one), least[1].min(two), least[2].min(three)];
    }
    least
}
