//! Real spherical harmonics up to degree 3 in the sign convention of 3DGS (`docs/spec/rasteriser.md` section 8).

/// Highest degree.
pub const MAX_DEGREE: usize = 3;
/// Number of coefficients at the highest degree.
pub const MAX_COEFFICIENTS: usize = 16;
/// Y_0, the factor between a degree-0 coefficient and the colour.
pub const C0: f32 = 0.282_094_8;

const C1: f32 = 0.488_602_51;
const C2: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_2];
const C3: [f32; 5] = [0.590_043_6, 2.890_611_4, 0.457_045_8, 0.373_176_34, 1.445_305_7];

/// Number of coefficients of a degree, per colour channel.
#[must_use]
pub const fn coefficient_count(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// Degree-0 coefficient of a plain colour value.
#[must_use]
pub fn coefficient_from_colour(colour: f32) -> f32 {
    (colour - 0.5) / C0
}

/// Basis functions at a unit direction, the first `coefficient_count(degree)` of them.
#[must_use]
pub fn basis(degree: usize, direction: [f32; 3]) -> [f32; MAX_COEFFICIENTS] {
    let [x, y, z] = direction;
    let mut b = [0.0; MAX_COEFFICIENTS];
    b[0] = C0;
    if degree >= 1 {
        b[1] = -C1 * y;
        b[2] = C1 * z;
        b[3] = -C1 * x;
    }
    if degree >= 2 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        b[4] = C2[0] * x * y;
        b[5] = -C2[0] * y * z;
        b[6] = C2[1] * (2.0 * zz - xx - yy);
        b[7] = -C2[0] * x * z;
        b[8] = C2[2] * (xx - yy);
        if degree >= 3 {
            b[9] = -C3[0] * y * (3.0 * xx - yy);
            b[10] = C3[1] * x * y * z;
            b[11] = -C3[2] * y * (4.0 * zz - xx - yy);
            b[12] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
            b[13] = -C3[2] * x * (4.0 * zz - xx - yy);
            b[14] = C3[4] * z * (xx - yy);
            b[15] = -C3[0] * x * (xx - 3.0 * yy);
        }
    }
    b
}

/// Derivatives of the basis polynomials with respect to the three components of the direction.
#[must_use]
pub fn basis_gradient(degree: usize, direction: [f32; 3]) -> [[f32; 3]; MAX_COEFFICIENTS] {
    let [x, y, z] = direction;
    let mut d = [[0.0; 3]; MAX_COEFFICIENTS];
    if degree >= 1 {
        d[1] = [0.0, -C1, 0.0];
        d[2] = [0.0, 0.0, C1];
        d[3] = [-C1, 0.0, 0.0];
    }
    if degree >= 2 {
        d[4] = [C2[0] * y, C2[0] * x, 0.0];
        d[5] = [0.0, -C2[0] * z, -C2[0] * y];
        d[6] = [-2.0 * C2[1] * x, -2.0 * C2[1] * y, 4.0 * C2[1] * z];
        d[7] = [-C2[0] * z, 0.0, -C2[0] * x];
        d[8] = [2.0 * C2[2] * x, -2.0 * C2[2] * y, 0.0];
    }
    if degree >= 3 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        d[9] = [-6.0 * C3[0] * x * y, -C3[0] * (3.0 * xx - 3.0 * yy), 0.0];
        d[10] = [C3[1] * y * z, C3[1] * x * z, C3[1] * x * y];
        d[11] = [
            2.0 * C3[2] * x * y,
            -C3[2] * (4.0 * zz - xx - 3.0 * yy),
            -8.0 * C3[2] * y * z,
        ];
        d[12] = [
            -6.0 * C3[3] * x * z,
            -6.0 * C3[3] * y * z,
            C3[3] * (6.0 * zz - 3.0 * xx - 3.0 * yy),
        ];
        d[13] = [
            -C3[2] * (4.0 * zz - 3.0 * xx - yy),
            2.0 * C3[2] * x * y,
            -8.0 * C3[2] * x * z,
        ];
        d[14] = [2.0 * C3[4] * x * z, -2.0 * C3[4] * y * z, C3[4] * (xx - yy)];
        d[15] = [-C3[0] * (3.0 * xx - 3.0 * yy), 6.0 * C3[0] * x * y, 0.0];
    }
    d
}

/// Colour before the clamp, `sum_k Y_k c_k + 0.5`; `coefficients` are `[K, 3]`.
pub(crate) fn evaluate(degree: usize, direction: [f32; 3], coefficients: &[f32]) -> [f32; 3] {
    let basis = basis(degree, direction);
    let mut colour = [0.5; 3];
    for (y, c) in basis.iter().zip(coefficients.chunks_exact(3)) {
        for k in 0..3 {
            colour[k] += y * c[k];
        }
    }
    colour
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The polynomials' derivatives against central differences of the polynomials.
    #[test]
    fn gradient_is_the_derivative_of_the_basis() {
        let at = [0.31_f32, -0.62, 0.72];
        let gradient = basis_gradient(3, at);
        for axis in 0..3 {
            let (mut up, mut down) = (at, at);
            up[axis] += 1e-2;
            down[axis] -= 1e-2;
            let (up, down) = (basis(3, up), basis(3, down));
            for k in 0..MAX_COEFFICIENTS {
                let numeric = (up[k] - down[k]) / 2e-2;
                assert!((numeric - gradient[k][axis]).abs() < 2e-3, "Y{k} axis {axis}");
            }
        }
    }

    #[test]
    fn degree_zero_inverts() {
        let c = coefficient_from_colour(0.73);
        assert!((evaluate(0, [0.0, 0.0, 1.0], &[c, c, c])[1] - 0.73).abs() < 1e-6);
    }
}
