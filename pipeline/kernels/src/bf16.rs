//! Tiles of bfloat16 pairs with f32 sums.
//!
//! A sum takes the products of a pair one after the other, the second first, each with one rounding. That is what the
//! CPU's instruction does, so those without it give the same bits from the portable code, only slower; except
//! below 1.2e-38, which the instruction takes for zero.

use super::tile::{COLUMNS, Line};
use crate::vectorised;

/// Two numbers rounded to bfloat16 (to nearest, ties to even), the first in the lower half.
#[inline(always)]
pub(crate) fn pair(first: f32, second: f32) -> u32 {
    rounded(first) | rounded(second) << 16
}

/// The bits of a number rounded to bfloat16.
#[inline(always)]
pub(crate) fn rounded(value: f32) -> u32 {
    let bits = value.to_bits();
    // A NaN stays one; only its bits can wrap here.
    let nearest = bits.wrapping_add(0x7fff + ((bits >> 16) & 1)) >> 16;
    if value.is_nan() { (bits >> 16) | 0x40 } else { nearest }
}

/// A number rounded to bfloat16.
#[inline(always)]
pub(crate) fn nearest(value: f32) -> f32 {
    f32::from_bits(rounded(value) << 16)
}

/// Rounds a row; where its length is odd the last pair ends with zero.
pub(crate) fn pack(row: &[f32], out: &mut [u32]) {
    vectorised(
        #[inline(always)]
        || {
            let pairs = row.chunks_exact(2);
            if let [last] = pairs.remainder() {
                out[row.len() / 2] = pair(*last, 0.0);
            }
            for (out, values) in out.iter_mut().zip(pairs) {
                *out = pair(values[0], values[1]);
            }
        },
    );
}

/// Rounds numbers, as f32.
pub(crate) fn round(values: &[f32], out: &mut [u32]) {
    vectorised(
        #[inline(always)]
        || {
            for (out, &value) in out.iter_mut().zip(values) {
                *out = rounded(value) << 16;
            }
        },
    );
}

/// The same of a row whose pairs are exchanged; where its length is odd a zero comes before the last number.
pub(crate) fn round_swapped(row: &[f32], out: &mut [u32]) {
    vectorised(
        #[inline(always)]
        || {
            let (pairs, last) = row.as_chunks::<2>();
            if let [last] = last {
                [out[row.len() - 1], out[row.len()]] = [0, rounded(*last) << 16];
            }
            for (out, values) in out.as_chunks_mut::<2>().0.iter_mut().zip(pairs) {
                *out = [rounded(values[1]) << 16, rounded(values[0]) << 16];
            }
        },
    );
}

/// Rounds two rows that are one behind the other, place by place.
pub(crate) fn pack_two(first: &[f32], second: &[f32], out: &mut [u32]) {
    vectorised(
        #[inline(always)]
        || {
            for ((out, a), b) in out.iter_mut().zip(first).zip(second) {
                *out = pair(*a, *b);
            }
        },
    );
}

/// Whether this CPU has the instruction that [`tile`] and its like are made of.
#[cfg(target_arch = "x86_64")]
pub(crate) fn is_available() -> bool {
    std::arch::is_x86_feature_detected!("avx512bf16") && std::arch::is_x86_feature_detected!("avx512f")
}

/// Whether the instruction makes products faster than those of f32 are.
#[cfg(target_arch = "x86_64")]
pub(crate) fn is_fast() -> bool {
    static FAST: std::sync::LazyLock<bool> = std::sync::LazyLock::new(|| is_available() && is_amd());
    *FAST
}

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, unused_unsafe, reason = "safe in newer compilers")]
fn is_amd() -> bool {
    // SAFETY: every x86-64 CPU has this instruction.
    let vendor = unsafe { std::arch::x86_64::__cpuid(0) };
    [vendor.ebx, vendor.edx, vendor.ecx]
        .map(u32::to_le_bytes)
        .as_flattened()
        == b"AuthenticAMD"
}

