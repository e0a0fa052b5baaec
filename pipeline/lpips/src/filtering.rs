//! 3x3 convolution with stride 1, zero padding, bias and ReLU by minimal filtering of tiles.
//!
//! Inputs of a tile are transformed (each channel by itself), meet the transformed weights in one matrix product over the
//! channels for each point of the transform, and are transformed back. F(4x4, 3x3) needs a quarter of the direct sum's
//! products. Where the weights outweigh the image, F(2x2, 3x3) is taken, whose transformed weights are less than half.
//!
//! Work is cut by the layer's sizes alone and every output is one sum in a fixed order: the bytes are the same for any
//! number of threads.

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::{Mutex, OnceLock, PoisonError};

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::maps::{Maps, PANEL, Pixel, resized};
use crate::product::Product;
use crate::tiling::{Four, Tiling, Two};
use crate::weights::ConvolutionWeights;

/// Images with fewer pixels than this take the smaller tiles.
const SMALL_IMAGE: usize = 300;
/// Tiles that are transformed together, so that their values stay in the second-level cache: at most these many values.
const WINDOW_PIXELS: usize = 4 << 10;
/// Layers with larger transformed weights (in values) are cut by output channels instead of rows, to read weights once.
const LARGE_WEIGHTS: usize = 4 << 20;

/// The convolution with both forms of its weights; a form is made when the first image of its size comes.
#[derive(Debug)]
pub(super) struct Filtering {
    inputs: usize,
    outputs: usize,
    weight: Vec<f32>,
    bias: Vec<Pixel>,
    two: OnceLock<Vec<Pixel>>,
    four: OnceLock<Vec<Pixel>>,
}

impl Filtering {
    pub(super) fn new(own: &ConvolutionWeights) -> Self {
        Self {
            inputs: own.inputs,
            outputs: own.outputs,
            weight: own.weight.clone(),
            bias: panels(&own.bias),
            two: OnceLock::new(),
            four: OnceLock::new(),
        }
    }

    /// The layer of `input`, into `output`.
    pub(super) fn run(&self, input: &Maps, output: &mut Maps, scratch: &Scratch) {
        output.reshape(self.bias.len(), input.height, input.width);
        if input.height * input.width < SMALL_IMAGE {
            let weights = self.two.get_or_init(|| self.transformed::<Two, 2, 4>());
            self.run_tiled::<Two, 2, 4>(weights, input, output, scratch);
        } else {
            let weights = self.four.get_or_init(|| self.transformed::<Four, 4, 6>());
            self.run_tiled::<Four, 4, 6>(weights, input, output, scratch);
        }
    }

    /// Transformed weights. `[output panels][REACH * REACH][input panels * PANEL]`
    fn transformed<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize>(&self) -> Vec<Pixel> {
        let padded = self.inputs.next_multiple_of(PANEL);
        let per_panel = REACH * REACH * padded;
        let mut transformed = vec![Pixel::ZERO; self.bias.len() * per_panel];
        let matrix = T::kernel();
        transformed
            .par_chunks_exact_mut(per_panel)
            .enumerate()
            .for_each(|(panel, transformed)| {
                for output in panel * PANEL..self.outputs.min((panel + 1) * PANEL) {
                    for input in 0..self.inputs {
                        let kernel = &self.weight[(output * self.inputs + input) * 9..][..9];
                        for point in 0..REACH * REACH {
                            let (row, column) = (&matrix[point / REACH], &matrix[point % REACH]);
                            let terms = (0..9).map(|tap| row[tap / 3] * f64::from(kernel[tap]) * column[tap % 3]);
                            let sum: f64 = terms.sum();
                            transformed[point * padded + input].0[output % PANEL] = sum as f32;
                        }
                    }
                }
            });
        transformed
    }

