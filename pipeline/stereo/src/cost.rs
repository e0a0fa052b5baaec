//! Matching cost: how many bits of the census of a left pixel and of a right one differ, averaged over small windows.

use rayon::prelude::*;
use rogs_kernels::vectorised;

use crate::image::Grey;
use crate::params::Range;

/// Rows and columns of the census window on either side of its centre.
const RADIUS: [usize; 2] = [3, 4];
/// Bits of a census: pixels of the window without its centre.
const BITS: u8 = 62;
/// Steps of the smoothed costs in a bit.
pub(crate) const UNITS: u8 = 2;
/// Pixels of the window that costs are averaged over.
const WINDOW: u16 = 9;
/// Cost of a candidate that lies outside the right image, and of places that only fill vectors.
const OUTSIDE: u8 = BITS;
const FILL: u8 = u8::MAX;

/// Which pixels of the window around each pixel are darker than it, one bit each; the image is continued by its border.
/// `[H, W]`
fn census(image: &Grey) -> Vec<u64> {
    let (width, height) = (image.width(), image.height());
    let [up, across] = RADIUS;
    let padded_width = width + 2 * across;
    let padded: Vec<u8> = (0..height + 2 * up)
        .flat_map(|row| {
            let row = image.row(row.saturating_sub(up).min(height - 1));
            (0..padded_width).map(move |column| row[column.saturating_sub(across).min(width - 1)])
        })
        .collect();
    let mut out = vec![0u64; width * height];
    out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
        let centre = &padded[(row + up) * padded_width + across..][..width];
        vectorised(
            #[inline(always)]
            || {
                for dy in 0..=2 * up {
                    for dx in 0..=2 * across {
                        if (dy, dx) == (up, across) {
                            continue;
                        }
                        let other = &padded[(row + dy) * padded_width + dx..][..width];
                        for ((out, &other), &centre) in out.iter_mut().zip(other).zip(centre) {
                            *out = *out << 1 | u64::from(other < centre);
                        }
                    }
                }
            },
        );
    });
    out
}

/// The costs of all pixels of the left image, averaged over their 3x3 windows, in [`UNITS`] of a bit. `[H, W, stride]`
pub(crate) fn volume(left: &Grey, right: &Grey, range: Range) -> Vec<u8> {
    let width = left.width();
    smoothed(&differences(&census(left), &census(right), width, range), width, range)
}

/// How many bits differ, for all pixels of the left image. `[H, W, stride]`
fn differences(left: &[u64], right: &[u64], width: usize, range: Range) -> Vec<u8> {
    let stride = range.stride();
    let mut out = vec![FILL; left.len() * stride];
    out.par_chunks_mut(width * stride).enumerate().for_each(|(row, out)| {
        let left = &left[row * width..(row + 1) * width];
        // Backwards, so that larger disparities follow each other.
        let backwards: Vec<u64> = right[row * width..(row + 1) * width].iter().rev().copied().collect();
        vectorised(
            #[inline(always)]
            || {
                for (column, (&left, out)) in left.iter().zip(out.chunks_exact_mut(stride)).enumerate() {
                    let out = &mut out[..range.count];
                    out.fill(OUTSIDE);
                    let places = range.candidates(column, width);
                    // Disparity `first + i` is the right column `column - first - i`.
                    let at = width as i64 - 1 - column as i64 + i64::from(range.first) + places.start as i64;
                    let right = &backwards[at.clamp(0, width as i64) as usize..][..places.len()];
                    for (out, &right) in out[places].iter_mut().zip(right) {
                        *out = (left ^ right).count_ones() as u8;
                    }
                }
            },
        );
    });
    out
}

/// The means over the 3x3 windows of all pixels, in [`UNITS`]; the image is continued by its border. `[H, W, stride]`
fn smoothed(costs: &[u8], width: usize, range: Range) -> Vec<u8> {
    let line = width * range.stride();
    let height = costs.len() / line;
    let stride = range.stride();
    let mut out = vec![FILL; costs.len()];
    out.par_chunks_mut(line).enumerate().for_each(|(row, out)| {
        let row_of = |row: usize| &costs[row * line..][..line];
        let rows = [
            row_of(row.saturating_sub(1)),
            row_of(row),
            row_of((row + 1).min(height - 1)),
        ];
        let mut sums = vec![0u16; line];
        vectorised(
            #[inline(always)]
            || {
                let [above, here, below] = rows;
                for ((sum, &above), (&here, &below)) in sums.iter_mut().zip(above).zip(here.iter().zip(below)) {
                    *sum = u16::from(above) + u16::from(here) + u16::from(below);
                }
                for (column, out) in out.chunks_exact_mut(stride).enumerate() {
                    let of = |column: usize| &sums[column * stride..][..range.count];
                    let (left, here, right) = (
                        of(column.saturating_sub(1)),
                        of(column),
                        of((column + 1).min(width - 1)),
                    );
                    for ((out, &left), (&here, &right)) in out.iter_mut().zip(left).zip(here.iter().zip(right)) {
                        *out = (((left + here + right) * u16::from(UNITS) + WINDOW / 2) / WINDOW) as u8;
                    }
                }
            },
        );
    });
    out
}
