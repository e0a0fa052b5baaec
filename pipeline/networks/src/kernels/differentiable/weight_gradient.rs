//! The gradient of the weights of a 3x3 convolution.
//!
//! For a row of taps, sums of products of the result's gradient with the input at three columns lie in registers, for a few
//! outputs and inputs at a time, while both maps are read once. Nothing is copied but a padded image.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Outputs whose sums are in registers.
const OUTPUTS: usize = 4;
/// Inputs whose sums are in registers.
const INPUTS: usize = 2;
/// Columns of a row of taps, and rows of taps.
const SIDE: usize = 3;
/// Widest vector of any instruction set, for padding.
const MAX_LANES: usize = 16;
/// Tiles of a task.
const TILES: usize = 8;

/// Sizes of a call.
#[derive(Debug, Clone, Copy)]
pub(super) struct Maps {
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    pub(super) height: usize,
    pub(super) width: usize,
}

/// Sums over images and pixels, image by image. `gradient [B, out, H, W]`, `input [B, in, H, W]`; `[out, in, 3, 3]`
pub(super) fn weight_gradient(gradient: &[f32], input: &[f32], maps: Maps) -> Vec<f32> {
    let Maps {
        inputs,
        outputs,
        height,
        width,
    } = maps;
    let area = height * width;
    let mut sums = vec![0.0f64; outputs * inputs * SIDE * SIDE];
    let images = gradient
        .chunks_exact((outputs * area).max(1))
        .zip(input.chunks_exact((inputs * area).max(1)));
    let across = inputs.div_ceil(INPUTS);
    for (gradient, input) in images {
        let (gradient, input) = (Padded::new(gradient, maps, 0), Padded::new(input, maps, 1));
        let tiles: Vec<[[[f32; SIDE]; INPUTS]; OUTPUTS]> = (0..outputs.div_ceil(OUTPUTS) * across * SIDE)
            .into_par_iter()
            .with_min_len(TILES)
            .map(|tile| {
                let (first, row) = (
                    [tile / SIDE / across * OUTPUTS, tile / SIDE % across * INPUTS],
                    tile % SIDE,
                );
                // Channels beyond the last are the last one again; nobody reads their sums.
                let kernel = Tile {
                    gradient: std::array::from_fn(|k| gradient.plane((first[0] + k).min(outputs - 1))),
                    input: std::array::from_fn(|k| input.plane((first[1] + k).min(inputs - 1))),
                    strides: [gradient.stride, input.stride],
                    row,
                    size: [height, width],
                };
                Arch::new().dispatch(kernel)
            })
            .collect();
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

/// The planes of an image with zeros around: `margin` rows and columns, and what whole vectors read beyond the last column.
struct Padded {
    values: Vec<f32>,
    plane: usize,
    stride: usize,
}

impl Padded {
    fn new(image: &[f32], maps: Maps, margin: usize) -> Self {
        let Maps { height, width, .. } = maps;
        let stride = width.next_multiple_of(MAX_LANES) + 2 * margin;
        let plane = (height + 2 * margin) * stride;
        let mut values = vec![0.0f32; image.len() / (height * width).max(1) * plane];
        values
            .par_chunks_mut(plane.max(1))
            .zip(image.par_chunks((height * width).max(1)))
            .for_each(|(out, image)| {
                let rows = out.chunks_exact_mut(stride).skip(margin);
                for (out, row) in rows.zip(image.chunks_exact(width.max(1))) {
                    out[margin..margin + width].copy_from_slice(row);
                }
            });
        Self { values, plane, stride }
    }

    fn plane(&self, channel: usize) -> &[f32] {
        &self.values[channel * self.plane..][..self.plane]
    }
}

/// One row of taps of a few outputs and inputs.
struct Tile<'a> {
    gradient: [&'a [f32]; OUTPUTS],
    input: [&'a [f32]; INPUTS],
    strides: [usize; 2],
    row: usize,
    size: [usize; 2],
}

impl WithSimd for Tile<'_> {
    type Output = [[[f32; SIDE]; INPUTS]; OUTPUTS];

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