    fn run_tiled<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize>(
        &self,
        weights: &[Pixel],
        input: &Maps,
        output: &mut Maps,
        scratch: &Scratch,
    ) {
        let arch = Arch::new();
        let points = REACH * REACH;
        let (tile_rows, tile_columns) = (input.height.div_ceil(SIDE), input.width.div_ceil(SIDE));
        let per_panel = weights.len() / self.bias.len();
        // The products of one output panel over some tiles, and their way back into pixels.
        let panel = |panel: usize, window: &Window, values: &[Pixel], out: &mut [Pixel], (columns, width, height)| {
            let tiles = window.tiles();
            scratch.lend(points * tiles, |products| {
                let weights = &weights[panel * per_panel..][..per_panel];
                let by_point = weights
                    .chunks_exact(per_panel / points)
                    .zip(products.chunks_exact_mut(tiles));
                for (point, (weights, out)) in by_point.enumerate() {
                    arch.dispatch(Product {
                        values: &values[point * tiles..],
                        stride: points * tiles,
                        weights,
                        out,
                    });
                }
                arch.dispatch(Outputs::<T, SIDE, REACH> {
                    products,
                    window,
                    bias: &self.bias[panel],
                    out,
                    columns,
                    width,
                    height,
                    tiling: PhantomData,
                });
            });
        };
        let transform = |panel: usize, window: &Window, out: &mut [Pixel]| {
            arch.dispatch(Inputs::<T, SIDE, REACH> {
                plane: &input.values()[panel * input.plane()..][..input.plane()],
                columns: input.columns,
                window,
                out,
                tiling: PhantomData,
            });
        };
        let (columns, width, height) = (output.columns, output.width, output.height);
        if weights.len() * PANEL > LARGE_WEIGHTS {
            let window = Window {
                rows: 0..tile_rows,
                columns: 0..tile_columns,
            };
            let (tiles, plane) = (window.tiles(), output.plane());
            scratch.lend(input.panels * points * tiles, |values| {
                values
                    .par_chunks_exact_mut(points * tiles)
                    .enumerate()
                    .for_each(|(panel, values)| transform(panel, &window, values));
                let planes = output.values_mut().par_chunks_exact_mut(plane).enumerate();
                planes.for_each(|(index, plane)| {
                    panel(index, &window, values, &mut plane[columns..], (columns, width, height));
                });
            });
            return;
        }
        let at_once = (WINDOW_PIXELS / (input.panels * points)).max(1);
        let pieces = tile_columns.div_ceil(at_once);
        let bands = output.bands(SIDE);
        bands.into_par_iter().enumerate().for_each(|(row, mut band)| {
            for piece in 0..pieces {
                let window = Window {
                    rows: row..row + 1,
                    columns: piece * tile_columns / pieces..(piece + 1) * tile_columns / pieces,
                };
                let tiles = window.tiles();
                scratch.lend(input.panels * points * tiles, |values| {
                    for (panel, values) in values.chunks_exact_mut(points * tiles).enumerate() {
                        transform(panel, &window, values);
                    }
                    let own = Window {
                        rows: 0..1,
                        columns: window.columns.clone(),
                    };
                    for (index, out) in band.iter_mut().enumerate() {
                        panel(index, &own, values, out, (columns, width, height - row * SIDE));
                    }
                });
            }
        });
    }
}

/// Values by channel as panels, the rest of the last one zero.
pub(super) fn panels(values: &[f32]) -> Vec<Pixel> {
    let panel = |values: &[f32]| {
        let mut own = Pixel::ZERO;
        own.0[..values.len()].copy_from_slice(values);
        own
    };
    values.chunks(PANEL).map(panel).collect()
}

/// Some tiles of a layer.
struct Window {
    rows: Range<usize>,
    columns: Range<usize>,
}

impl Window {
    fn tiles(&self) -> usize {
        self.rows.len() * self.columns.len()
    }
}

/// Buffers that are used again, because fresh memory has to be cleared page by page.
#[derive(Debug, Default)]
pub(super) struct Scratch(Mutex<Vec<Vec<Pixel>>>);

impl Scratch {
    /// Lends a buffer of that length, with values of no meaning.
    pub(super) fn lend<R>(&self, length: usize, work: impl FnOnce(&mut [Pixel]) -> R) -> R {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let free = {
            let mut kept = lock();
            // The smallest that is large enough, or else the largest.
            let fitting = (0..kept.len())
                .filter(|&own| kept[own].len() >= length)
                .min_by_key(|&own| kept[own].len());
            let taken = fitting.or_else(|| (0..kept.len()).max_by_key(|&own| kept[own].len()));
            taken.map(|own| kept.swap_remove(own))
        };
        let mut buffer = free.unwrap_or_default();
        let result = work(resized(&mut buffer, length));
        lock().push(buffer);
        result
    }
}

