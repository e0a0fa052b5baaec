//! 3x3 convolution with stride 1 and zero padding by Winograd's algorithm, tile by tile.
//!
//! Inputs of a tile are transformed (each channel by itself), meet the transformed weights in one matrix product over the
//! channels for each point of the transform, and are transformed back. A window of tiles is worked on at a time, so that
//! its transformed values stay in the second-level cache.
//!
//! Work is cut by the layer's sizes alone and every output is one sum in a fixed order: the bytes are the same for any
//! number of threads.

use std::cell::Cell;
use std::marker::PhantomData;
use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::After;
use super::tiling::{Four, Tiling, Two};
use crate::product::product;
use crate::tile::{COLUMNS, Line, resized};
use crate::transpose::transposed;

/// Lines of a window's transformed values.
const WINDOW: usize = 6 << 10;

/// Layers with larger transformed weights (in values) are cut by output channels instead of rows, to read weights once.
const LARGE_WEIGHTS: usize = 4 << 20;

/// How large the tiles are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TileSize {
    /// F(2x2, 3x3): 4/9 of the direct sum's products, at no larger rounding error, as the transforms only add, subtract and
    /// halve. For features that decide which of two neighbours is the nearer one, as those of the networks do.
    Two,
    /// F(4x4, 3x3): a quarter of the direct sum's products, with errors of about 1e-5 of the features. For features that
    /// are only compared.
    Four,
}

/// What becomes of the sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Write {
    /// They replace what is there.
    Set,
    /// They replace what is there, negative ones as 0.
    Rectified,
    /// They are added to it.
    Add,
}

/// A 3x3 convolution with stride 1 and zero padding.
#[derive(Debug, Clone)]
pub struct Winograd {
    inputs: usize,
    outputs: usize,
    tiles: TileSize,
    /// Transformed weights. `[panels of outputs][points][inputs]`
    weights: Vec<Line>,
    /// `[panels of outputs]`
    bias: Vec<Line>,
}

impl Winograd {
    /// A convolution from PyTorch values: weight `[outputs, inputs, 3, 3]`, bias `[outputs]`.
    ///
    /// # Panics
    /// When the values have other sizes.
    #[must_use]
    pub fn new(weight: &[f32], bias: &[f32], inputs: usize, outputs: usize, tiles: TileSize) -> Self {
        assert!(
            weight.len() == outputs * inputs * 9 && bias.len() == outputs,
            "a 3x3 convolution {inputs} -> {outputs} has other weight sizes"
        );
        Self {
            inputs,
            outputs,
            tiles,
            weights: match tiles {
                TileSize::Two => transformed::<Two, 2, 4>(weight, inputs, outputs),
                TileSize::Four => transformed::<Four, 4, 6>(weight, inputs, outputs),
            },
            bias: lines(bias),
        }
    }

    /// Whether tiles of two pixels cover maps of this size without being cut.
    #[must_use]
    pub fn fits([height, width]: [usize; 2]) -> bool {
        height.is_multiple_of(2) && width.is_multiple_of(2)
    }

    /// Convolves planar images as [`super::Conv3x3::run`] does. `[B, in, H, W] -> [B, out, H, W]`
    #[must_use]
    pub fn run(
        &self,
        input: &[f32],
        size: [usize; 2],
        rectify: bool,
        after: After,
        residual: Option<&[f32]>,
    ) -> Vec<f32> {
        let area = size[0] * size[1];
        let mut result = vec![0.0; input.len() / self.inputs * self.outputs];
        let mut sums = vec![0.0; self.outputs * area];
        let images = input.chunks_exact(self.inputs * area);
        for (image, (input, result)) in images.zip(result.chunks_exact_mut(self.outputs * area)).enumerate() {
            // Channels last.
            let map = if rectify {
                transposed(input, self.inputs, |value| value.max(0.0))
            } else {
                transposed(input, self.inputs, |value| value)
            };
            self.convolve(&map, size, &mut sums, Write::Set);
            let residual = residual.map(|residual| &residual[image * result.len()..][..result.len()]);
            self.finish(&sums, result, area, after, residual);
        }
        result
    }

