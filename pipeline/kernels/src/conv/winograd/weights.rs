//! Weights, transformed once.

use rayon::prelude::*;

use super::tiling::Tiling;
use crate::tile::{COLUMNS, Line};

/// Transformed weights. `[panels of outputs][points][inputs]`
pub(super) fn transformed<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize>(
    weight: &[f32],
    inputs: usize,
    outputs: usize,
) -> Vec<Line> {
    let matrix = T::kernel();
    let per_panel = REACH * REACH * inputs;
    let mut transformed = vec![Line::ZERO; outputs.div_ceil(COLUMNS) * per_panel];
    transformed
        .par_chunks_exact_mut(per_panel.max(1))
        .enumerate()
        .for_each(|(panel, transformed)| {
            for output in panel * COLUMNS..outputs.min((panel + 1) * COLUMNS) {
                for input in 0..inputs {
                    let kernel = &weight[(output * inputs + input) * 9..][..9];
                    for point in 0..REACH * REACH {
                        let (row, column) = (&matrix[point / REACH], &matrix[point % REACH]);
                        let terms = (0..9).map(|tap| row[tap / 3] * f64::from(kernel[tap]) * column[tap % 3]);
                        let sum: f64 = terms.sum();
                        transformed[point * inputs + input].0[output % COLUMNS] = sum as f32;
                    }
                }
            }
        });
    transformed
}

/// Values by channel as lines, the rest of the last one zero.
pub(super) fn lines(values: &[f32]) -> Vec<Line> {
    let line = |values: &[f32]| {
        let mut line = Line::ZERO;
        line.0[..values.len()].copy_from_slice(values);
        line
    };
    values.chunks(COLUMNS).map(line).collect()
}
