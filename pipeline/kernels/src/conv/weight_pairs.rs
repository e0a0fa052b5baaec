//! The sums of a convolution's weight gradient on numbers rounded to bfloat16: pairs of neighbouring pixels, half the
//! instructions of the f32 kernel where the CPU has AVX512_BF16, the same bits in portable code elsewhere.

use super::weight_tile::{INPUTS, OUTPUTS, SIDE, Sums, Tile};
use crate::bf16::{multiply_add_each, rounded};
use pulp::{Arch, Simd, WithSimd};

use crate::vectorised;

/// Pixels of a vector.
const PIXELS: usize = 32;
/// Sums of a vector, each of a pair of pixels.
const LANES: usize = PIXELS / 2;

/// Sums before those of a vector are added up.
type LaneSums = [[[[f32; LANES]; SIDE]; INPUTS]; OUTPUTS];

/// A number as tiles take it.
pub(crate) fn number(value: f32) -> u16 {
    rounded(value) as u16
}

/// The sums of a tile.
pub(crate) fn sums(tile: Tile<'_, u16>) -> Sums {
    lane_sums(&tile).map(|inputs| inputs.map(|taps| taps.map(|lanes| lanes.iter().sum())))
}

/// The same from planes of f32 that hold rounded numbers, the second ones of all pairs of a row behind the first ones: the
/// bits that the instruction gives, in products of f32.
pub(crate) fn rounded_sums(tile: Tile<'_, f32>) -> Sums {
    let sums = Arch::new().dispatch(Rounded(&tile));
    sums.map(|inputs| inputs.map(|taps| taps.map(|lanes| lanes.iter().sum())))
}

struct Rounded<'a>(&'a Tile<'a, f32>);

impl WithSimd for Rounded<'_> {
    type Output = LaneSums;

    // Indices in plain loops: what takes a closure to an array is compiled apart from it, without vectors.
    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> LaneSums {
        let tile = self.0;
        let [height, width] = tile.size;
        let mut lanes: LaneSums = [[[[0.0; LANES]; SIDE]; INPUTS]; OUTPUTS];
        for first in (0..LANES).step_by(S::F32_LANES) {
            let mut sums = [[[simd.splat_f32s(0.0); SIDE]; INPUTS]; OUTPUTS];
            let load = |plane: &[f32], place: usize| S::as_simd_f32s(&plane[place..][..S::F32_LANES]).0[0];
            for row in 0..height {
                for column in (0..width.div_ceil(2)).step_by(LANES) {
                    let [of_gradient, of_input] = [row * tile.strides[0], (row + tile.row) * tile.strides[1]];
                    // The numbers that follow each other from the first tap's pair on.
                    let mut values = [[simd.splat_f32s(0.0); SIDE + 1]; INPUTS];
                    for channel in 0..INPUTS {
                        for number in 0..=SIDE {
                            let half = number % 2 * (tile.strides[1] / 2);
                            let place = of_input + half + column + first + number / 2;
                            values[channel][number] = load(tile.input[channel], place);
                        }
                    }
                    for output in 0..OUTPUTS {
                        let place = of_gradient + column + first;
                        let slopes = [
                            load(tile.gradient[output], place),
                            load(tile.gradient[output], place + tile.strides[0] / 2),
                        ];
                        for channel in 0..INPUTS {
                            for tap in 0..SIDE {
                                let sum = &mut sums[output][channel][tap];
                                *sum = simd.mul_add_f32s(slopes[1], values[channel][tap + 1], *sum);
                                *sum = simd.mul_add_f32s(slopes[0], values[channel][tap], *sum);
                            }
                        }
                    }
                }
            }
            for output in 0..OUTPUTS {
                for channel in 0..INPUTS {
                    for tap in 0..SIDE {
                        let part = &mut lanes[output][channel][tap][first..first + S::F32_LANES];
                        S::as_mut_simd_f32s(part).0[0] = sums[output][channel][tap];
                    }
                }
            }
        }
        lanes
    }
}

fn lane_sums(tile: &Tile<'_, u16>) -> LaneSums {
    #[cfg(target_arch = "x86_64")]
    if crate::bf16::is_available() {
        return x86::lane_sums(tile);
    }
    portable_lane_sums(tile)
}

/// The same in code for any CPU.
fn portable_lane_sums(tile: &Tile<'_, u16>) -> LaneSums {
    let [height, width] = tile.size;
    let mut sums: LaneSums = [[[[0.0; LANES]; SIDE]; INPUTS]; OUTPUTS];
    vectorised(
        #[inline(always)]
        || {
            for row in 0..height {
                for column in (0..width).step_by(PIXELS) {
                    for (gradient, sums) in tile.gradient.iter().zip(&mut sums) {
                        let slopes = &gradient[row * tile.strides[0] + column..][..PIXELS];
                        for (input, sums) in tile.input.iter().zip(sums) {
                            for (tap, sums) in sums.iter_mut().enumerate() {
                                let values = &input[(row + tile.row) * tile.strides[1] + column + tap..][..PIXELS];
                                multiply_add_each(slopes, values, sums);
                            }
                        }
                    }
                }
            }
        },
    );
    sums
}