/// The inputs of some tiles of one panel, transformed. `out [REACH * REACH][tiles]`
struct Inputs<'a, T, const SIDE: usize, const REACH: usize> {
    plane: &'a [Pixel],
    columns: usize,
    window: &'a Window,
    out: &'a mut [Pixel],
    tiling: PhantomData<T>,
}

impl<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize> WithSimd for Inputs<'_, T, SIDE, REACH> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let tiles = self.window.tiles();
        let mut tile = 0;
        for tile_row in self.window.rows.clone() {
            for tile_column in self.window.columns.clone() {
                let corner = tile_row * SIDE * self.columns + tile_column * SIDE;
                let rows: [&[Pixel]; REACH] =
                    std::array::from_fn(|row| &self.plane[corner + row * self.columns..][..REACH]);
                let out: [&mut [Pixel]; REACH] = {
                    let mut rest = &mut self.out[..];
                    std::array::from_fn(|_| {
                        let (own, others) = std::mem::take(&mut rest).split_at_mut(REACH * tiles);
                        rest = others;
                        own
                    })
                };
                for first in (0..PANEL).step_by(S::F32_LANES) {
                    let mut half = [[simd.splat_f32s(0.0); REACH]; REACH];
                    for column in 0..REACH {
                        let d = std::array::from_fn(|row| load(simd, &rows[row][column], first));
                        let transformed = T::inputs(simd, d);
                        for row in 0..REACH {
                            half[row][column] = transformed[row];
                        }
                    }
                    for row in 0..REACH {
                        let transformed = T::inputs(simd, half[row]);
                        for column in 0..REACH {
                            store(simd, &mut out[row][column * tiles + tile], first, transformed[column]);
                        }
                    }
                }
                tile += 1;
            }
        }
    }
}

/// The way back: bias, ReLU and the pixels of some tiles of one panel. `products [REACH * REACH][tiles]`
struct Outputs<'a, T, const SIDE: usize, const REACH: usize> {
    products: &'a [Pixel],
    window: &'a Window,
    bias: &'a Pixel,
    /// Rows of `columns` pixels from the window's row 0 on, with the border's pixel first.
    out: &'a mut [Pixel],
    columns: usize,
    /// Pixels of the image in a row, and rows below the first of `out`.
    width: usize,
    height: usize,
    tiling: PhantomData<T>,
}

impl<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize> WithSimd for Outputs<'_, T, SIDE, REACH> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let tiles = self.window.tiles();
        let zero = simd.splat_f32s(0.0);
        let mut tile = 0;
        for tile_row in self.window.rows.clone() {
            for tile_column in self.window.columns.clone() {
                let (top, left) = (tile_row * SIDE, tile_column * SIDE);
                let (rows, columns) = (SIDE.min(self.height - top), SIDE.min(self.width - left));
                for first in (0..PANEL).step_by(S::F32_LANES) {
                    let bias = load(simd, self.bias, first);
                    let mut half = [[zero; REACH]; SIDE];
                    for column in 0..REACH {
                        let m = std::array::from_fn(|row| {
                            load(simd, &self.products[(row * REACH + column) * tiles + tile], first)
                        });
                        let transformed = T::outputs(simd, m);
                        for row in 0..SIDE {
                            half[row][column] = transformed[row];
                        }
                    }
                    for row in 0..rows {
                        let transformed = T::outputs(simd, half[row]);
                        let start = (top + row) * self.columns + left + 1;
                        for (pixel, &sum) in self.out[start..][..columns].iter_mut().zip(&transformed) {
                            store(simd, pixel, first, simd.max_f32s(simd.add_f32s(sum, bias), zero));
                        }
                    }
                }
                tile += 1;
            }
        }
    }
}

#[inline(always)]
fn load<S: Simd>(_: S, pixel: &Pixel, first: usize) -> S::f32s {
    S::as_simd_f32s(&pixel.0[first..first + S::F32_LANES]).0[0]
}

