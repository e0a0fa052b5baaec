//! The gradient of the weights of a 3x3 convolution.
//!
//! For a row of taps, sums of products of the result's gradient with the input at three columns lie in registers, for a few
//! outputs and inputs at a time, while both maps are read once. Nothing is copied but a padded image.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::weight_pairs;
use super::weight_tile::{INPUTS, OUTPUTS, SIDE, Sums, Tile};
use crate::Precision;

/// Numbers of the widest vector of any instruction set, for padding.
const MAX_LANES: usize = 32;
/// Tiles of a task.
const TILES: usize = 8;

/// Sizes of a call.
#[derive(Debug, Clone, Copy)]
pub struct Maps {
    /// Channels of the input.
    pub inputs: usize,
    /// Channels of the result.
    pub outputs: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Numbers that products are made of.
    pub products: Precision,
}

/// Sums over images and pixels, image by image. `gradient [B, out, H, W]`, `input [B, in, H, W]`; `[out, in, 3, 3]`
pub fn weight_gradient(gradient: &[f32], input: &[f32], maps: Maps) -> Vec<f32> {
    let Maps { inputs, outputs, .. } = maps;
    let area = maps.height * maps.width;
    let mut sums = vec![0.0f64; outputs * inputs * SIDE * SIDE];
    let images = gradient
        .chunks_exact((outputs * area).max(1))
        .zip(input.chunks_exact((inputs * area).max(1)));
    let across = inputs.div_ceil(INPUTS);
    for (gradient, input) in images {
        let tiles = match maps.products {
            Precision::F32 => {
                let padded = |image, margin| Padded::new(image, maps, margin, |value| value);
                tiles(&padded(gradient, 0), &padded(input, 1), maps, |tile| {
                    Arch::new().dispatch(tile)
                })
            }
            Precision::Bf16 => {
                let padded = |image, margin| Padded::new(image, maps, margin, weight_pairs::number);
                tiles(&padded(gradient, 0), &padded(input, 1), maps, weight_pairs::sums)
            }
        };
        for (tile, values) in tiles.iter().enumerate() {
            let (first, row) = (
                [tile / SIDE / across * OUTPUTS, tile / SIDE % across * INPUTS],
                tile % SIDE,
            );
            for output in first[0]..(first[0] + OUTPUTS).min(outputs) {
                for input in first[1]..(first[1] + INPUTS).min(inputs) {
                    let place = ((output * inputs + input) * SIDE + row) * SIDE;
                    let values = values[output - first[0]][input - first[1]];
                    for (sum, value) in sums[place..place + SIDE].iter_mut().zip(values) {
                        *sum += f64::from(value);
                    }
                }
            }
        }
    }
    sums.into_iter().map(|sum| sum as f32).collect()
}

/// The sums of all tiles of an image.
fn tiles<T: Sync>(
    gradient: &Padded<T>,
    input: &Padded<T>,
    maps: Maps,
    sums: impl Fn(Tile<'_, T>) -> Sums + Sync,
) -> Vec<Sums> {
    let Maps { inputs, outputs, .. } = maps;
    let across = inputs.div_ceil(INPUTS);
    (0..outputs.div_ceil(OUTPUTS) * across * SIDE)
        .into_par_iter()
        .with_min_len(TILES)
        .map(|tile| {
            let first = [tile / SIDE / across * OUTPUTS, tile / SIDE % across * INPUTS];
            // Channels beyond the last are the last one again; nobody reads their sums.
            sums(Tile {
                gradient: std::array::from_fn(|k| gradient.plane((first[0] + k).min(outputs - 1))),
                input: std::array::from_fn(|k| input.plane((first[1] + k).min(inputs - 1))),
                strides: [gradient.stride, input.stride],
                row: tile % SIDE,
                size: [maps.height, maps.width],
            })
        })
        .collect()
}

/// The planes of an image with zeros around: `margin` rows and columns, and what whole vectors read beyond the last column.
struct Padded<T> {
    values: Vec<T>,
    plane: usize,
    stride: usize,
}

impl<T: Copy + Default + Send> Padded<T> {
    fn new(image: &[f32], maps: Maps, margin: usize, number: impl Fn(f32) -> T + Sync) -> Self {
        let Maps { height, width, .. } = maps;
        let stride = width.next_multiple_of(MAX_LANES) + 2 * margin;
        let plane = (height + 2 * margin) * stride;
        let mut values = vec![T::default(); image.len() / (height * width).max(1) * plane];
        values
            .par_chunks_mut(plane.max(1))
            .zip(image.par_chunks((height * width).max(1)))
            .for_each(|(out, image)| {
                let rows = out.chunks_exact_mut(stride).skip(margin);
                for (out, row) in rows.zip(image.chunks_exact(width.max(1))) {
                    (out[margin..].iter_mut().zip(row)).for_each(|(out, &value)| *out = number(value));
                }
            });
        Self { values, plane, stride }
    }
}

impl<T> Padded<T> {
    fn plane(&self, channel: usize) -> &[T] {
        &self.values[channel * self.plane..][..self.plane]
    }
}

impl WithSimd for Tile<'_, f32> {
    type Output = Sums;

    // Indices in plain loops: what takes a closure to an array is compiled apart from it, without vectors.
    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let [height, width] = self.size;
        let vectors = width.div_ceil(S::F32_LANES);
        let span = vectors * S::F32_LANES;
        let mut sums = [[[simd.splat_f32s(0.0); SIDE]; INPUTS]; OUTPUTS];
        for row in 0..height {
            let mut gradient: [&[S::f32s]; OUTPUTS] = [&[]; OUTPUTS];
            for output in 0..OUTPUTS {
                let values = &self.gradient[output][row * self.strides[0]..][..span];
                gradient[output] = &S::as_simd_f32s(values).0[..vectors];
            }
            let mut input: [[&[S::f32s]; SIDE]; INPUTS] = [[&[]; SIDE]; INPUTS];
            for channel in 0..INPUTS {
                let values = &self.input[channel][(row + self.row) * self.strides[1]..][..span + SIDE - 1];
                for tap in 0..SIDE {
                    input[channel][tap] = &S::as_simd_f32s(&values[tap..tap + span]).0[..vectors];
                }
            }
            for vector in 0..vectors {
                for output in 0..OUTPUTS {
                    let slope = gradient[output][vector];
                    for channel in 0..INPUTS {
                        for tap in 0..SIDE {
                            let sum = &mut sums[output][channel][tap];
                            *sum = simd.mul_add_f32s(slope, input[channel][tap][vector], *sum);
                        }
                    }
                }
            }
        }
        let mut totals = [[[0.0; SIDE]; INPUTS]; OUTPUTS];
        for output in 0..OUTPUTS {
            for channel in 0..INPUTS {
                for tap in 0..SIDE {
                    totals[output][channel][tap] = simd.reduce_sum_f32s(sums[output][channel][tap]);
                }
            }
        }
        totals
    }
}
