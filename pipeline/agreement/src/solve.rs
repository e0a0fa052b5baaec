//! Small linear systems.

/// Solves a symmetric positive system by Cholesky's factorisation, of which the lower half is read; `None` where it is not
/// positive. `[N, N]`, `[N]`
#[must_use]
pub fn solve<const N: usize>(mut matrix: [[f64; N]; N], mut right: [f64; N]) -> Option<[f64; N]> {
    for i in 0..N {
        for j in 0..=i {
            let mut sum = matrix[i][j];
            for k in 0..j {
                sum -= matrix[i][k] * matrix[j][k];
            }
            if i == j {
                if !(sum > 0.0 && sum.is_finite()) {
                    return None;
                }
                matrix[i][i] = sum.sqrt();
            } else {
                matrix[i][j] = sum / matrix[j][j];
            }
        }
        let known: f64 = (0..i).map(|k| matrix[i][k] * right[k]).sum();
        right[i] = (right[i] - known) / matrix[i][i];
    }
    for i in (0..N).rev() {
        let known: f64 = (i + 1..N).map(|k| matrix[k][i] * right[k]).sum();
        right[i] = (right[i] - known) / matrix[i][i];
    }
    Some(right)
}

/// The inverse of a symmetric positive matrix, of which the lower half is read; `None` where it is not positive. `[N, N]`
#[must_use]
pub fn inverse<const N: usize>(matrix: &[[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let mut out = [[0.0; N]; N];
    for (column, row) in out.iter_mut().enumerate() {
        // The inverse is symmetric: its columns are its rows.
        *row = solve(*matrix, std::array::from_fn(|i| if i == column { 1.0 } else { 0.0 }))?;
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cholesky_solves() {
        let mut matrix = [[0.0; 6]; 6];
        for i in 0..6 {
            for j in 0..6 {
                matrix[i][j] = 1.0 / (1 + i + j) as f64 + if i == j { 1.0 } else { 0.0 };
            }
        }
        let truth = [1.0, -2.0, 3.0, 0.5, -0.25, 4.0];
        let right = std::array::from_fn(|i| (0..6).map(|j| matrix[i][j] * truth[j]).sum());
        let found = solve(matrix, right).unwrap();
        assert!(found.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        let inverse = inverse(&matrix).unwrap();
        for i in 0..6 {
            let again: f64 = (0..6).map(|j| inverse[i][j] * right[j]).sum();
            assert!((again - truth[i]).abs() < 1e-9, "{inverse:?}");
        }
        assert!(solve([[0.0; 2]; 2], [1.0; 2]).is_none());
        assert_eq!(solve([[0.0; 6]; 6], [1.0; 6]), None);
    }
}
