//! Rotations as six numbers: the first two columns before they are made orthonormal (`docs/spec/baseline-som.md`
//! section 5).

use glam::{DMat3, DVec3};

/// Smallest length that a column is divided by.
const SMALLEST: f64 = 1e-12;

/// The rotation of six numbers: columns `x = normalise(a)`, `y = normalise(b - (b . x) x)`, `z = x cross y`.
#[must_use]
pub fn rotation(six: [f64; 6]) -> DMat3 {
    let Columns { x, y, .. } = Columns::of(six);
    DMat3::from_cols(x, y, x.cross(y))
}

/// The six numbers of a rotation: column 0, then column 1.
#[must_use]
pub fn six(rotation: &DMat3) -> [f64; 6] {
    let ([a, b, c], [d, e, f]) = (rotation.x_axis.to_array(), rotation.y_axis.to_array());
    [a, b, c, d, e, f]
}

/// Gradient with respect to the six numbers, given that with respect to the nine of the matrix.
#[must_use]
pub fn rotation_gradient(numbers: [f64; 6], gradient: &DMat3) -> [f64; 6] {
    let Columns {
        x,
        y,
        b,
        a_length,
        u_length,
    } = Columns::of(numbers);
    let (mut gx, mut gy, gz) = (gradient.x_axis, gradient.y_axis, gradient.z_axis);
    gx += y.cross(gz);
    gy += gz.cross(x);
    let gu = (gy - y * y.dot(gy)) / u_length;
    let gb = gu - x * x.dot(gu);
    gx -= gu * b.dot(x) + b * x.dot(gu);
    let ga = (gx - x * x.dot(gx)) / a_length;
    [ga.x, ga.y, ga.z, gb.x, gb.y, gb.z]
}

/// What a rotation is made of.
struct Columns {
    x: DVec3,
    y: DVec3,
    b: DVec3,
    a_length: f64,
    u_length: f64,
}

impl Columns {
    fn of([a0, a1, a2, b0, b1, b2]: [f64; 6]) -> Self {
        let (a, b) = (DVec3::new(a0, a1, a2), DVec3::new(b0, b1, b2));
        let a_length = a.length().max(SMALLEST);
        let x = a / a_length;
        let u = b - x * b.dot(x);
        let u_length = u.length().max(SMALLEST);
        Self {
            x,
            y: u / u_length,
            b,
            a_length,
            u_length,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_are_those_of_central_differences() {
        let numbers = [0.4, -1.1, 0.7, 0.9, 0.3, -0.2];
        let weights = DMat3::from_cols_array(&[0.3, -0.8, 0.5, 1.2, 0.1, -0.6, 0.7, 0.9, -0.4]);
        let value = |six: [f64; 6]| {
            let rotation = rotation(six).to_cols_array();
            rotation
                .iter()
                .zip(weights.to_cols_array())
                .map(|(a, b)| a * b)
                .sum::<f64>()
        };
        let found = rotation_gradient(numbers, &weights);
        for k in 0..6 {
            let at = |step: f64| {
                let mut moved = numbers;
                moved[k] += step;
                value(moved)
            };
            let expected = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!((found[k] - expected).abs() < 1e-8, "{k}: {} {expected}", found[k]);
        }
    }

    #[test]
    fn a_rotation_comes_back_from_its_six_numbers() {
        let turned = rotation([0.4, -1.1, 0.7, 0.9, 0.3, -0.2]);
        let back = rotation(six(&turned));
        assert!(back.abs_diff_eq(turned, 1e-15) && (turned.determinant() - 1.0).abs() < 1e-14);
    }
}