    /// The sums of an image as planes, and what comes after. `[area, out] -> [out, area]`
    fn finish(&self, sums: &[f32], result: &mut [f32], area: usize, after: After, residual: Option<&[f32]>) {
        const PLANES: usize = 16;
        result
            .par_chunks_mut(PLANES * area)
            .enumerate()
            .for_each(|(piece, planes)| {
                let first = piece * PLANES;
                for (pixel, sums) in sums.chunks_exact(self.outputs).enumerate() {
                    for (channel, sum) in sums[first..].iter().take(planes.len() / area).enumerate() {
                        planes[channel * area + pixel] = *sum;
                    }
                }
                if after == After::Relu {
                    planes.iter_mut().for_each(|value| *value = value.max(0.0));
                }
                if let Some(residual) = residual {
                    let residual = &residual[first * area..];
                    for (value, other) in planes.iter_mut().zip(residual) {
                        *value += other.max(0.0);
                    }
                }
            });
    }

    /// Adds the convolution of a map with channels last to `out`. `map [height, width, inputs]`,
    /// `out [height, width, outputs]`
    ///
    /// # Panics
    /// When the map has other channels.
    pub fn add_to(&self, map: &[f32], size: [usize; 2], out: &mut [f32]) {
        self.convolve(map, size, out, Write::Add);
    }

    /// The convolution of a map with channels last, negative values as 0, into `out`. `map [height, width, inputs]`,
    /// `out [height, width, outputs]`
    ///
    /// # Panics
    /// When the map has other channels.
    pub fn rectified(&self, map: &[f32], size: [usize; 2], out: &mut [f32]) {
        self.convolve(map, size, out, Write::Rectified);
    }

    fn convolve(&self, map: &[f32], size: [usize; 2], out: &mut [f32], write: Write) {
        match self.tiles {
            TileSize::Two => self.tiled::<Two, 2, 4>(map, size, out, write),
            TileSize::Four => self.tiled::<Four, 4, 6>(map, size, out, write),
        }
    }

    fn tiled<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize>(
        &self,
        map: &[f32],
        [height, width]: [usize; 2],
        out: &mut [f32],
        write: Write,
    ) {
        let area = height * width;
        assert!(
            map.len() == area * self.inputs && out.len() == area * self.outputs,
            "the map does not fit the convolution"
        );
        if area == 0 {
            return;
        }
        let map = Map {
            values: map,
            height,
            width,
            channels: self.inputs,
        };
        if self.weights.len() * COLUMNS > LARGE_WEIGHTS {
            self.by_panels::<T, SIDE, REACH>(&map, out, write);
            return;
        }
        let columns = width.div_ceil(SIDE);
        let panels = self.inputs.div_ceil(COLUMNS);
        let at_once = (WINDOW / (panels * REACH * REACH)).max(1);
        let rows = (at_once / columns).max(1);
        let pieces = columns.div_ceil(at_once);
        out.par_chunks_mut(rows * SIDE * width * self.outputs)
            .enumerate()
            .for_each(|(band, out)| {
                let rows = band * rows..height.div_ceil(SIDE).min((band + 1) * rows);
                for piece in 0..pieces {
                    let window = Window {
                        rows: rows.clone(),
                        columns: piece * columns / pieces..(piece + 1) * columns / pieces,
                    };
                    self.window::<T, SIDE, REACH>(&map, &window, out, write);
                }
            });
    }

    /// The tiles of a window; `out` begins at the window's first row.
    fn window<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize>(
        &self,
        map: &Map<'_>,
        window: &Window,
        out: &mut [f32],
        write: Write,
    ) {
        let mut buffer = VALUES.take();
        let values = resized(&mut buffer, self.values_len::<REACH>(window));
        Arch::new().dispatch(Inputs::<T, SIDE, REACH> {
            map,
            window,
            first_panel: 0,
            out: values,
            tiling: PhantomData,
        });
        for panel in 0..self.bias.len() {
            let place = (&mut out[panel * COLUMNS..], self.outputs);
            self.panel::<T, SIDE, REACH>(panel, map, window, values, place, write);
        }
        VALUES.set(buffer);
    }

