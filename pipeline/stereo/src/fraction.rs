//! Fractions of disparities from the costs themselves. The sums would do for whole pixels only: their penalties on steps pull
//! every fraction towards 0.

use rayon::prelude::*;

use crate::params::Range;

/// Pixels on either side of the window that costs are added over.
const RADIUS: usize = 4;

/// Adds to every whole left disparity its fraction, from the costs at it and its neighbours, added over those pixels of the
/// window that lie within a pixel of it. `[H, W]`
pub(crate) fn refined(whole: &[f32], costs: &[u8], width: usize, range: Range) -> Vec<f32> {
    let (height, stride) = (whole.len() / width, range.stride());
    let mut out = whole.to_vec();
    out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
        let rows = row.saturating_sub(RADIUS)..(row + RADIUS + 1).min(height);
        for (column, out) in out.iter_mut().enumerate() {
            let disparity = *out;
            if disparity.is_nan() {
                continue;
            }
            // A winner has two neighbours.
            let place = (disparity - range.disparity(0)) as usize;
            let columns = column.saturating_sub(RADIUS)..(column + RADIUS + 1).min(width);
            let mut sums = [0u32; 3];
            for row in rows.clone() {
                for column in columns.clone() {
                    let at = row * width + column;
                    if (whole[at] - disparity).abs() <= 1.0 {
                        let costs = &costs[at * stride + place - 1..][..3];
                        sums.iter_mut()
                            .zip(costs)
                            .for_each(|(sum, &cost)| *sum += u32::from(cost));
                    }
                }
            }
            *out += fraction(sums);
        }
    });
    out
}

/// How far the minimum lies from the middle of three values: two lines of opposite slope through them, because a count of
/// differing bits grows with the distance, not with its square. In -0.5..=0.5
fn fraction([before, middle, after]: [u32; 3]) -> f32 {
    let [before, middle, after] = [before as f32, middle as f32, after as f32];
    let steepest = before.max(after) - middle;
    if steepest > 0.0 {
        (0.5 * (before - after) / steepest).clamp(-0.5, 0.5)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fraction_lies_towards_the_lower_neighbour() {
        assert_eq!(fraction([30, 10, 30]), 0.0);
        assert_eq!(fraction([30, 10, 10]), 0.5);
        assert_eq!(fraction([10, 10, 30]), -0.5);
        assert_eq!(fraction([20, 10, 30]), -0.25);
        assert_eq!(fraction([10, 10, 10]), 0.0);
        assert_eq!(
            fraction([5, 10, 30]),
            -0.5,
            "the winner of the sums is no minimum of the costs"
        );
    }
}
