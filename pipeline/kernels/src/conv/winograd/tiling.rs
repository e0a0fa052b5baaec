//! The transforms of Winograd's convolution, F(2x2, 3x3) and F(4x4, 3x3) (Lavin and Gray 2016), on vectors of channels.
//!
//! A filter of three taps gives `SIDE` outputs from `REACH = SIDE + 2` inputs by multiplying polynomials at `REACH - 1`
//! points and at infinity. With the points 0, ±p, ±q of F(4, 3): the inputs' transform is the coefficients of
//! `m(x) / (x - x_i)`, `m(x) = x (x² - p²) (x² - q²)`, the outputs' the powers of the points, and the kernel's those
//! powers over `m'(x_i)`. `p = 1/√2`, `q = √2` keep the factors close to 1 and halve the rounding error of 1 and 2.

use std::f32::consts::{FRAC_1_SQRT_2, SQRT_2};

use pulp::Simd;

/// One-dimensional transforms of one tile size.
pub(crate) trait Tiling<const SIDE: usize, const REACH: usize> {
    /// Inputs, `B^T d`.
    fn inputs<S: Simd>(simd: S, d: [S::f32s; REACH]) -> [S::f32s; REACH];
    /// Outputs, `A^T m`.
    fn outputs<S: Simd>(simd: S, m: [S::f32s; REACH]) -> [S::f32s; SIDE];
    /// The kernel's matrix `G`.
    fn kernel() -> [[f64; 3]; REACH];
}

/// F(2, 3) at the points 0, 1, -1.
pub(crate) struct Two;

impl Tiling<2, 4> for Two {
    #[inline(always)]
    fn inputs<S: Simd>(simd: S, d: [S::f32s; 4]) -> [S::f32s; 4] {
        [
            simd.sub_f32s(d[0], d[2]),
            simd.add_f32s(d[1], d[2]),
            simd.sub_f32s(d[2], d[1]),
            simd.sub_f32s(d[1], d[3]),
        ]
    }

    #[inline(always)]
    fn outputs<S: Simd>(simd: S, m: [S::f32s; 4]) -> [S::f32s; 2] {
        [
            simd.add_f32s(simd.add_f32s(m[0], m[1]), m[2]),
            simd.sub_f32s(simd.sub_f32s(m[1], m[2]), m[3]),
        ]
    }

    fn kernel() -> [[f64; 3]; 4] {
        [[1.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.5, -0.5, 0.5], [0.0, 0.0, 1.0]]
    }
}

/// F(4, 3) at the points 0, ±p, ±q.
pub(crate) struct Four;

/// The points, and their squares.
const P: f32 = FRAC_1_SQRT_2;
const Q: f32 = SQRT_2;
const P2: f32 = 0.5;
const Q2: f32 = 2.0;

impl Tiling<4, 6> for Four {
    #[inline(always)]
    fn inputs<S: Simd>(simd: S, d: [S::f32s; 6]) -> [S::f32s; 6] {
        let times = |factor: f32, a, b| simd.mul_add_f32s(simd.splat_f32s(factor), a, b);
        // p² q² = 1.
        let ends = |a, b, c| times(-(P2 + Q2), b, simd.add_f32s(a, c));
        let pair = |point: f32, other_squared: f32| {
            let even = times(-other_squared, d[2], d[4]);
            let odd = times(-other_squared, d[1], d[3]);
            [times(point, odd, even), times(-point, odd, even)]
        };
        let ([a, b], [c, e]) = (pair(P, Q2), pair(Q, P2));
        [ends(d[0], d[2], d[4]), a, b, c, e, ends(d[1], d[3], d[5])]
    }

    #[inline(always)]
    fn outputs<S: Simd>(simd: S, m: [S::f32s; 6]) -> [S::f32s; 4] {
        let times = |factor: f32, a, b| simd.mul_add_f32s(simd.splat_f32s(factor), a, b);
        let scaled = |factor: f32, a| simd.mul_f32s(simd.splat_f32s(factor), a);
        let (sum_p, sum_q) = (simd.add_f32s(m[1], m[2]), simd.add_f32s(m[3], m[4]));
        let (odd_p, odd_q) = (simd.sub_f32s(m[1], m[2]), simd.sub_f32s(m[3], m[4]));
        [
            simd.add_f32s(m[0], simd.add_f32s(sum_p, sum_q)),
            times(P, odd_p, scaled(Q, odd_q)),
            times(P2, sum_p, scaled(Q2, sum_q)),
            times(P2 * P, odd_p, times(Q2 * Q, odd_q, m[5])),
        ]
    }

    fn kernel() -> [[f64; 3]; 6] {
        let row = |point: f64, derivative: f64| [1.0, point, point * point].map(|power| power / derivative);
        let (p, q) = (std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::SQRT_2);
        // m'(0) = p² q², m'(±p) = 2 p² (p² - q²), m'(±q) = 2 q² (q² - p²)
        [
            row(0.0, 1.0),
            row(p, -1.5),
            row(-p, -1.5),
            row(q, 6.0),
            row(-q, 6.0),
            [0.0, 0.0, 1.0],
        ]
    }
}
