//! The sums of a 3x3 convolution on numbers rounded to bfloat16, in pairs of input channels: half the instructions of the
//! f32 kernel where the CPU has AVX512_BF16, the same bits in portable code elsewhere (see [`crate::bf16`]).

use super::band::{Band, TILE};
use crate::bf16::{multiply_add, pack_two, pair};
use crate::vectorised;

/// Pixels of a vector.
const LANES: usize = 16;
/// Taps of a kernel.
const TAPS: usize = 9;

/// Sums of `TILE` channels at some vectors of pixels.
type Sums<const V: usize> = [[[f32; LANES]; V]; TILE];

/// Weights laid out for the tiles, the last input of an odd number with a zero. `[tiles][pairs of inputs][9][TILE]`
pub(crate) fn pack(weight: &[f32], outputs: usize, inputs: usize) -> Vec<u32> {
    let mut pairs = vec![0u32; outputs.div_ceil(TILE) * inputs.div_ceil(2) * TAPS * TILE];
    for output in 0..outputs {
        let tile = &mut pairs[output / TILE * inputs.div_ceil(2) * TAPS * TILE..];
        let weight = &weight[output * inputs * TAPS..][..inputs * TAPS];
        for (inputs, weights) in weight.chunks(2 * TAPS).enumerate() {
            for tap in 0..TAPS {
                let second = weights.get(TAPS + tap).copied().unwrap_or(0.0);
                tile[(inputs * TAPS + tap) * TILE + output % TILE] = pair(weights[tap], second);
            }
        }
    }
    pairs
}

/// A band as pairs of channels. `[pairs of inputs][rows + 2][stride]`
struct Pairs {
    values: Vec<u32>,
    plane: usize,
    stride: usize,
}

impl Pairs {
    fn new(band: &Band) -> Self {
        let (plane, inputs) = (band.plane(), band.values().len() / band.plane().max(1));
        let mut values = vec![0u32; inputs.div_ceil(2) * plane];
        let zeros = vec![0.0; plane];
        for (out, channels) in values.chunks_exact_mut(plane).zip(band.values().chunks(2 * plane)) {
            let (first, second) = channels.split_at(plane);
            pack_two(first, if second.is_empty() { &zeros } else { second }, out);
        }
        Self {
            values,
            plane,
            stride: band.stride(),
        }
    }
}

/// Convolves one band into the rows of every output.
pub(crate) fn band(weights: &[u32], bias: &[f32], band: &Band, planes: &mut [&mut [f32]]) {
    let [rows, width] = band.size();
    let map = Pairs::new(band);
    let pairs = map.values.len() / map.plane.max(1);
    let (tiles, biases) = (weights.chunks_exact(pairs * TAPS * TILE), bias.chunks_exact(TILE));
    for ((weights, bias), out) in tiles.zip(biases).zip(planes.chunks_mut(TILE)) {
        for row in 0..rows {
            let mut column = 0;
            while column < width {
                let place = row * map.stride + column;
                // 4 = 2 + 2 keeps more sums in flight than 3 + 1.
                column += LANES
                    * match (width - column).div_ceil(LANES) {
                        1 => store::<1>(&tile(&map, weights, bias, place), out, width, [row, column]),
                        2 | 4 => store::<2>(&tile(&map, weights, bias, place), out, width, [row, column]),
                        _ => store::<3>(&tile(&map, weights, bias, place), out, width, [row, column]),
                    };
            }
        }
    }
}

/// Writes what lies within the width; returns V.
fn store<const V: usize>(sums: &Sums<V>, out: &mut [&mut [f32]], width: usize, [row, column]: [usize; 2]) -> usize {
    for (plane, sums) in out.iter_mut().zip(sums) {
        let values = &mut plane[row * width + column..];
        let valid = (width - column).min(V * LANES);
        for (values, sums) in values[..valid].chunks_mut(LANES).zip(sums) {
            values.copy_from_slice(&sums[..values.len()]);
        }
    }
    V
}

/// Sums one tile whose upper left inputs lie at `place` of a plane.
fn tile<const V: usize>(map: &Pairs, weights: &[u32], bias: &[f32], place: usize) -> Sums<V> {
    #[cfg(target_arch = "x86_64")]
    if crate::bf16::is_available() {
        return x86::tile(map, weights, bias, place);
    }
    portable_tile(map, weights, bias, place)
}

/// The same in code for any CPU.
fn portable_tile<const V: usize>(map: &Pairs, weights: &[u32], bias: &[f32], place: usize) -> Sums<V> {
    let mut sums: Sums<V> = std::array::from_fn(|output| [[bias[output]; LANES]; V]);
    vectorised(
        #[inline(always)]
        || {
            for (plane, weights) in map
                .values
                .chunks_exact(map.plane)
                .zip(weights.chunks_exact(TAPS * TILE))
            {
                for (tap, weights) in weights.chunks_exact(TILE).enumerate() {
                    let values = &plane[place + tap / 3 * map.stride + tap % 3..][..V * LANES];
                    for (sums, &weight) in sums.iter_mut().zip(weights) {
                        for (sums, values) in sums.iter_mut().zip(values.chunks_exact(LANES)) {
                            multiply_add(weight, values, sums);
                        }
                    }
                }
            }
        },
    );
    sums
}

