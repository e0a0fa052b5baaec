//! Turning spherical harmonics with their field.

use glam::{DMat3, DVec3};
use rogs_splat::sh::{MAX_COEFFICIENTS, basis, coefficient_count};

/// Nodes and weights of the four-point Gauss-Legendre rule: exact for polynomials up to degree 7.
const NODES: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.347_854_845_137_453_8),
    (-0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
    (0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_8),
];
/// Directions around the axis; as many are exact up to degree 7.
const AROUND: usize = 8;

/// The matrix that takes the coefficients of a function in frame `b` to those in frame `a`: entry `(j, k)` is the integral
/// of `Y_j(R d) Y_k(d)` over the sphere, since the functions are orthonormal. Products have degree 6 at most, so the
/// quadrature is exact up to rounding.
#[derive(Debug, Clone)]
pub(crate) struct Turn {
    count: usize,
    matrix: [[f64; MAX_COEFFICIENTS]; MAX_COEFFICIENTS],
}

impl Turn {
    /// For harmonics up to `degree` and the rotation R of `a_from_b`.
    pub(crate) fn new(degree: usize, rotation: &DMat3) -> Self {
        let mut matrix = [[0.0; MAX_COEFFICIENTS]; MAX_COEFFICIENTS];
        for (z, weight) in NODES {
            let radius = (1.0 - z * z).sqrt();
            for step in 0..AROUND {
                let angle = std::f64::consts::TAU * step as f64 / AROUND as f64;
                let b = DVec3::new(radius * libm::cos(angle), radius * libm::sin(angle), z);
                let at = |direction: DVec3| basis(degree, direction.as_vec3().to_array());
                let (of_a, of_b) = (at(*rotation * b), at(b));
                let share = weight * std::f64::consts::TAU / AROUND as f64;
                for (row, a) in matrix.iter_mut().zip(of_a) {
                    for (entry, b) in row.iter_mut().zip(of_b) {
                        *entry += share * f64::from(a) * f64::from(b);
                    }
                }
            }
        }
        Self {
            count: coefficient_count(degree),
            matrix,
        }
    }

    /// The coefficients of one Gaussian in frame `a`. `[count, 3]`
    pub(crate) fn apply(&self, coefficients: &[f32]) -> impl Iterator<Item = f32> {
        let (count, matrix) = (self.count, &self.matrix);
        (0..count * 3).map(move |at| {
            let (row, channel) = (at / 3, at % 3);
            let terms = (0..count).map(|k| matrix[row][k] * f64::from(coefficients[3 * k + channel]));
            terms.sum::<f64>() as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_function_has_the_value_of_the_direction_it_came_from() {
        // A rotation by 1 radian about (1, 2, 2) / 3.
        let rotation = rogs_geometry::rotation_about_axis(DVec3::new(1.0, 2.0, 2.0) / 3.0, 1.0);
        for degree in 0..=3 {
            let count = coefficient_count(degree);
            let own: Vec<f32> = (0..count * 3).map(|k| ((k * 7 % 11) as f32 - 5.0) / 10.0).collect();
            let turned: Vec<f32> = Turn::new(degree, &rotation).apply(&own).collect();
            for b in [[0.6, 0.0, 0.8], [-0.48, 0.6, 0.64], [0.0, -1.0, 0.0]].map(DVec3::from_array) {
                let a = rotation * b;
                let value = |coefficients: &[f32], direction: DVec3| -> f32 {
                    let y = basis(degree, direction.as_vec3().to_array());
                    (0..count).map(|k| y[k] * coefficients[3 * k]).sum()
                };
                assert!((value(&own, b) - value(&turned, a)).abs() < 2e-6, "degree {degree}");
            }
        }
    }
}