/// The bits of pairs as the instruction takes them.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
#[inline(always)]
pub(crate) fn as_pairs(bits: std::arch::x86_64::__m512i) -> std::arch::x86_64::__m512bh {
    // SAFETY: both types are 64 bytes of which any are valid.
    unsafe { std::mem::transmute(bits) }
}

/// The two numbers of a pair.
#[inline(always)]
fn halves(pair: u32) -> [f32; 2] {
    [f32::from_bits(pair << 16), f32::from_bits(pair & 0xffff_0000)]
}

/// Adds the products of one pair with many, as the instruction does.
#[inline(always)]
pub(crate) fn multiply_add(pair: u32, pairs: &[u32], sums: &mut [f32]) {
    let [first, second] = halves(pair);
    for (sum, &other) in sums.iter_mut().zip(pairs) {
        let [low, high] = halves(other);
        *sum = first.mul_add(low, second.mul_add(high, *sum));
    }
}

/// Adds the products of pairs of numbers, place by place, as the instruction does. `[2 L], [2 L], [L]`
#[inline(always)]
pub(crate) fn multiply_add_each(first: &[u16], second: &[u16], sums: &mut [f32]) {
    let number = |bits: u16| f32::from_bits(u32::from(bits) << 16);
    for (sum, (a, b)) in sums.iter_mut().zip(first.chunks_exact(2).zip(second.chunks_exact(2))) {
        *sum = number(a[0]).mul_add(number(b[0]), number(a[1]).mul_add(number(b[1]), *sum));
    }
}

/// Adds the products of at most [`ROWS`](super::tile::ROWS) rows and one panel of weights, as [`super::product::product`]
/// does: chunk `c` of row `r` is line `c * stride + r` of `values`, which has a line for every row of a tile.
pub(crate) fn product(values: &[Line], stride: usize, weights: &[Line], sums: &mut [Line]) {
    #[cfg(target_arch = "x86_64")]
    if is_available() {
        x86::product(values, stride, weights, sums);
        return;
    }
    portable_product(values, stride, weights, sums);
}

/// The same in code for any CPU.
fn portable_product(values: &[Line], stride: usize, weights: &[Line], sums: &mut [Line]) {
    vectorised(
        #[inline(always)]
        || {
            for (values, weights) in values.chunks(stride).zip(weights.chunks(COLUMNS)) {
                for (unit, weights) in weights.iter().enumerate() {
                    for (values, sums) in values.iter().zip(sums.iter_mut()) {
                        multiply_add(values.pairs()[unit], weights.pairs(), &mut sums.0);
                    }
                }
            }
        },
    );
}