    /// All tiles at once, output panels side by side.
    fn by_panels<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize>(
        &self,
        map: &Map<'_>,
        out: &mut [f32],
        write: Write,
    ) {
        let window = Window {
            rows: 0..map.height.div_ceil(SIDE),
            columns: 0..map.width.div_ceil(SIDE),
        };
        let mut values = vec![Line::ZERO; self.values_len::<REACH>(&window)];
        values
            .par_chunks_exact_mut(REACH * REACH * window.stride())
            .enumerate()
            .for_each(|(panel, out)| {
                Arch::new().dispatch(Inputs::<T, SIDE, REACH> {
                    map,
                    window: &window,
                    first_panel: panel,
                    out,
                    tiling: PhantomData,
                });
            });
        let planes: Vec<Vec<f32>> = (0..self.bias.len())
            .into_par_iter()
            .map(|panel| {
                let mut plane = vec![0.0; map.height * map.width * COLUMNS];
                self.panel::<T, SIDE, REACH>(panel, map, &window, &values, (&mut plane, COLUMNS), Write::Set);
                plane
            })
            .collect();
        for (pixel, out) in out.chunks_exact_mut(self.outputs).enumerate() {
            for (out, plane) in out.chunks_mut(COLUMNS).zip(&planes) {
                write.apply(out, &plane[pixel * COLUMNS..][..COLUMNS]);
            }
        }
    }

    /// Lines of the transformed values of a window.
    fn values_len<const REACH: usize>(&self, window: &Window) -> usize {
        self.inputs.div_ceil(COLUMNS) * REACH * REACH * window.stride()
    }

    /// The products of one output panel, and the way back into pixels. `out` begins at the window's first row and the
    /// panel's first channel, and comes with the channels of its pixels.
    fn panel<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize>(
        &self,
        panel: usize,
        map: &Map<'_>,
        window: &Window,
        values: &[Line],
        (out, channels): (&mut [f32], usize),
        write: Write,
    ) {
        let (points, stride) = (REACH * REACH, window.stride());
        let mut buffer = PRODUCTS.take();
        let products = resized(&mut buffer, points * stride);
        let weights = &self.weights[panel * points * self.inputs..][..points * self.inputs];
        for (point, weights) in weights.chunks_exact(self.inputs).enumerate() {
            let out = &mut products[point * stride..][..window.tiles()];
            product(&values[point * stride..], points * stride, weights, out, false);
        }
        Arch::new().dispatch(Outputs::<T, SIDE, REACH> {
            products,
            window,
            size: [map.height - window.rows.start * SIDE, map.width],
            bias: &self.bias[panel],
            out,
            channels,
            count: COLUMNS.min(self.outputs - panel * COLUMNS),
            write,
            tiling: PhantomData,
        });
        PRODUCTS.set(buffer);
    }
}

impl Write {
    /// Writes the sums of a pixel that were set elsewhere.
    fn apply(self, out: &mut [f32], sums: &[f32]) {
        for (out, &sum) in out.iter_mut().zip(sums) {
            *out = match self {
                Self::Set => sum,
                Self::Rectified => sum.max(0.0),
                Self::Add => *out + sum,
            };
        }
    }
}

thread_local! {
    /// Transformed values of a window, kept from one to the next.
    static VALUES: Cell<Vec<Line>> = const { Cell::new(Vec::new()) };
    /// Products of a panel, kept from one to the next.
    static PRODUCTS: Cell<Vec<Line>> = const { Cell::new(Vec::new()) };
}

/// Transformed weights. `[panels of outputs][points][inputs]`
fn transformed<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize>(
    weight: &[f32],
    inputs: usize,
    outputs: usize,
) -> Vec<Line> {
    let matrix = T::kernel();
    let per_panel = REACH * REACH * inputs;
    let mut transformed = vec![Line::ZERO; outputs.div_ceil(COLUMNS) * per_panel];
    transformed
        .par_chunks_exact_mut(per_panel.max(1))
        .enumerate()
        .for_each(|(panel, transformed)| {
            for output in panel * COLUMNS..outputs.min((panel + 1) * COLUMNS) {
                for input in 0..inputs {
                    let kernel = &weight[(output * inputs + input) * 9..][..9];
                    for point in 0..REACH * REACH {
                        let (row, column) = (&matrix[point / REACH], &matrix[point % REACH]);
                        let terms = (0..9).map(|tap| row[tap / 3] * f64::from(kernel[tap]) * column[tap % 3]);
                        let sum: f64 = terms.sum();
                        transformed[point * inputs + input].0[output % COLUMNS] = sum as f32;
                    }
                }
            }
        });
    transformed
}

/// Values by channel as lines, the rest of the last one zero.
fn lines(values: &[f32]) -> Vec<Line> {
    let line = |values: &[f32]| {
        let mut line = Line::ZERO;
        line.0[..values.len()].copy_from_slice(values);
        line
    };
    values.chunks(COLUMNS).map(line).collect()
}