/// The tile by `vdpbf16ps`.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod x86 {
    use std::arch::x86_64::{
        _mm512_dpbf16_ps, _mm512_loadu_si512, _mm512_set1_epi32, _mm512_set1_ps, _mm512_setzero_si512, _mm512_storeu_ps,
    };

    use super::{LANES, Pairs, Sums, TAPS, TILE};
    use crate::bf16::{as_pairs, is_available};
    use crate::tile::for_rows;

    /// Repeats code for every channel of a tile, as [`for_rows`] does for rows.
    macro_rules! for_channels {
        (|$channel:ident| $body:block) => {
            for_rows!(@ $channel $body 0 1 2 3 4 5 6 7)
        };
    }

    /// Sums one tile; only where [`is_available`].
    pub(crate) fn tile<const V: usize>(map: &Pairs, weights: &[u32], bias: &[f32], place: usize) -> Sums<V> {
        assert!(is_available() && bias.len() >= TILE);
        assert!(place + 2 * map.stride + 2 + V * LANES <= map.plane);
        assert!(weights.len() / (TAPS * TILE) * map.plane <= map.values.len());
        let mut sums = [[[0.0; LANES]; V]; TILE];
        // SAFETY: the features are there, and the last values that a tile reads lie in the map (asserted above).
        unsafe { fill(map, weights, bias, place, &mut sums) };
        sums
    }

    /// # Safety
    /// Every plane of the map that weights belong to holds `V` vectors at all taps from `place` on.
    #[target_feature(enable = "avx512f,avx512bf16")]
    unsafe fn fill<const V: usize>(map: &Pairs, weights: &[u32], bias: &[f32], place: usize, sums: &mut Sums<V>) {
        let mut total = [[_mm512_set1_ps(0.0); V]; TILE];
        for_channels!(|CHANNEL| {
            total[CHANNEL] = [_mm512_set1_ps(bias[CHANNEL]); V];
        });
        for (pair, weights) in weights.chunks_exact(TAPS * TILE).enumerate() {
            let plane = &map.values[pair * map.plane..][..map.plane];
            for (tap, weights) in weights.as_chunks::<TILE>().0.iter().enumerate() {
                let first = place + tap / 3 * map.stride + tap % 3;
                let mut values = [as_pairs(_mm512_setzero_si512()); V];
                for vector in 0..V {
                    // SAFETY: the vector lies in the plane, as the caller promises.
                    let bits = unsafe { _mm512_loadu_si512(plane.as_ptr().add(first + vector * LANES).cast()) };
                    values[vector] = as_pairs(bits);
                }
                for_channels!(|CHANNEL| {
                    let weight = as_pairs(_mm512_set1_epi32(weights[CHANNEL].cast_signed()));
                    for vector in 0..V {
                        total[CHANNEL][vector] = _mm512_dpbf16_ps(total[CHANNEL][vector], weight, values[vector]);
                    }
                });
            }
        }
        for_channels!(|CHANNEL| {
            for vector in 0..V {
                // SAFETY: sixteen sums.
                unsafe { _mm512_storeu_ps(sums[CHANNEL][vector].as_mut_ptr(), total[CHANNEL][vector]) };
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;
    use crate::{Conv3x3, Precision};

    #[test]
    fn equals_the_f32_kernel_on_rounded_numbers() {
        let rounded = |values: Vec<f32>| -> Vec<f32> {
            let round = |value| half::bf16::from_f32(value).to_f32();
            values.into_iter().map(round).collect()
        };
        for (inputs, outputs, height, width) in [
            (1, 1, 1, 1),
            (3, 5, 4, 7),
            (2, 8, 19, 33),
            (5, 12, 3, 64),
            (6, 9, 37, 81),
        ] {
            let input = rounded(noise(2 * inputs * height * width, 1));
            let (weight, bias) = (rounded(noise(outputs * inputs * TAPS, 2)), noise(outputs, 3));
            let run = |precision| {
                let conv = Conv3x3::new(&weight, &bias, outputs, inputs, precision);
                conv.run(&input, [height, width], false, None)
            };
            for (a, b) in run(Precision::Bf16).iter().zip(run(Precision::F32)) {
                assert!(
                    (a - b).abs() < 1e-5,
                    "{inputs} -> {outputs} at {height} x {width}: {a} {b}"
                );
            }
        }
    }

    #[test]
    fn the_instruction_and_the_portable_code_give_the_same_bits() {
        let (inputs, rows, width) = (5, 3, 40);
        let mut source = Band::new(inputs, rows, width);
        source.fill(|channel, row, out| out.copy_from_slice(&noise(width, 10 * channel + row)));
        let (map, weights) = (Pairs::new(&source), pack(&noise(TILE * inputs * TAPS, 2), TILE, inputs));
        let bias = noise(TILE, 3);
        for place in [0, 16, map.stride + 7] {
            let bits = |sums: Sums<2>| sums.map(|sums| sums.map(|sums| sums.map(f32::to_bits)));
            let (found, expected) = (
                tile(&map, &weights, &bias, place),
                portable_tile(&map, &weights, &bias, place),
            );
            assert_eq!(bits(found), bits(expected));
        }
    }
}
