//! Sixteen lanes of f32 on every machine: run-time choice of the instruction set, and the exponential.
//!
//! All kernels are written once over `pulp`'s vector trait with sixteen-lane types. Every level executes the same
//! IEEE operations in the same order (fused multiply-adds included, horizontal sums by halves), so that results are
//! equal bit for bit on AVX-512, on AVX2 and in portable code.

use pulp::{Simd, WithSimd};
use serde::{Deserialize, Serialize};

/// Lanes of a vector: a block of 4 x 4 pixels, or 16 Gaussians.
pub(crate) const LANES: usize = 16;

/// Which vector instructions to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SimdLevel {
    /// The widest that the machine has.
    #[default]
    Auto,
    /// Portable code (on AArch64 the compiler turns it into NEON).
    Portable,
    /// AVX2 with FMA; falls back to portable code where the machine lacks it.
    Avx2,
    /// AVX-512; falls back to AVX2 or portable code where the machine lacks it.
    Avx512,
}

impl SimdLevel {
    /// The levels that this machine has, widest last.
    #[must_use]
    pub fn available() -> Vec<Self> {
        let mut levels = vec![Self::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            if pulp::x86::V3::try_new().is_some() {
                levels.push(Self::Avx2);
            }
            if pulp::x86::V4::try_new().is_some() {
                levels.push(Self::Avx512);
            }
        }
        levels
    }
}

/// Runs a kernel at a level. Only types whose `f32s` has sixteen lanes are ever passed.
#[inline]
pub(crate) fn dispatch<K: WithSimd>(level: SimdLevel, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    {
        if matches!(level, SimdLevel::Auto | SimdLevel::Avx512)
            && let Some(simd) = pulp::x86::V4::try_new()
        {
            return Simd::vectorize(simd, kernel);
        }
        if level != SimdLevel::Portable
            && let Some(simd) = pulp::x86::V3::try_new()
        {
            return Simd::vectorize(
                simd,
                Wide {
                    simd: pulp::x86::V3_512b(simd),
                    kernel,
                },
            );
        }
    }
    let _ = level;
    Simd::vectorize(pulp::Scalar512b, kernel)
}

/// Runs a kernel with pairs of AVX2 registers inside code that is compiled for AVX2.
#[cfg(target_arch = "x86_64")]
struct Wide<K> {
    simd: pulp::x86::V3_512b,
    kernel: K,
}

#[cfg(target_arch = "x86_64")]
impl<K: WithSimd> WithSimd for Wide<K> {
    type Output = K::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> K::Output {
        self.kernel.with_simd(self.simd)
    }
}

/// Sixteen floats in memory, aligned for vector loads.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(crate) struct Lanes(pub(crate) [f32; LANES]);

impl Lanes {
    pub(crate) const ZERO: Self = Self([0.0; LANES]);
}

/// Loads sixteen floats.
#[inline(always)]
pub(crate) fn load<S: Simd>(values: &Lanes) -> S::f32s {
    bytemuck::cast(*values)
}

/// Stores sixteen floats.
#[inline(always)]
pub(crate) fn store<S: Simd>(values: S::f32s) -> Lanes {
    bytemuck::cast(values)
}

/// The sums over the lanes of sixteen vectors, each by halves as `reduce_sum_f32s` adds them, bit for bit: lane `k` of the
/// result is the sum of `vectors[k]`. Four steps halve all vectors together, 45 operations instead of 128.
#[inline(always)]
pub(crate) fn horizontal_sums<S: Simd>(simd: S, vectors: &[S::f32s; LANES]) -> Lanes {
    // Written out: as loops over an array the compiler does it lane by lane (measured).
    let v = vectors;
    let a = fold::<S, 4>(simd, fold::<S, 8>(simd, v[0], v[8]), fold::<S, 8>(simd, v[4], v[12]));
    let b = fold::<S, 4>(simd, fold::<S, 8>(simd, v[1], v[9]), fold::<S, 8>(simd, v[5], v[13]));
    let c = fold::<S, 4>(simd, fold::<S, 8>(simd, v[2], v[10]), fold::<S, 8>(simd, v[6], v[14]));
    let d = fold::<S, 4>(simd, fold::<S, 8>(simd, v[3], v[11]), fold::<S, 8>(simd, v[7], v[15]));
    store::<S>(fold::<S, 1>(simd, fold::<S, 2>(simd, a, c), fold::<S, 2>(simd, b, d)))
}

/// Halves the groups of `2 * HALF` lanes of two vectors: those of `a` and `b` in turn.
#[inline(always)]
fn fold<S: Simd, const HALF: usize>(simd: S, a: S::f32s, b: S::f32s) -> S::f32s {
    let (a, b) = (store::<S>(a).0, store::<S>(b).0);
    let (mut low, mut high) = (Lanes::ZERO, Lanes::ZERO);
    let mut group = 0;
    while group < LANES {
        for lane in 0..HALF {
            low.0[group + lane] = a[group + lane];
            low.0[group + HALF + lane] = b[group + lane];
            high.0[group + lane] = a[group + HALF + lane];
            high.0[group + HALF + lane] = b[group + HALF + lane];
        }
        group += 2 * HALF;
    }
    simd.add_f32s(load::<S>(&low), load::<S>(&high))
}

