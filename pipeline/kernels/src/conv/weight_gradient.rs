//! The gradient of the weights of a 3x3 convolution.
//!
//! For a row of taps, sums of products of the result's gradient with the input at three columns lie in registers, for a few
//! outputs and inputs at a time, while both maps are read once. Nothing is copied but a padded image.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::band::across;
use super::weight_pairs;
use super::weight_tile::{INPUTS, OUTPUTS, SIDE, Sums, Tile};
use crate::{Precision, bf16, bf16_is_fast};

/// Numbers of the widest vector of any instruction set, for padding.
const MAX_LANES: usize = 32;
/// Tiles of a task.
const TILES: usize = 8;
/// Pixels that are summed in one go in f32, as far as one image has not more.
const PIXELS: usize = 4096;

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
    /// Whether the input goes through a ReLU first.
    pub rectify: bool,
    /// Numbers that products are made of.
    pub products: Precision,
}

/// Sums over images and pixels: those of small images in one go, then group by group. `gradient [B, out, H, W]`,
/// `input [B, in, H, W]`; `[out, in, 3, 3]`
pub fn weight_gradient(gradient: &[f32], input: &[f32], maps: Maps) -> Vec<f32> {
    let Maps { inputs, outputs, .. } = maps;
    let area = maps.height * maps.width;
    let mut sums = vec![0.0f64; outputs * inputs * SIDE * SIDE];
    let images = gradient.len() / (outputs * area).max(1);
    let groups = images.div_ceil((PIXELS / area.max(1)).max(1));
    let across = inputs.div_ceil(INPUTS);
    for group in 0..groups {
        let group = group * images / groups..(group + 1) * images / groups;
        let sheet = Sheet::new(group.len(), [maps.height, maps.width]);
        let of = |channels: usize| group.start * channels * area..group.end * channels * area;
        let (gradient, input) = (&gradient[of(outputs)], &input[of(inputs)]);
        let seen = |value: f32| if maps.rectify { value.max(0.0) } else { value };
        let tiles = match maps.products {
            Precision::F32 => {
                let gradient = Padded::new(gradient, outputs, &sheet, [0, 0], |value| value);
                let input = Padded::new(input, inputs, &sheet, [1, 2], seen);
                tiles(&gradient, &input, maps, &sheet, |tile| Arch::new().dispatch(tile))
            }
            Precision::Bf16 if bf16_is_fast() => {
                let gradient = Padded::new(gradient, outputs, &sheet, [0, 0], weight_pairs::number);
                let input = Padded::new(input, inputs, &sheet, [1, 2], |value| weight_pairs::number(seen(value)));
                tiles(&gradient, &input, maps, &sheet, weight_pairs::sums)
            }
            Precision::Bf16 => {
                // Of what lies one pair further a whole vector is read.
                let mut gradient = Padded::new(gradient, outputs, &sheet, [0, 0], bf16::nearest);
                let mut input = Padded::new(input, inputs, &sheet, [1, MAX_LANES], |value| {
                    bf16::nearest(seen(value))
                });
                gradient.part();
                input.part();
                tiles(&gradient, &input, maps, &sheet, weight_pairs::rounded_sums)
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

/// Images side by side and below each other, with a row or a column of zeros between them: one larger image, whose sums are
/// those of all.
struct Sheet {
    /// Rows and columns of an image.
    image: [usize; 2],
    /// Images in a row.
    across: usize,
    /// Rows and columns of all.
    size: [usize; 2],
}

impl Sheet {
    /// As many images in a row as fill vectors best.
    fn new(images: usize, image: [usize; 2]) -> Self {
        let [height, width] = image;
        let across = across(images, width);
        Self {
            image,
            across,
            size: [images.div_ceil(across) * (height + 1) - 1, across * (width + 1) - 1],
        }
    }
}

/// The sums of all tiles of a sheet.
fn tiles<T: Sync>(
    gradient: &Padded<T>,
    input: &Padded<T>,
    maps: Maps,
    sheet: &Sheet,
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
                size: sheet.size,
            })
        })
        .collect()
}

/// The planes of a sheet with zeros around: `margin` rows and columns before and after, and what whole vectors read beyond
/// the last column.
struct Padded<T> {
    values: Vec<T>,
    plane: usize,
    stride: usize,
}

impl<T: Copy + Default + Send> Padded<T> {
    /// `images [B, channels, H, W]`; rows have `beyond` numbers more than whole vectors, at least twice the margin.
    fn new(
        images: &[f32],
        channels: usize,
        sheet: &Sheet,
        [margin, beyond]: [usize; 2],
        number: impl Fn(f32) -> T + Sync,
    ) -> Self {
        let ([height, width], [rows, columns]) = (sheet.image, sheet.size);
        let stride = columns.next_multiple_of(MAX_LANES) + beyond;
        let plane = (rows + 2 * margin) * stride;
        let mut values = vec![T::default(); channels * plane];
        values
            .par_chunks_mut(plane.max(1))
            .enumerate()
            .for_each(|(channel, plane)| {
                let images = images
                    .chunks_exact((height * width).max(1))
                    .skip(channel)
                    .step_by(channels);
                for (image, values) in images.enumerate() {
                    let (row, column) = (image / sheet.across * (height + 1), image % sheet.across * (width + 1));
                    let rows = plane.chunks_exact_mut(stride).skip(margin + row);
                    for (out, values) in rows.zip(values.chunks_exact(width.max(1))) {
                        let out = out[margin + column..].iter_mut();
                        out.zip(values).for_each(|(out, &value)| *out = number(value));
                    }
                }
            });
        Self { values, plane, stride }
    }
}

impl Padded<f32> {
    /// Puts the second numbers of all pairs of a row behind the first ones.
    fn part(&mut self) {
        let half = self.stride / 2;
        self.values.par_chunks_mut((self.stride * 64).max(1)).for_each(|rows| {
            let mut parted = vec![0.0f32; 2 * half];
            for row in rows.chunks_exact_mut(2 * half) {
                let (first, second) = parted.split_at_mut(half);
                for ((first, second), pair) in first.iter_mut().zip(second).zip(row.as_chunks::<2>().0) {
                    [*first, *second] = *pair;
                }
                row.copy_from_slice(&parted);
            }
        });
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