#[inline(always)]
fn store<S: Simd>(_: S, pixel: &mut Pixel, first: usize, value: S::f32s) {
    S::as_mut_simd_f32s(&mut pixel.0[first..first + S::F32_LANES]).0[0] = value;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(count: usize, seed: usize) -> Vec<f32> {
        (0..count)
            .map(|k| ((k * 7919 + seed * 104_729) % 1009) as f32 / 504.5 - 1.0)
            .collect()
    }

    /// The definition, of `[C, H, W]` values.
    fn plain(own: &ConvolutionWeights, input: &[f32], height: usize, width: usize) -> Vec<f32> {
        let mut result = Vec::new();
        for output in 0..own.outputs {
            for row in 0..height {
                for column in 0..width {
                    let mut sum = f64::from(own.bias[output]);
                    for channel in 0..own.inputs {
                        for tap in 0..9 {
                            let (y, x) = ((row + tap / 3).wrapping_sub(1), (column + tap % 3).wrapping_sub(1));
                            if y < height && x < width {
                                let weight = own.weight[(output * own.inputs + channel) * 9 + tap];
                                sum += f64::from(weight) * f64::from(input[(channel * height + y) * width + x]);
                            }
                        }
                    }
                    result.push(sum.max(0.0) as f32);
                }
            }
        }
        result
    }

    /// Worst error of one layer against the definition, and the bits of its values.
    fn run(inputs: usize, outputs: usize, height: usize, width: usize, threads: usize) -> (f32, Vec<u32>) {
        let own = ConvolutionWeights {
            inputs,
            outputs,
            weight: noise(inputs * outputs * 9, 2),
            bias: noise(outputs, 3),
        };
        let input = noise(inputs * height * width, 1);
        let (mut maps, mut found) = (Maps::default(), Maps::default());
        maps.reshape(inputs.div_ceil(PANEL), height, width);
        for (row, mut band) in maps.bands(1).into_iter().enumerate() {
            for (panel, pixels) in band.iter_mut().enumerate() {
                for (column, pixel) in pixels[1..=width].iter_mut().enumerate() {
                    for (lane, value) in pixel.0.iter_mut().enumerate() {
                        let at = ((panel * PANEL + lane) * height + row) * width + column;
                        *value = input.get(at).copied().unwrap_or(0.0);
                    }
                }
            }
        }
        let (filtering, scratch) = (Filtering::new(&own), Scratch::default());
        // Buffers full of what earlier layers left.
        found.reshape(3, 2 * height, 2 * width);
        found.values_mut().fill(Pixel([f32::NAN; PANEL]));
        scratch.lend(100, |buffer| buffer.fill(Pixel([f32::NAN; PANEL])));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| filtering.run(&maps, &mut found, &scratch));
        let expected = plain(&own, &input, height, width);
        let mut worst = 0.0f32;
        for (at, expected) in expected.iter().enumerate() {
            let (channel, row, column) = (at / (height * width), at / width % height, at % width);
            worst = worst.max((found.row(channel / PANEL, row)[column].0[channel % PANEL] - expected).abs());
        }
        let border = |pixels: &[Pixel]| pixels.iter().all(|pixel| *pixel == Pixel::ZERO);
        for plane in found.values().chunks_exact(found.plane()) {
            for (row, pixels) in plane.chunks_exact(found.columns).enumerate() {
                let inside = (1..=height).contains(&row);
                assert!(border(&pixels[..1]) && border(&pixels[width + 1..]) && (inside || border(pixels)));
            }
        }
        let bits = found.values().iter().flat_map(|pixel| pixel.0.map(f32::to_bits));
        (worst, bits.collect())
    }

    #[test]
    fn equals_the_definition_at_odd_sizes_for_any_number_of_threads() {
        // Both tile sizes, one and several panels, images in pieces, and (the last two) layers cut by output channels.
        for (inputs, outputs, height, width) in [
            (1, 1, 16, 16),
            (3, 5, 17, 33),
            (40, 33, 19, 35),
            (2, 70, 3, 150),
            (36, 8, 9, 300),
            (70, 40, 1, 2),
            (512, 256, 18, 17),
            (600, 450, 3, 4),
        ] {
            let bound = 2e-6 * (9 * inputs + 1) as f32;
            let (worst, bits) = run(inputs, outputs, height, width, 1);
            assert!(worst < bound, "{inputs} -> {outputs} at {height}x{width}: {worst}");
            assert!(bits == run(inputs, outputs, height, width, 3).1);
        }
    }
}