/// Asks for a cache line that will be read soon: the records of a tile lie all over memory. No effect on results.
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    #[cfg(target_arch = "x86_64")]
    {
        // SAFETY: a prefetch of a valid reference reads nothing.
        #[allow(unsafe_code)] // measured: a quarter of the forward pass (docs/performance/splat.md)
        unsafe {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

/// The lanes of a mask as bits, lane 0 lowest.
#[inline(always)]
pub(crate) fn bits<S: Simd>(_simd: S, mask: S::m32s) -> u32 {
    // AVX-512 has mask registers of one bit a lane, the others have vectors of all ones and zeros.
    let bytes = bytemuck::bytes_of(&mask);
    if size_of::<S::m32s>() == 2 {
        return u32::from(u16::from_le_bytes([bytes[0], bytes[1]]));
    }
    let mut bits = 0;
    for lane in 0..LANES {
        bits |= u32::from(bytes[4 * lane] & 1) << lane;
    }
    bits
}

/// 2^x for x in [-125, 100], relative error below 2e-7; smaller x are taken as -125.
///
/// x = n + f with integer n and |f| <= 1/2 (the addition of 1.5 * 2^23 rounds to an integer whose low bits hold n), 2^f
/// by a polynomial of degree 5 with relative error 9.2e-8 and value 1 at 0, 2^n by adding n to the exponent.
#[inline(always)]
#[allow(clippy::approx_constant)] // the fitted coefficient is not ln 2
pub(crate) fn exp2<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let magic = simd.splat_f32s(12_582_912.0);
    let x = simd.max_f32s(x, simd.splat_f32s(-125.0));
    let shifted = simd.add_f32s(x, magic);
    let f = simd.sub_f32s(x, simd.sub_f32s(shifted, magic));
    let mut p = simd.splat_f32s(1.326_472_7e-3);
    p = simd.mul_add_f32s(p, f, simd.splat_f32s(9.671_513e-3));
    p = simd.mul_add_f32s(p, f, simd.splat_f32s(5.550_733_6e-2));
    p = simd.mul_add_f32s(p, f, simd.splat_f32s(0.240_222_42));
    p = simd.mul_add_f32s(p, f, simd.splat_f32s(0.693_146_98));
    p = simd.mul_add_f32s(p, f, simd.splat_f32s(1.0));
    let n = simd.wrapping_dyn_shl_u32s(simd.transmute_u32s_f32s(shifted), simd.splat_u32s(23));
    simd.transmute_f32s_u32s(simd.add_u32s(simd.transmute_u32s_f32s(p), n))
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Exp2Of(Lanes);

    impl WithSimd for Exp2Of {
        type Output = Lanes;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Lanes {
            store::<S>(exp2(simd, load::<S>(&self.0)))
        }
    }

    struct SumAndBits(Lanes);

    impl WithSimd for SumAndBits {
        type Output = (f32, u32);
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> (f32, u32) {
            let v = load::<S>(&self.0);
            (
                simd.reduce_sum_f32s(v),
                bits(simd, simd.greater_than_f32s(v, simd.splat_f32s(0.0))),
            )
        }
    }

    #[test]
    fn exp2_is_accurate_and_equal_on_every_level() {
        let mut worst = 0.0_f64;
        for block in 0..4000 {
            let x = Lanes(std::array::from_fn(|l| -((block * LANES + l) as f32) * 1.7e-3));
            let portable = dispatch(SimdLevel::Portable, Exp2Of(x)).0;
            for level in SimdLevel::available() {
                assert_eq!(
                    dispatch(level, Exp2Of(x)).0.map(f32::to_bits),
                    portable.map(f32::to_bits),
                    "{level:?}"
                );
            }
            for lane in 0..LANES {
                let exact = libm::exp2(f64::from(x.0[lane]));
                worst = worst.max((f64::from(portable[lane]) / exact - 1.0).abs());
            }
        }
        assert!(worst < 2e-7, "relative error {worst}");
        assert_eq!(dispatch(SimdLevel::Portable, Exp2Of(Lanes::ZERO)).0, [1.0; LANES]);
    }

    struct SumsOf([Lanes; LANES]);

    impl WithSimd for SumsOf {
        type Output = (Lanes, [f32; LANES]);
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let mut vectors = [simd.splat_f32s(0.0); LANES];
            for k in 0..LANES {
                vectors[k] = load::<S>(&self.0[k]);
            }
            let single = vectors.map(|v| simd.reduce_sum_f32s(v));
            (horizontal_sums(simd, &vectors), single)
        }
    }

    #[test]
    fn sums_of_sixteen_vectors_are_those_of_each() {
        let mut state = 3_u32;
        let vectors: [Lanes; LANES] = std::array::from_fn(|_| {
            Lanes(std::array::from_fn(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / 1e6 - 8.0
            }))
        });
        for level in SimdLevel::available() {
            let (together, single) = dispatch(level, SumsOf(vectors));
            assert_eq!(together.0.map(f32::to_bits), single.map(f32::to_bits), "{level:?}");
        }
    }

    #[test]
    fn horizontal_sums_and_masks_are_equal_on_every_level() {
        let mut state = 1_u32;
        for _ in 0..500 {
            let values = Lanes(std::array::from_fn(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / 1e6 - 8.0
            }));
            let (sum, mask) = dispatch(SimdLevel::Portable, SumAndBits(values));
            for level in SimdLevel::available() {
                let (other, other_mask) = dispatch(level, SumAndBits(values));
                assert_eq!((sum.to_bits(), mask), (other.to_bits(), other_mask), "{level:?}");
            }
        }
    }
}
