//! 3x3 convolution with stride 1 and padding 1, as direct sums over register tiles.
//!
//! A task computes a band of output rows. Its input rows lie in a zero-padded buffer that stays in the second-level cache;
//! a tile of 8 output channels by up to 3 vectors is summed over all inputs without leaving the registers.

use pulp::{Arch, Simd, WithSimd};

use super::band::{Band, Bands, TILE, across, band_rows, for_channels};
use super::pairs;
use crate::{Precision, bf16, bf16_is_fast};

/// Weights laid out for the tiles, and what goes with them.
#[derive(Debug)]
pub struct Conv3x3 {
    weights: Weights,
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
}

#[derive(Debug)]
enum Weights {
    /// `[tiles][inputs][9][TILE]`
    Single(Vec<f32>),
    /// As [`pairs`] takes them.
    Pairs(Vec<u32>),
    /// Rounded to bfloat16, of each pair of inputs the second one first: as [`pairs`] sums them, in products of f32.
    /// `[tiles][pairs of inputs][9][2][TILE]`
    Rounded(Vec<f32>),
}

/// Weights for f32 tiles of rounded numbers.
fn pack_rounded(weight: &[f32], outputs: usize, inputs: usize) -> Vec<f32> {
    let of_tile = inputs.next_multiple_of(2) * 9 * TILE;
    let mut weights = vec![0.0; outputs.div_ceil(TILE) * of_tile];
    for output in 0..outputs {
        let tile = &mut weights[output / TILE * of_tile..][..of_tile];
        for (place, &value) in weight[output * inputs * 9..][..inputs * 9].iter().enumerate() {
            let (input, tap) = (place / 9, place % 9);
            let half = (input / 2 * 9 + tap) * 2 + 1 - input % 2;
            tile[half * TILE + output % TILE] = bf16::nearest(value);
        }
    }
    weights
}

/// Weights for the f32 tiles.
fn pack(weight: &[f32], outputs: usize, inputs: usize) -> Vec<f32> {
    let mut weights = vec![0.0; outputs.div_ceil(TILE) * inputs * 9 * TILE];
    for output in 0..outputs {
        let tile = &mut weights[(output / TILE) * inputs * 9 * TILE..][..inputs * 9 * TILE];
        for (tap, &value) in weight[output * inputs * 9..][..inputs * 9].iter().enumerate() {
            tile[tap * TILE + output % TILE] = value;
        }
    }
    weights
}

impl Conv3x3 {
    /// From PyTorch's layout. `weight [out, in, 3, 3]`, `bias [out]` or empty
    pub fn new(weight: &[f32], bias: &[f32], outputs: usize, inputs: usize, precision: Precision) -> Self {
        let mut padded = bias.to_vec();
        padded.resize(outputs.div_ceil(TILE) * TILE, 0.0);
        Self {
            weights: match precision {
                Precision::F32 => Weights::Single(pack(weight, outputs, inputs)),
                Precision::Bf16 if bf16_is_fast() => Weights::Pairs(pairs::pack(weight, outputs, inputs)),
                Precision::Bf16 => Weights::Rounded(pack_rounded(weight, outputs, inputs)),
            },
            bias: padded,
            inputs,
            outputs,
        }
    }

    /// Convolves images; `rectify` applies a ReLU to the input first. `residual`, if any, has the shape of the output and is
    /// added at the end, its negative values as 0. `[B, in, H, W] -> [B, out, H, W]`
    pub fn run(&self, input: &[f32], size: [usize; 2], rectify: bool, residual: Option<&[f32]>) -> Vec<f32> {
        self.convolve(input, size, rectify, |place, values| {
            if let Some(residual) = residual {
                values
                    .iter_mut()
                    .zip(&residual[place..])
                    .for_each(|(value, &other)| *value += other.max(0.0));
            }
        })
    }

    /// Convolves gradients of what followed a ReLU of `gate`: 0 where the gate let nothing through.
    /// `[B, in, H, W] -> [B, out, H, W]`, `gate [B, out, H, W]`
    #[must_use]
    pub fn run_gated(&self, gradient: &[f32], size: [usize; 2], gate: &[f32]) -> Vec<f32> {
        self.convolve(gradient, size, false, |place, values| {
            for (value, &gate) in values.iter_mut().zip(&gate[place..]) {
                *value = if gate > 0.0 { *value } else { 0.0 };
            }
        })
    }

