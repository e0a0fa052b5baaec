//! 1x1 convolution of planar images, with or without a ReLU before it, and its gradients.
//!
//! A tile of 8 output channels by up to 3 vectors of pixels is summed over all inputs without leaving the registers.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::band::{Bands, TILE, for_channels};

/// Pixels of a task: what all channels of so many need fits the second-level cache.
const TASK_PIXELS: usize = 1024;
/// Outputs and inputs whose products are summed at a time.
const SIDES: [usize; 2] = [4, 6];

/// Weights laid out for the tiles, and what goes with them.
#[derive(Debug)]
pub struct Pointwise {
    /// `[tiles][inputs][TILE]`
    weights: Vec<f32>,
    /// `[tiles][TILE]`
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
}

impl Pointwise {
    /// `weight [out, in]`, `bias [out]` or empty.
    #[must_use]
    pub fn new(weight: &[f32], bias: &[f32], outputs: usize, inputs: usize) -> Self {
        Self::of(bias, outputs, inputs, |output, input| weight[output * inputs + input])
    }

    /// The convolution that takes gradients back. `weight [in, out]`
    #[must_use]
    pub fn turned(weight: &[f32], outputs: usize, inputs: usize) -> Self {
        Self::of(&[], outputs, inputs, |output, input| weight[input * outputs + output])
    }

    fn of(bias: &[f32], outputs: usize, inputs: usize, weight: impl Fn(usize, usize) -> f32) -> Self {
        let mut padded = bias.to_vec();
        padded.resize(outputs.div_ceil(TILE) * TILE, 0.0);
        let mut weights = vec![0.0; padded.len() * inputs];
        for output in 0..outputs {
            for input in 0..inputs {
                weights[(output / TILE * inputs + input) * TILE + output % TILE] = weight(output, input);
            }
        }
        Self {
            weights,
            bias: padded,
            inputs,
            outputs,
        }
    }

    /// Convolves images, or their positive parts if `rectify`; where there is a `gate` of the output's shape, the result is 0
    /// wherever that is not positive. `[B, in, H, W] -> [B, out, H, W]`
    #[must_use]
    pub fn run(&self, input: &[f32], size: [usize; 2], rectify: bool, gate: Option<&[f32]>) -> Vec<f32> {
        let [height, width] = size;
        let area = height * width;
        let bands = Bands {
            images: input.len() / (self.inputs * area).max(1),
            channels: self.outputs,
            size,
            rows: (TASK_PIXELS / width.max(1)).max(1),
            across: 1,
        };
        bands.run(|image, rows, planes| {
            let (image, first) = (image.start, rows.start * width);
            Arch::new().dispatch(Kernel {
                conv: self,
                input: &input[image * self.inputs * area..][..self.inputs * area],
                area,
                pixels: first..rows.end * width,
                rectify,
                planes,
            });
            for (channel, values) in planes.iter_mut().enumerate() {
                let place = (image * self.outputs + channel) * area + first;
                for (value, &gate) in values.iter_mut().zip(gate.map_or(&[][..], |gate| &gate[place..])) {
                    *value = if gate > 0.0 { *value } else { 0.0 };
                }
            }
        })
    }
}

struct Kernel<'a, 'p> {
    conv: &'a Pointwise,
    /// Of one image. `[in, area]`
    input: &'a [f32],
    area: usize,
    pixels: std::ops::Range<usize>,
    rectify: bool,
    /// Where the pixels go, of every output.
    planes: &'a mut [&'p mut [f32]],
}

impl WithSimd for Kernel<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Pointwise {
            weights, bias, inputs, ..
        } = self.conv;
        let tiles = weights.chunks_exact(inputs * TILE).zip(bias.chunks_exact(TILE));
        for ((weights, bias), planes) in tiles.zip(self.planes.chunks_mut(TILE)) {
            let mut first = self.pixels.start;
            while first < self.pixels.end {
                let place = Place {
                    input: self.input,
                    area: self.area,
                    first,
                    count: self.pixels.end - first,
                    column: first - self.pixels.start,
                    rectify: self.rectify,
                };
                first += match place.count.div_ceil(S::F32_LANES) {
                    1 => place.tile::<S, 1>(simd, weights, bias, planes),
                    2 | 4 => place.tile::<S, 2>(simd, weights, bias, planes),
                    _ => place.tile::<S, 3>(simd, weights, bias, planes),
                };
            }
        }
    }
}

/// Some pixels of an image.
#[derive(Clone, Copy)]
struct Place<'a> {
    input: &'a [f32],
    area: usize,
    first: usize,
    /// Pixels that are left.
    count: usize,
    /// Where they go.
    column: usize,
    rectify: bool,
}