/// The products by the instruction `vdpbf16ps` (AVX512_BF16), which compilers do not find by themselves.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod x86 {
    use std::arch::x86_64::{
        _mm512_dpbf16_ps, _mm512_loadu_ps, _mm512_loadu_si512, _mm512_set1_epi32, _mm512_setzero_ps, _mm512_storeu_ps,
    };

    use super::{COLUMNS, Line, as_pairs, is_available};
    use crate::tile::{ROWS, for_rows};

    /// Adds the products; only where [`is_available`].
    pub(crate) fn product(values: &[Line], stride: usize, weights: &[Line], sums: &mut [Line]) {
        assert!(is_available() && stride >= ROWS && sums.len() <= ROWS);
        assert!(values.len() >= weights.len().div_ceil(COLUMNS) * stride);
        let mut total = [Line::ZERO; ROWS];
        total[..sums.len()].copy_from_slice(sums);
        // SAFETY: the features are there and the slice is long enough (asserted above).
        unsafe { fill(values, stride, weights, &mut total) };
        sums.copy_from_slice(&total[..sums.len()]);
    }

    /// # Safety
    /// `values` holds `stride` lines, at least [`ROWS`], for each [`COLUMNS`] weights.
    #[target_feature(enable = "avx512f,avx512bf16")]
    unsafe fn fill(values: &[Line], stride: usize, weights: &[Line], sums: &mut [Line; ROWS]) {
        let mut total = [[_mm512_setzero_ps(); 2]; ROWS];
        for_rows!(|ROW| {
            // SAFETY: a line holds two vectors of sixteen sums.
            unsafe {
                let row = sums[ROW].0.as_ptr();
                total[ROW] = [_mm512_loadu_ps(row), _mm512_loadu_ps(row.add(COLUMNS / 2))];
            }
        });
        for (chunk, weights) in weights.chunks(COLUMNS).enumerate() {
            for (unit, weights) in weights.iter().enumerate() {
                let weights = weights.pairs();
                // SAFETY: a line holds two vectors of sixteen pairs.
                let [low, high] = unsafe {
                    [
                        _mm512_loadu_si512(weights.as_ptr().cast()),
                        _mm512_loadu_si512(weights.as_ptr().add(COLUMNS / 2).cast()),
                    ]
                };
                let [low, high] = [as_pairs(low), as_pairs(high)];
                for_rows!(|ROW| {
                    // SAFETY: `ROW < stride`, and `values` holds the lines of all chunks; `unit < COLUMNS`, as a chunk has
                    // at most so many weights.
                    let value = unsafe { *values.get_unchecked(chunk * stride + ROW).pairs().get_unchecked(unit) };
                    let value = as_pairs(_mm512_set1_epi32(value.cast_signed()));
                    total[ROW][0] = _mm512_dpbf16_ps(total[ROW][0], value, low);
                    total[ROW][1] = _mm512_dpbf16_ps(total[ROW][1], value, high);
                });
            }
        }
        for_rows!(|ROW| {
            // SAFETY: as above.
            unsafe {
                let row = sums[ROW].0.as_mut_ptr();
                _mm512_storeu_ps(row, total[ROW][0]);
                _mm512_storeu_ps(row.add(COLUMNS / 2), total[ROW][1]);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;
    use crate::tile::ROWS;

    #[test]
    fn rounding_is_to_nearest_and_ties_to_even() {
        let known = [
            0.0f32,
            1.0,
            -2.5,
            1.003_906_3,
            1.011_718_8,
            3.0e38,
            1e-39,
            f32::INFINITY,
        ];
        for value in known.into_iter().chain(noise(5000, 3)) {
            let expected = u32::from(half::bf16::from_f32(value).to_bits());
            assert_eq!(rounded(value), expected, "{value}");
        }
        for nan in [
            f32::NAN,
            -f32::NAN,
            f32::from_bits(u32::MAX),
            f32::from_bits(0x7f80_0001),
        ] {
            assert!(f32::from_bits(rounded(nan) << 16).is_nan());
        }
    }

    #[test]
    fn the_instruction_and_the_portable_code_give_the_same_bits() {
        let lines = |count: usize, seed| -> Vec<Line> {
            let mut lines = vec![Line::ZERO; count];
            let values = noise(2 * COLUMNS * count, seed);
            for (line, values) in lines.iter_mut().zip(values.chunks_exact(2 * COLUMNS)) {
                pack(values, line.pairs_mut());
            }
            lines
        };
        // Two chunks and a part of one.
        let (values, weights) = (lines(3 * ROWS, 5), lines(2 * COLUMNS + 7, 6));
        for rows in [1, 7, ROWS] {
            let mut found = vec![Line([0.5; COLUMNS]); rows];
            let mut expected = found.clone();
            product(&values, ROWS, &weights, &mut found);
            portable_product(&values, ROWS, &weights, &mut expected);
            let bits = |lines: &[Line]| {
                lines
                    .iter()
                    .flat_map(|line| line.0.map(f32::to_bits))
                    .collect::<Vec<u32>>()
            };
            assert_eq!(bits(&found), bits(&expected));
        }
    }
}