    /// Convolves images; `finish(place, values)` sees the rows of a channel of a band, whose first value has that place.
    fn convolve(
        &self,
        input: &[f32],
        [height, width]: [usize; 2],
        rectify: bool,
        finish: impl Fn(usize, &mut [f32]) + Sync,
    ) -> Vec<f32> {
        let area = height * width;
        let images = input.len() / (self.inputs * area).max(1);
        let across = across(images, width);
        let bands = Bands {
            images,
            channels: self.outputs,
            size: [height, width],
            rows: band_rows(self.inputs, across * (width + 1) - 1),
            across,
        };
        bands.run(|images, rows, planes| {
            let of_image = self.inputs * area;
            let channels = match self.weights {
                Weights::Single(_) => self.inputs,
                Weights::Pairs(_) | Weights::Rounded(_) => self.inputs.next_multiple_of(2),
            };
            let mut band = Band::new(channels, rows.len(), images.len() * (width + 1) - 1);
            band.fill(|channel, row, out| {
                let inside = |row: &usize| *row < height && channel < self.inputs;
                let Some(row) = (rows.start + row).checked_sub(1).filter(inside) else {
                    return;
                };
                for (image, out) in images.clone().zip(out.chunks_mut(width + 1)) {
                    let values = &input[image * of_image + channel * area + row * width..][..width];
                    let out = &mut out[..width];
                    if rectify {
                        out.iter_mut()
                            .zip(values)
                            .for_each(|(out, &value)| *out = value.max(0.0));
                    } else {
                        out.copy_from_slice(values);
                    }
                }
            });
            if let Weights::Rounded(_) = self.weights {
                band.round();
            }
            if images.len() == 1 {
                self.band(&band, planes);
            } else {
                self.apart(&band, width, planes);
            }
            let first = (images.start * self.outputs) * area + rows.start * width;
            for (plane, values) in planes.iter_mut().enumerate() {
                finish(first + plane * area, values);
            }
        })
    }

    /// Convolves a band of several images side by side into the rows of every output of each.
    fn apart(&self, band: &Band, width: usize, planes: &mut [&mut [f32]]) {
        let [rows, columns] = band.size();
        let mut sums = vec![0.0f32; self.outputs * rows * columns];
        let mut joined: Vec<&mut [f32]> = sums.chunks_exact_mut((rows * columns).max(1)).collect();
        self.band(band, &mut joined);
        for (plane, values) in planes.iter_mut().enumerate() {
            let (image, output) = (plane / self.outputs, plane % self.outputs);
            let own = joined[output].chunks_exact(columns.max(1));
            for (out, sums) in values.chunks_exact_mut(width.max(1)).zip(own) {
                out.copy_from_slice(&sums[image * (width + 1)..][..width]);
            }
        }
    }

    /// Convolves one band into the rows of every output.
    pub(crate) fn band(&self, band: &Band, planes: &mut [&mut [f32]]) {
        match &self.weights {
            Weights::Single(weights) => Arch::new().dispatch(BandKernel::<false> {
                weights,
                conv: self,
                band,
                planes,
            }),
            Weights::Rounded(weights) => Arch::new().dispatch(BandKernel::<true> {
                weights,
                conv: self,
                band,
                planes,
            }),
            Weights::Pairs(weights) => pairs::band(weights, &self.bias, band, planes),
        }
    }
}

/// `PAIRED`: two inputs at a time, the second one first.
struct BandKernel<'a, 'p, const PAIRED: bool> {
    weights: &'a [f32],
    conv: &'a Conv3x3,
    band: &'a Band,
    planes: &'a mut [&'p mut [f32]],
}

impl<const PAIRED: bool> WithSimd for BandKernel<'_, '_, PAIRED> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            weights,
            conv,
            band,
            planes,
        } = self;
        let [rows, width] = band.size();
        let vectors = width.div_ceil(S::F32_LANES);
        let inputs = if PAIRED {
            conv.inputs.next_multiple_of(2)
        } else {
            conv.inputs
        };
        let (tiles, biases) = (weights.chunks_exact(inputs * 9 * TILE), conv.bias.chunks_exact(TILE));
        for ((weights, bias), out) in tiles.zip(biases).zip(planes.chunks_mut(TILE)) {
            for row in 0..rows {
                let mut first = 0;
                while first < vectors {
                    let column = first * S::F32_LANES;
                    // 4 = 2 + 2 keeps more sums in flight than 3 + 1.
                    first += match vectors - first {
                        1 => tile::<S, 1, PAIRED>(simd, band, weights, bias, out, row, column),
                        2 | 4 => tile::<S, 2, PAIRED>(simd, band, weights, bias, out, row, column),
                        _ => tile::<S, 3, PAIRED>(simd, band, weights, bias, out, row, column),
                    };
                }
            }
        }
    }
}