impl Place<'_> {
    /// Sums a tile; returns its pixels.
    // Indices in plain loops: what takes a closure to an array is compiled apart from it, without vectors.
    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(self, simd: S, weights: &[f32], bias: &[f32], planes: &mut [&mut [f32]]) -> usize {
        let count = self.count.min(V * S::F32_LANES);
        let whole = count == V * S::F32_LANES;
        let floor = simd.splat_f32s(if self.rectify { 0.0 } else { f32::NEG_INFINITY });
        let mut sums = [[simd.splat_f32s(0.0); V]; TILE];
        for_channels!(|OUTPUT| {
            sums[OUTPUT] = [simd.splat_f32s(bias[OUTPUT]); V];
        });
        for (channel, weights) in weights.as_chunks::<TILE>().0.iter().enumerate() {
            let pixels = &self.input[channel * self.area + self.first..][..count];
            let mut values = [floor; V];
            if whole {
                let (vectors, _) = S::as_simd_f32s(pixels);
                values.copy_from_slice(&vectors[..V]);
            } else {
                for vector in 0..V {
                    let first = (vector * S::F32_LANES).min(count);
                    let last = (first + S::F32_LANES).min(count);
                    values[vector] = simd.partial_load_f32s(&pixels[first..last]);
                }
            }
            for vector in 0..V {
                values[vector] = simd.max_f32s(values[vector], floor);
            }
            for_channels!(|OUTPUT| {
                let weight = simd.splat_f32s(weights[OUTPUT]);
                for vector in 0..V {
                    sums[OUTPUT][vector] = simd.mul_add_f32s(weight, values[vector], sums[OUTPUT][vector]);
                }
            });
        }
        for_channels!(|OUTPUT| {
            if let Some(plane) = planes.get_mut(OUTPUT) {
                let pixels = &mut plane[self.column..][..count];
                for vector in 0..V {
                    let first = (vector * S::F32_LANES).min(count);
                    let last = (first + S::F32_LANES).min(count);
                    simd.partial_store_f32s(&mut pixels[first..last], sums[OUTPUT][vector]);
                }
            }
        });
        count
    }
}

/// The gradient of the weights of a 1x1 convolution, of the images' positive parts if `rectify`: sums over pixels, then over
/// images. `gradient [B, out, area]`, `input [B, in, area]`; `[out, in]`
#[must_use]
pub fn pointwise_gradient(
    gradient: &[f32],
    input: &[f32],
    [outputs, inputs]: [usize; 2],
    area: usize,
    rectify: bool,
) -> Vec<f32> {
    let mut sums = vec![0.0f64; outputs * inputs];
    let images = gradient
        .chunks_exact((outputs * area).max(1))
        .zip(input.chunks_exact((inputs * area).max(1)));
    let across = inputs.div_ceil(SIDES[1]);
    for (gradient, input) in images {
        let tiles: Vec<Products> = (0..outputs.div_ceil(SIDES[0]) * across)
            .into_par_iter()
            .map(|tile| {
                let first = [tile / across * SIDES[0], tile % across * SIDES[1]];
                // Channels beyond the last are the last one again; nobody reads their sums.
                let plane = |map, channel: usize, channels: usize| -> &[f32] {
                    let map: &[f32] = map;
                    &map[channel.min(channels - 1) * area..][..area]
                };
                Arch::new().dispatch(Tile {
                    gradient: std::array::from_fn(|k| plane(gradient, first[0] + k, outputs)),
                    input: std::array::from_fn(|k| plane(input, first[1] + k, inputs)),
                    rectify,
                })
            })
            .collect();
        for (tile, values) in tiles.iter().enumerate() {
            let first = [tile / across * SIDES[0], tile % across * SIDES[1]];
            for output in first[0]..(first[0] + SIDES[0]).min(outputs) {
                for input in first[1]..(first[1] + SIDES[1]).min(inputs) {
                    sums[output * inputs + input] += f64::from(values[output - first[0]][input - first[1]]);
                }
            }
        }
    }
    sums.into_iter().map(|sum| sum as f32).collect()
}

type Products = [[f32; SIDES[1]]; SIDES[0]];

