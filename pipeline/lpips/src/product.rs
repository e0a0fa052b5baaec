//! Matrix products of a few rows with a panel of weights: the inner loop of every convolution.

use pulp::{Simd, WithSimd};

use crate::maps::{PANEL, Pixel};

/// `out[t] = sum over panels p and channels k of values[p * stride + t][k] * weights[p * PANEL + k]` for every `t`.
///
/// One sum runs over all inputs in order, so the result does not depend on how rows are grouped.
pub(super) struct Product<'a> {
    /// From the first row of the first panel on.
    pub(super) values: &'a [Pixel],
    /// Rows from one panel to the next.
    pub(super) stride: usize,
    /// One row of outputs for each input channel.
    pub(super) weights: &'a [Pixel],
    pub(super) out: &'a mut [Pixel],
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // As many sums as fit the registers: 32 of 16 lanes, 16 of 8.
        let most = if S::F32_LANES >= 16 { 12 } else { 6 };
        let count = self.out.len();
        let groups = count.div_ceil(most);
        let mut first = 0;
        for group in 0..groups {
            let next = (group + 1) * count / groups;
            let (values, out) = (&self.values[first..], &mut self.out[first..next]);
            let (stride, weights) = (self.stride, self.weights);
            match next - first {
                1 => one::<S>(simd, values, stride, weights, out),
                2 => two::<S>(simd, values, stride, weights, out),
                3 => three::<S>(simd, values, stride, weights, out),
                4 => four::<S>(simd, values, stride, weights, out),
                5 => five::<S>(simd, values, stride, weights, out),
                6 => six::<S>(simd, values, stride, weights, out),
                7 => seven::<S>(simd, values, stride, weights, out),
                8 => eight::<S>(simd, values, stride, weights, out),
                9 => nine::<S>(simd, values, stride, weights, out),
                10 => ten::<S>(simd, values, stride, weights, out),
                11 => eleven::<S>(simd, values, stride, weights, out),
                _ => twelve::<S>(simd, values, stride, weights, out),
            }
            first = next;
        }
    }
}

/// A function for the product of so many rows. The sums are named one by one: as an array with an index the compiler
/// keeps them in memory.
macro_rules! rows {
    ($name:ident: $($row:literal $sum:ident),*) => {
        #[inline(always)]
        fn $name<S: Simd>(simd: S, values: &[Pixel], stride: usize, weights: &[Pixel], out: &mut [Pixel]) {
            const ROWS: usize = [$($row),*].len();
            let (panels, _) = weights.as_chunks::<PANEL>();
            let lanes = S::F32_LANES;
            let Some(out) = out.first_chunk_mut::<ROWS>() else { return };
            for first in (0..PANEL).step_by(2 * lanes) {
                let zero = simd.splat_f32s(0.0);
                $(let mut $sum = (zero, zero);)*
                for (rows, weights) in values.chunks(stride).zip(panels) {
                    let Some(rows) = rows.first_chunk::<ROWS>() else { return };
                    for (input, weights) in weights.iter().enumerate() {
                        let weights = S::as_simd_f32s(&weights.0[first..first + 2 * lanes]).0;
                        let (left, right) = (weights[0], weights[1]);
                        $(
                            let value = simd.splat_f32s(rows[$row].0[input]);
                            $sum.0 = simd.mul_add_f32s(value, left, $sum.0);
                            $sum.1 = simd.mul_add_f32s(value, right, $sum.1);
                        )*
                    }
                }
                $(
                    let own = S::as_mut_simd_f32s(&mut out[$row].0[first..first + 2 * lanes]).0;
                    own[0] = $sum.0;
                    own[1] = $sum.1;
                )*
            }
        }
    };
}

rows!(one: 0 a);
rows!(two: 0 a, 1 b);
rows!(three: 0 a, 1 b, 2 c);
rows!(four: 0 a, 1 b, 2 c, 3 d);
rows!(five: 0 a, 1 b, 2 c, 3 d, 4 e);
rows!(six: 0 a, 1 b, 2 c, 3 d, 4 e, 5 f);
rows!(seven: 0 a, 1 b, 2 c, 3 d, 4 e, 5 f, 6 g);
rows!(eight: 0 a, 1 b, 2 c, 3 d, 4 e, 5 f, 6 g, 7 h);
rows!(nine: 0 a, 1 b, 2 c, 3 d, 4 e, 5 f, 6 g, 7 h, 8 i);
rows!(ten: 0 a, 1 b, 2 c, 3 d, 4 e, 5 f, 6 g, 7 h, 8 i, 9 j);
rows!(eleven: 0 a, 1 b, 2 c, 3 d, 4 e, 5 f, 6 g, 7 h, 8 i, 9 j, 10 k);
rows!(twelve: 0 a, 1 b, 2 c, 3 d, 4 e, 5 f, 6 g, 7 h, 8 i, 9 j, 10 k, 11 l);