/// Sums one tile of `TILE` channels by `V` vectors of one row; returns V.
// Plain indices: what goes through iterators or closures is kept in memory.
#[allow(clippy::needless_range_loop)]
#[inline(always)]
fn tile<S: Simd, const V: usize, const PAIRED: bool>(
    simd: S,
    band: &Band,
    weights: &[f32],
    bias: &[f32],
    out: &mut [&mut [f32]],
    row: usize,
    column: usize,
) -> usize {
    let mut sums = [[simd.splat_f32s(0.0); V]; TILE];
    for_channels!(|CHANNEL| {
        sums[CHANNEL] = [simd.splat_f32s(bias[CHANNEL]); V];
    });
    let (channel_stride, stride) = (band.plane(), band.stride());
    let span = V * S::F32_LANES;
    let together = if PAIRED { 2 } else { 1 };
    for (group, weights) in weights.chunks_exact(together * 9 * TILE).enumerate() {
        let rows = &band.values()[group * together * channel_stride + row * stride + column..];
        for ky in 0..3 {
            for kx in 0..3 {
                for half in 0..together {
                    let channel = together - 1 - half;
                    let read = &rows[channel * channel_stride + ky * stride + kx..][..span];
                    let (read, _) = S::as_simd_f32s(read);
                    let mut values = [simd.splat_f32s(0.0); V];
                    values.copy_from_slice(&read[..V]);
                    let Some(taps) = weights[((3 * ky + kx) * together + half) * TILE..].first_chunk::<TILE>() else {
                        return V;
                    };
                    for_channels!(|CHANNEL| {
                        let weight = simd.splat_f32s(taps[CHANNEL]);
                        for vector in 0..V {
                            sums[CHANNEL][vector] = simd.mul_add_f32s(weight, values[vector], sums[CHANNEL][vector]);
                        }
                    });
                }
            }
        }
    }
    let [_, width] = band.size();
    let valid = (width - column).min(span);
    for_channels!(|CHANNEL| {
        if let Some(plane) = out.get_mut(CHANNEL) {
            let row = &mut plane[row * width + column..][..valid];
            for vector in 0..V {
                let first = (vector * S::F32_LANES).min(valid);
                let last = (first + S::F32_LANES).min(valid);
                simd.partial_store_f32s(&mut row[first..last], sums[CHANNEL][vector]);
            }
        }
    });
    V
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;

    /// The definition.
    fn plain(
        input: &[f32],
        weight: &[f32],
        bias: &[f32],
        [inputs, outputs]: [usize; 2],
        [h, w]: [usize; 2],
    ) -> Vec<f32> {
        let mut result = Vec::new();
        for output in 0..outputs {
            for row in 0..h as isize {
                for column in 0..w as isize {
                    let mut sum = f64::from(bias[output]);
                    for input_channel in 0..inputs {
                        for (tap, (dy, dx)) in (0..9).map(|tap| (tap, (tap as isize / 3 - 1, tap as isize % 3 - 1))) {
                            let (y, x) = (row + dy, column + dx);
                            if (0..h as isize).contains(&y) && (0..w as isize).contains(&x) {
                                let value = input[(input_channel * h + y as usize) * w + x as usize];
                                sum +=
                                    f64::from(value) * f64::from(weight[(output * inputs + input_channel) * 9 + tap]);
                            }
                        }
                    }
                    result.push(sum as f32);
                }
            }
        }
        result
    }

    #[test]
    fn equals_the_definition_at_odd_sizes() {
        for (inputs, outputs, h, w) in [
            (1, 1, 1, 1),
            (3, 5, 4, 7),
            (2, 8, 19, 33),
            (5, 12, 3, 64),
            (16, 9, 37, 81),
        ] {
            let (input, weight, bias) = (
                noise(inputs * h * w, 1),
                noise(outputs * inputs * 9, 2),
                noise(outputs, 3),
            );
            let found = Conv3x3::new(&weight, &bias, outputs, inputs, Precision::F32).run(&input, [h, w], false, None);
            let expected = plain(&input, &weight, &bias, [inputs, outputs], [h, w]);
            for (a, b) in found.iter().zip(&expected) {
                assert!((a - b).abs() < 1e-4, "{inputs}x{outputs} at {h}x{w}: {a} {b}");
            }
            let rectified: Vec<f32> = input.iter().map(|value| value.max(0.0)).collect();
            let expected = plain(&rectified, &weight, &bias, [inputs, outputs], [h, w]);
            let residual = noise(expected.len(), 4);
            let found = Conv3x3::new(&weight, &bias, outputs, inputs, Precision::F32).run(
                &input,
                [h, w],
                true,
                Some(&residual),
            );
            for ((a, b), r) in found.iter().zip(&expected).zip(&residual) {
                assert!((a - (b + r.max(0.0))).abs() < 1e-4);
            }
        }
    }
}
