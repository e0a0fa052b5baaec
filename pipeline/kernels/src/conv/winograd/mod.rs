//! 3x3 convolution with stride 1 and zero padding by Winograd's algorithm, tile by tile.
//!
//! Inputs of a tile are transformed (each channel by itself), meet the transformed weights in one matrix product over the
//! channels for each point of the transform, and are transformed back. A window of tiles is worked on at a time, so that
//! its transformed values stay in the second-level cache.
//!
//! Work is cut by the layer's sizes alone and every output is one sum in a fixed order: the bytes are the same for any
//! number of threads.

mod tiles;
mod tiling;
mod weights;

#[cfg(test)]
mod tests;

use std::cell::Cell;
use std::marker::PhantomData;

use pulp::Arch;
use rayon::prelude::*;

use self::tiles::{Inputs, Map, Outputs, Window, Write};
use self::tiling::{Four, Tiling, Two};
use self::weights::{lines, transformed};
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
    pub fn run(&self, input: &[f32], size: [usize; 2], rectify: bool, residual: Option<&[f32]>) -> Vec<f32> {
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
            self.finish(&sums, result, area, residual);
        }
        result
    }

    /// The sums of an image as planes, and what comes after. `[area, out] -> [out, area]`
    fn finish(&self, sums: &[f32], result: &mut [f32], area: usize, residual: Option<&[f32]>) {
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

thread_local! {
    /// Transformed values of a window, kept from one to the next.
    static VALUES: Cell<Vec<Line>> = const { Cell::new(Vec::new()) };
    /// Products of a panel, kept from one to the next.
    static PRODUCTS: Cell<Vec<Line>> = const { Cell::new(Vec::new()) };
}
