//! Matrices turned round.

use rayon::prelude::*;

/// Rows of the result that are written side by side.
const PIECE: usize = 16;

/// The transpose of a matrix, every number mapped. `[rows, columns] -> [columns, rows]`
pub fn transposed(matrix: &[f32], rows: usize, number: impl Fn(f32) -> f32 + Sync) -> Vec<f32> {
    let columns = matrix.len() / rows.max(1);
    let mut out = vec![0.0; rows * columns];
    out.par_chunks_mut((PIECE * rows).max(1))
        .enumerate()
        .for_each(|(piece, out)| {
            let count = out.len() / rows;
            for (row, values) in matrix.chunks_exact(columns).enumerate() {
                for (place, &value) in values[piece * PIECE..][..count].iter().enumerate() {
                    out[place * rows + row] = number(value);
                }
            }
        });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_become_columns() {
        for (rows, columns) in [(0, 5), (5, 0), (1, 1), (3, 40), (40, 3)] {
            let matrix: Vec<f32> = (0..rows * columns).map(|k| k as f32).collect();
            let found = transposed(&matrix, rows, |value| -value);
            assert_eq!(found.len(), matrix.len());
            for (place, value) in found.iter().enumerate() {
                assert_eq!(*value, -matrix[place % rows * columns + place / rows]);
            }
        }
    }
}