/// Planes whose products are summed over all pixels.
struct Tile<'a> {
    gradient: [&'a [f32]; SIDES[0]],
    input: [&'a [f32]; SIDES[1]],
    rectify: bool,
}

impl WithSimd for Tile<'_> {
    type Output = Products;

    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Products {
        let floor = simd.splat_f32s(if self.rectify { 0.0 } else { f32::NEG_INFINITY });
        let mut sums = [[simd.splat_f32s(0.0); SIDES[1]]; SIDES[0]];
        let area = self.gradient[0].len();
        let vectors = area / S::F32_LANES;
        let mut gradient: [&[S::f32s]; SIDES[0]] = [&[]; SIDES[0]];
        for output in 0..SIDES[0] {
            gradient[output] = &S::as_simd_f32s(self.gradient[output]).0[..vectors];
        }
        let mut input: [&[S::f32s]; SIDES[1]] = [&[]; SIDES[1]];
        for channel in 0..SIDES[1] {
            input[channel] = &S::as_simd_f32s(self.input[channel]).0[..vectors];
        }
        for vector in 0..vectors {
            let mut values = [floor; SIDES[1]];
            for channel in 0..SIDES[1] {
                values[channel] = simd.max_f32s(input[channel][vector], floor);
            }
            for output in 0..SIDES[0] {
                let slope = gradient[output][vector];
                for channel in 0..SIDES[1] {
                    sums[output][channel] = simd.mul_add_f32s(slope, values[channel], sums[output][channel]);
                }
            }
        }
        let rest = vectors * S::F32_LANES;
        let mut totals = [[0.0; SIDES[1]]; SIDES[0]];
        for output in 0..SIDES[0] {
            for channel in 0..SIDES[1] {
                let mut sum = sums[output][channel];
                if rest < area {
                    let slope = simd.partial_load_f32s(&self.gradient[output][rest..]);
                    let value = simd.max_f32s(simd.partial_load_f32s(&self.input[channel][rest..]), floor);
                    sum = simd.mul_add_f32s(slope, value, sum);
                }
                totals[output][channel] = simd.reduce_sum_f32s(sum);
            }
        }
        totals
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;

    #[test]
    fn equals_the_definition_at_odd_sizes() {
        for (images, inputs, outputs, height, width) in [(1, 1, 1, 1, 1), (2, 3, 9, 5, 7), (3, 17, 12, 9, 150)] {
            let area = height * width;
            let (input, weight, bias) = (
                noise(images * inputs * area, 1),
                noise(outputs * inputs, 2),
                noise(outputs, 3),
            );
            let gate = noise(images * outputs * area, 4);
            let conv = Pointwise::new(&weight, &bias, outputs, inputs);
            let slopes = noise(images * outputs * area, 5);
            for rectify in [false, true] {
                let seen = |image: usize, channel: usize, pixel: usize| {
                    let value = f64::from(input[(image * inputs + channel) * area + pixel]);
                    if rectify { value.max(0.0) } else { value }
                };
                let found = conv.run(&input, [height, width], rectify, None);
                let gated = conv.run(&input, [height, width], rectify, Some(&gate));
                assert_eq!(found.len(), gate.len());
                for (place, (&found, gated)) in found.iter().zip(gated).enumerate() {
                    let (image, output, pixel) = (place / area / outputs, place / area % outputs, place % area);
                    let terms = (0..inputs)
                        .map(|channel| f64::from(weight[output * inputs + channel]) * seen(image, channel, pixel));
                    let expected = f64::from(bias[output]) + terms.sum::<f64>();
                    assert!((f64::from(found) - expected).abs() < 1e-5, "{found} {expected}");
                    assert_eq!(gated, if gate[place] > 0.0 { found } else { 0.0 });
                }
                let found = pointwise_gradient(&slopes, &input, [outputs, inputs], area, rectify);
                for (place, found) in found.into_iter().enumerate() {
                    let (output, channel) = (place / inputs, place % inputs);
                    let terms = (0..images * area).map(|k| {
                        let (image, pixel) = (k / area, k % area);
                        f64::from(slopes[(image * outputs + output) * area + pixel]) * seen(image, channel, pixel)
                    });
                    let expected: f64 = terms.sum();
                    assert!((f64::from(found) - expected).abs() < 2e-3, "{found} {expected}");
                }
            }
            let turned = Pointwise::turned(&weight, inputs, outputs).run(&slopes, [height, width], false, None);
            let back: f64 = turned.iter().zip(&input).map(|(a, b)| f64::from(a * b)).sum();
            let forth = Pointwise::new(&weight, &[], outputs, inputs).run(&input, [height, width], false, None);
            let forth: f64 = forth.iter().zip(&slopes).map(|(a, b)| f64::from(a * b)).sum();
            assert!((back - forth).abs() < 1e-3 * (1.0 + forth.abs()), "{back} {forth}");
        }
    }
}