/// The sums by `vdpbf16ps`.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod x86 {
    use std::arch::x86_64::{__m512bh, _mm512_dpbf16_ps, _mm512_loadu_si512, _mm512_set1_ps, _mm512_storeu_ps};

    use super::{INPUTS, LANES, LaneSums, OUTPUTS, PIXELS, SIDE, Tile};
    use crate::bf16::{as_pairs, is_available};

    /// The sums of a tile; only where [`is_available`].
    pub(crate) fn lane_sums(tile: &Tile<'_, u16>) -> LaneSums {
        let [height, width] = tile.size;
        let span = width.next_multiple_of(PIXELS);
        let last = height.max(1) - 1;
        assert!(is_available());
        for gradient in tile.gradient {
            assert!(last * tile.strides[0] + span <= gradient.len());
        }
        for input in tile.input {
            assert!((last + tile.row) * tile.strides[1] + span + SIDE - 1 <= input.len());
        }
        let mut sums = [[[[0.0; LANES]; SIDE]; INPUTS]; OUTPUTS];
        // SAFETY: the features are there, and the last rows end inside of every plane (asserted above).
        unsafe { fill(tile, &mut sums) };
        sums
    }

    /// # Safety
    /// Planes of the gradient hold `size[0]` rows of whole vectors, those of the input as many from `row` on, at all taps.
    #[target_feature(enable = "avx512f,avx512bf16")]
    unsafe fn fill(tile: &Tile<'_, u16>, sums: &mut LaneSums) {
        let [height, width] = tile.size;
        let mut total = [[[_mm512_set1_ps(0.0); SIDE]; INPUTS]; OUTPUTS];
        let load = |plane: &[u16], place: usize| -> __m512bh {
            // SAFETY: the vector lies in the plane, as the caller promises.
            as_pairs(unsafe { _mm512_loadu_si512(plane.as_ptr().add(place).cast()) })
        };
        for row in 0..height {
            for column in (0..width).step_by(PIXELS) {
                let place = (row + tile.row) * tile.strides[1] + column;
                let mut values = [[load(tile.input[0], place); SIDE]; INPUTS];
                for channel in 0..INPUTS {
                    for tap in 0..SIDE {
                        values[channel][tap] = load(tile.input[channel], place + tap);
                    }
                }
                for output in 0..OUTPUTS {
                    let slope = load(tile.gradient[output], row * tile.strides[0] + column);
                    for channel in 0..INPUTS {
                        for tap in 0..SIDE {
                            let sum = &mut total[output][channel][tap];
                            *sum = _mm512_dpbf16_ps(*sum, slope, values[channel][tap]);
                        }
                    }
                }
            }
        }
        for output in 0..OUTPUTS {
            for channel in 0..INPUTS {
                for tap in 0..SIDE {
                    // SAFETY: sixteen sums.
                    unsafe {
                        _mm512_storeu_ps(sums[output][channel][tap].as_mut_ptr(), total[output][channel][tap]);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;

    #[test]
    fn the_instruction_and_the_portable_code_give_the_same_bits() {
        let (size, strides) = ([5, 40], [64, 70]);
        let numbers = |count, seed| noise(count, seed).into_iter().map(number).collect::<Vec<u16>>();
        let gradient: [Vec<u16>; OUTPUTS] = std::array::from_fn(|seed| numbers(size[0] * strides[0], seed));
        let input: [Vec<u16>; INPUTS] = std::array::from_fn(|seed| numbers((size[0] + 2) * strides[1], 9 + seed));
        for row in 0..SIDE {
            let tile = Tile {
                gradient: gradient.each_ref().map(Vec::as_slice),
                input: input.each_ref().map(Vec::as_slice),
                strides,
                row,
                size,
            };
            let bits = |sums: LaneSums| sums.map(|sums| sums.map(|sums| sums.map(|sums| sums.map(f32::to_bits))));
            assert_eq!(bits(lane_sums(&tile)), bits(portable_lane_sums(&tile)));
            let parted = |plane: &Vec<u16>, stride: usize| -> Vec<f32> {
                let number = |bits: u16| f32::from_bits(u32::from(bits) << 16);
                let half = |row: &[u16], first: usize| {
                    let mut half: Vec<f32> = row.iter().skip(first).step_by(2).copied().map(number).collect();
                    half.resize(stride / 2 + 32, 0.0);
                    half
                };
                let rows = plane.chunks_exact(stride);
                rows.flat_map(|row| [half(row, 0), half(row, 1)].concat()).collect()
            };
            let gradient = gradient.each_ref().map(|plane| parted(plane, strides[0]));
            let input = input.each_ref().map(|plane| parted(plane, strides[1]));
            let tile_of_f32 = Tile {
                gradient: gradient.each_ref().map(Vec::as_slice),
                input: input.each_ref().map(Vec::as_slice),
                strides: strides.map(|stride| stride + 64),
                row,
                size,
            };
            let found = Arch::new().dispatch(Rounded(&tile_of_f32));
            // The tile of u16 reads on beyond the last column, where this one has numbers, too.
            assert_eq!(bits(found), bits(portable_lane_sums(&tile)));
        }
    }
}