/// A map with channels last.
struct Map<'a> {
    values: &'a [f32],
    height: usize,
    width: usize,
    channels: usize,
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

    /// Lines from the values of one point to those of the next: an odd number, so that points do not share cache sets.
    fn stride(&self) -> usize {
        self.tiles() | 1
    }
}

/// The inputs of some tiles, transformed, from a panel of channels on. `out [panels][REACH * REACH][stride]`
struct Inputs<'a, T, const SIDE: usize, const REACH: usize> {
    map: &'a Map<'a>,
    window: &'a Window,
    first_panel: usize,
    out: &'a mut [Line],
    tiling: PhantomData<T>,
}

/// The place of a pixel outside of the image.
const OUTSIDE: usize = usize::MAX;

impl<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize> WithSimd for Inputs<'_, T, SIDE, REACH> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Map {
            values,
            height,
            width,
            channels,
        } = *self.map;
        let (zero, stride) = (simd.splat_f32s(0.0), self.window.stride());
        let mut tile = 0;
        for tile_row in self.window.rows.clone() {
            for tile_column in self.window.columns.clone() {
                let mut places = [[OUTSIDE; REACH]; REACH];
                for row in 0..REACH {
                    for column in 0..REACH {
                        let (y, x) = (tile_row * SIDE + row, tile_column * SIDE + column);
                        if (1..=height).contains(&y) && (1..=width).contains(&x) {
                            places[row][column] = ((y - 1) * width + x - 1) * channels;
                        }
                    }
                }
                let panels = (self.first_panel..).zip(self.out.chunks_exact_mut(REACH * REACH * stride));
                for (panel, out) in panels {
                    let end = COLUMNS.min(channels - panel * COLUMNS);
                    for first in (0..end).step_by(S::F32_LANES) {
                        let count = S::F32_LANES.min(end - first);
                        let mut half = [[zero; REACH]; REACH];
                        for column in 0..REACH {
                            let mut d = [zero; REACH];
                            for row in 0..REACH {
                                if places[row][column] != OUTSIDE {
                                    let place = places[row][column] + panel * COLUMNS + first;
                                    d[row] = load(simd, &values[place..][..count]);
                                }
                            }
                            let transformed = T::inputs(simd, d);
                            for row in 0..REACH {
                                half[row][column] = transformed[row];
                            }
                        }
                        for row in 0..REACH {
                            let transformed = T::inputs(simd, half[row]);
                            for column in 0..REACH {
                                let line = &mut out[(row * REACH + column) * stride + tile];
                                S::as_mut_simd_f32s(&mut line.0[first..first + S::F32_LANES]).0[0] =
                                    transformed[column];
                            }
                        }
                    }
                }
                tile += 1;
            }
        }
    }
}

/// The way back: bias and the pixels of some tiles of one panel. `products [REACH * REACH][stride]`
struct Outputs<'a, T, const SIDE: usize, const REACH: usize> {
    products: &'a [Line],
    window: &'a Window,
    /// Rows of the image from the window's first on, and columns.
    size: [usize; 2],
    bias: &'a Line,
    /// From the first row of the window and the first channel of the panel on, channels last.
    out: &'a mut [f32],
    /// Channels of a pixel, and those of this panel.
    channels: usize,
    count: usize,
    write: Write,
    tiling: PhantomData<T>,
}

impl<T: Tiling<SIDE, REACH>, const SIDE: usize, const REACH: usize> WithSimd for Outputs<'_, T, SIDE, REACH> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let [height, width] = self.size;
        let (zero, stride) = (simd.splat_f32s(0.0), self.window.stride());
        let mut tile = 0;
        for tile_row in 0..self.window.rows.len() {
            for tile_column in self.window.columns.clone() {
                let (top, left) = (tile_row * SIDE, tile_column * SIDE);
                let (rows, columns) = (SIDE.min(height - top), SIDE.min(width - left));
                for first in (0..self.count).step_by(S::F32_LANES) {
                    let count = S::F32_LANES.min(self.count - first);
                    let bias = at(simd, self.bias, first);
                    let mut half = [[zero; REACH]; SIDE];
                    for column in 0..REACH {
                        let mut m = [zero; REACH];
                        for row in 0..REACH {
                            m[row] = at(simd, &self.products[(row * REACH + column) * stride + tile], first);
                        }
                        let transformed = T::outputs(simd, m);
                        for row in 0..SIDE {
                            half[row][column] = transformed[row];
                        }
                    }
                    for row in 0..rows {
                        let transformed = T::outputs(simd, half[row]);
                        for column in 0..columns {
                            let place = ((top + row) * width + left + column) * self.channels + first;
                            let pixel = &mut self.out[place..][..count];
                            let sum = simd.add_f32s(transformed[column], bias);
                            let value = match self.write {
                                Write::Set => sum,
                                Write::Rectified => simd.max_f32s(sum, zero),
                                Write::Add => simd.add_f32s(load(simd, pixel), sum),
                            };
                            store(simd, pixel, value);
                        }
                    }
                }
                tile += 1;
            }
        }
    }
}

