//! Elementwise functions that the compiler turns into vector code.

use crate::vectorised;

/// e^x for x in about [-87, 88], to about 2 units in the last place; smaller arguments give 0 or nearly so.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    // x = n ln 2 + r, |r| <= ln 2 / 2; e^r by its Taylor polynomial of degree 7, 2^n in the exponent.
    const ROUND: f32 = 12_582_912.0;
    const LN2_HIGH: f32 = 0.693_359_375;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    let x = x.clamp(-87.0, 88.0);
    let shifted = x.mul_add(std::f32::consts::LOG2_E, ROUND);
    let n = shifted - ROUND;
    let r = n.mul_add(-LN2_LOW, n.mul_add(-LN2_HIGH, x));
    let mut sum = 1.0 / 5040.0;
    for coefficient in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        sum = r.mul_add(sum, coefficient);
    }
    let power = f32::from_bits(shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23);
    sum * power
}

/// x * (1 + erf(x / sqrt 2)) / 2, absolute error below 3e-7 * (1 + |x|).
#[inline(always)]
pub fn gelu(x: f32) -> f32 {
    x * normal(x).0
}

/// The share of a standard normal distribution below x, and e^(-x^2 / 2).
#[inline(always)]
fn normal(x: f32) -> (f32, f32) {
    // erf by Abramowitz and Stegun 7.1.26: 1 - (a1 t + ... + a5 t^5) e^(-z^2), t = 1 / (1 + p z).
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / z.mul_add(0.327_591_1, 1.0);
    let mut sum = 1.061_405_4_f32;
    for coefficient in [-1.453_152, 1.421_413_7, -0.284_496_74, 0.254_829_6] {
        sum = t.mul_add(sum, coefficient);
    }
    let bell = exp(-z * z);
    let tail = 0.5 * sum * t * bell;
    (if x > 0.0 { 1.0 - tail } else { tail }, bell)
}

/// The derivative of [`gelu`], absolute error below 3e-7 * (1 + |x|).
#[inline(always)]
pub fn gelu_slope(x: f32) -> f32 {
    const DENSITY: f32 = 0.398_942_3;
    let (below, bell) = normal(x);
    (x * DENSITY).mul_add(bell, below)
}

/// [`gelu`] of all values, in place, on the calling thread.
pub fn gelu_in_place(x: &mut [f32]) {
    vectorised(
        #[inline(always)]
        || {
            for value in x.iter_mut() {
                *value = gelu(*value);
            }
        },
    );
}

/// max(x, 0) of all values, in place.
pub fn relu_in_place(x: &mut [f32]) {
    for value in x {
        *value = value.max(0.0);
    }
}

/// Adds `y` to `x` value by value.
#[inline(always)]
pub fn add_assign(x: &mut [f32], y: &[f32]) {
    for (x, y) in x.iter_mut().zip(y) {
        *x += y;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_and_gelu_are_accurate() {
        let (mut worst_exp, mut worst_gelu) = (0.0f64, 0.0f64);
        for k in -80_000..80_000 {
            let x = k as f32 / 1000.0;
            let reference = libm::exp(f64::from(x));
            worst_exp = worst_exp.max((f64::from(exp(x)) / reference - 1.0).abs());
            let reference = 0.5 * f64::from(x) * (1.0 + libm::erf(f64::from(x) / std::f64::consts::SQRT_2));
            worst_gelu = worst_gelu.max((f64::from(gelu(x)) - reference).abs() / (1.0 + f64::from(x.abs())));
        }
        for k in -8_000..8_000 {
            let x = f64::from(k) / 1000.0;
            let density = libm::exp(-0.5 * x * x) / (2.0 * std::f64::consts::PI).sqrt();
            let reference = 0.5 * (1.0 + libm::erf(x / std::f64::consts::SQRT_2)) + x * density;
            let error = (f64::from(gelu_slope(x as f32)) - reference).abs() / (1.0 + x.abs());
            assert!(error < 3e-7, "{x}: {error:e}");
        }
        assert!(worst_exp < 3e-7 && worst_gelu < 3e-7, "{worst_exp:e} {worst_gelu:e}");
        assert_eq!(exp(-1e30), exp(-87.0));
    }
}
