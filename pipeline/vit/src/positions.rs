//! The learned grid of positions of an image encoder, brought to the grid of an image's patches.

use rogs_kernels::cubic_taps;
use serde::{Deserialize, Serialize};

/// How the learned square grid becomes that of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PositionGrid {
    /// Bicubic (kernel parameter -0.5), stretched where the grid shrinks: DINOv2 with registers, and VGGT.
    Antialiased,
    /// Bicubic (kernel parameter -0.75) without stretching, as if the image had a tenth of a patch more: DINOv2 without
    /// registers.
    Offset,
}

/// What [`PositionGrid::Offset`] adds to the number of patches of an axis.
const OFFSET: f64 = 0.1;

/// Where one output sample of an axis comes from: samples and their weights.
type Taps = Vec<(usize, f32)>;

/// Resamples the learned position embedding of a square grid to `rows x columns`, as a matrix, so that gradients reach the
/// learned grid: `[rows * columns, side^2]`.
#[must_use]
pub fn resampling_matrix(side: usize, [rows, columns]: [usize; 2], how: PositionGrid) -> Vec<f32> {
    let [row_taps, column_taps] = [rows, columns].map(|count| axis(side, count, how));
    let mut matrix = vec![0.0f32; rows * columns * side * side];
    for (row, down) in row_taps.iter().enumerate() {
        for (column, across) in column_taps.iter().enumerate() {
            let out = &mut matrix[(row * columns + column) * side * side..][..side * side];
            for &(i, row_weight) in down {
                for &(j, column_weight) in across {
                    out[i * side + j] += row_weight * column_weight;
                }
            }
        }
    }
    matrix
}

fn axis(side: usize, count: usize, how: PositionGrid) -> Vec<Taps> {
    match how {
        PositionGrid::Antialiased => {
            let taps = cubic_taps::<f32>(side, count, 0, count);
            let listed = taps.iter().map(|one| {
                let places = one.start..one.start + one.weights.len();
                places.zip(one.weights.iter().copied()).collect()
            });
            listed.collect()
        }
        PositionGrid::Offset => (0..count).map(|index| offset_taps(side, count, index)).collect(),
    }
}

/// The four samples around an output sample; those beyond the border are the border's.
fn offset_taps(side: usize, count: usize, index: usize) -> Taps {
    let scale = side as f64 / (count as f64 + OFFSET);
    let place = scale * (index as f64 + 0.5) - 0.5;
    let first = libm::floor(place);
    let t = place - first;
    let last = side as i64 - 1;
    let weights = [cubic(t + 1.0), cubic(t), cubic(1.0 - t), cubic(2.0 - t)];
    let tap = |(step, weight): (i64, f64)| {
        let sample = (first as i64 + step - 1).clamp(0, last);
        (sample as usize, weight as f32)
    };
    (0..).zip(weights).map(tap).collect()
}

/// The cubic convolution kernel with a = -0.75 at a distance of 0 to 2.
fn cubic(distance: f64) -> f64 {
    const A: f64 = -0.75;
    if distance <= 1.0 {
        ((A + 2.0) * distance - (A + 3.0)) * distance * distance + 1.0
    } else {
        ((A * distance - 5.0 * A) * distance + 8.0 * A) * distance - 4.0 * A
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A kernel of parameter a brings a ramp to `x - (1 + 2 a) t (1 - t) (1 - 2 t)` at a place x whose fraction is t.
    #[test]
    fn rows_sum_to_one_and_a_ramp_becomes_what_its_kernel_makes_of_it() {
        let (side, grid) = (37, [13, 23]);
        for how in [PositionGrid::Antialiased, PositionGrid::Offset] {
            let matrix = resampling_matrix(side, grid, how);
            let value = |row: &[f32]| -> f64 {
                row.iter()
                    .enumerate()
                    .map(|(k, &w)| f64::from(w) * (k / side) as f64)
                    .sum()
            };
            for (index, row) in matrix.chunks_exact(side * side).enumerate() {
                let sum: f64 = row.iter().map(|&weight| f64::from(weight)).sum();
                assert!((sum - 1.0).abs() < 1e-5, "{how:?} {index}: {sum}");
                let line = index / grid[1];
                if (2..grid[0] - 2).contains(&line) {
                    let place = |extra: f64| (line as f64 + 0.5) * side as f64 / (grid[0] as f64 + extra) - 0.5;
                    let (expected, tolerance) = match how {
                        // Its taps are stretched and brought to a sum of one.
                        PositionGrid::Antialiased => (place(0.0), 0.02),
                        PositionGrid::Offset => {
                            let t = place(OFFSET).fract();
                            (place(OFFSET) + 0.5 * t * (1.0 - t) * (1.0 - 2.0 * t), 1e-5)
                        }
                    };
                    assert!(
                        (value(row) - expected).abs() < tolerance,
                        "{how:?} {line}: {} {expected}",
                        value(row)
                    );
                }
            }
        }
    }

    #[test]
    fn weights_without_stretching_are_those_of_the_formula() {
        // 4 samples to 2: scale 4 / 2.1, first place 0.452..., worked out by hand.
        let t: f64 = 4.0 / 2.1 * 0.5 - 0.5;
        let expected = [
            -0.75 * t * (1.0 - t) * (1.0 - t),
            1.0 - 2.25 * t * t + 1.25 * t * t * t,
            0.75 * t + 1.5 * t * t - 1.25 * t * t * t,
            -0.75 * t * t * (1.0 - t),
        ];
        let found = offset_taps(4, 2, 0);
        assert_eq!(found.iter().map(|tap| tap.0).collect::<Vec<_>>(), [0, 0, 1, 2]);
        for (found, expected) in found.iter().zip(expected) {
            assert!((f64::from(found.1) - expected).abs() < 1e-6, "{} {expected}", found.1);
        }
    }
}