/// A vector of a line.
#[inline(always)]
fn at<S: Simd>(_: S, line: &Line, first: usize) -> S::f32s {
    S::as_simd_f32s(&line.0[first..first + S::F32_LANES]).0[0]
}

/// Channels of a pixel, zeros where a vector has more.
#[inline(always)]
fn load<S: Simd>(simd: S, values: &[f32]) -> S::f32s {
    match S::as_simd_f32s(values).0 {
        [whole, ..] => *whole,
        [] => simd.partial_load_f32s(values),
    }
}

/// Writes as many channels as the pixel has.
#[inline(always)]
fn store<S: Simd>(simd: S, pixel: &mut [f32], value: S::f32s) {
    if pixel.len() == S::F32_LANES {
        S::as_mut_simd_f32s(pixel).0[0] = value;
    } else {
        simd.partial_store_f32s(pixel, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;
    use crate::{Conv3x3, Precision};

    #[test]
    fn equals_the_direct_convolution() {
        for (height, width, inputs, outputs) in [(4, 4, 1, 1), (8, 12, 3, 5), (2, 6, 16, 33), (22, 40, 48, 48)] {
            let (weight, bias) = (noise(outputs * inputs * 9, 2), noise(outputs, 3));
            let direct = Conv3x3::new(&weight, &bias, outputs, inputs, Precision::F32);
            let input = noise(2 * inputs * height * width, 1);
            let residual = noise(2 * outputs * height * width, 4);
            for (tiles, error) in [(TileSize::Two, 1e-6), (TileSize::Four, 4e-6)] {
                let tiled = Winograd::new(&weight, &bias, inputs, outputs, tiles);
                let bound = error * (9.0 * inputs as f32 + 1.0);
                for (rectify, after, residual) in [
                    (false, After::Nothing, None),
                    (true, After::Relu, None),
                    (false, After::Nothing, Some(residual.as_slice())),
                ] {
                    let found = tiled.run(&input, [height, width], rectify, after, residual);
                    let expected = direct.run(&input, [height, width], rectify, after, residual);
                    assert_eq!(found.len(), expected.len());
                    for (found, expected) in found.iter().zip(&expected) {
                        assert!(
                            (found - expected).abs() < bound,
                            "{tiles:?} {height}x{width} {inputs} -> {outputs}: {found} {expected}"
                        );
                    }
                }
            }
        }
    }

    /// Images in pieces, several panels, sides that cut tiles.
    #[test]
    fn odd_sizes_and_any_number_of_threads() {
        for (height, width, inputs, outputs) in [
            (17, 33, 3, 5),
            (19, 35, 40, 33),
            (3, 150, 2, 70),
            (1, 2, 70, 40),
            (3, 4, 600, 450),
        ] {
            let (weight, bias) = (noise(outputs * inputs * 9, 2), noise(outputs, 3));
            let (map, area) = (noise(inputs * height * width, 1), height * width);
            let planar = transposed(&map, area, |value| value);
            let direct = Conv3x3::new(&weight, &bias, outputs, inputs, Precision::F32);
            let expected = direct.run(&planar, [height, width], false, After::Relu, None);
            let expected = transposed(&expected, outputs, |value| value);
            for (tiles, error) in [(TileSize::Two, 1e-6), (TileSize::Four, 4e-6)] {
                let tiled = Winograd::new(&weight, &bias, inputs, outputs, tiles);
                let run = |threads: usize| {
                    let mut out = vec![f32::NAN; area * outputs];
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                    pool.install(|| tiled.rectified(&map, [height, width], &mut out));
                    out
                };
                let found = run(1);
                assert_eq!(found, run(3));
                for (found, expected) in found.iter().zip(&expected) {
                    assert!(
                        (found - expected).abs() < error * (9 * inputs + 1) as f32,
                        "{found} {expected}"
                    );
                }
            }
        }
    }
}
