//! Tiles of a window: into the transform's values, and back into pixels.

use std::marker::PhantomData;
use std::ops::Range;

use pulp::{Simd, WithSimd};

use super::tiling::Tiling;
use crate::tile::{COLUMNS, Line};

/// What becomes of the sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Write {
    /// They replace what is there.
    Set,
    /// They replace what is there, negative ones as 0.
    Rectified,
    /// They are added to it.
    Add,
}

impl Write {
    /// Writes the sums of a pixel that were set elsewhere.
    pub(super) fn apply(self, out: &mut [f32], sums: &[f32]) {
        for (out, &sum) in out.iter_mut().zip(sums) {
            *out = match self {
                Self::Set => sum,
                Self::Rectified => sum.max(0.0),
                Self::Add => *out + sum,
            };
        }
    }
}

/// A map with channels last.
pub(super) struct Map<'a> {
    pub(super) values: &'a [f32],
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) channels: usize,
}

/// Some tiles of a layer.
pub(super) struct Window {
    pub(super) rows: Range<usize>,
    pub(super) columns: Range<usize>,
}

impl Window {
    pub(super) fn tiles(&self) -> usize {
        self.rows.len() * self.columns.len()
    }

    /// Lines from the values of one point to those of the next: an odd number, so that points do not share cache sets.
    pub(super) fn stride(&self) -> usize {
        self.tiles() | 1
    }
}

/// The inputs of some tiles, transformed, from a panel of channels on. `out [panels][REACH * REACH][stride]`
pub(super) struct Inputs<'a, T, const SIDE: usize, const REACH: usize> {
    pub(super) map: &'a Map<'a>,
    pub(super) window: &'a Window,
    pub(super) first_panel: usize,
    pub(super) out: &'a mut [Line],
    pub(super) tiling: PhantomData<T>,
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
pub(super) struct Outputs<'a, T, const SIDE: usize, const REACH: usize> {
    pub(super) products: &'a [Line],
    pub(super) window: &'a Window,
    /// Rows of the image from the window's first on, and columns.
    pub(super) size: [usize; 2],
    pub(super) bias: &'a Line,
    /// From the first row of the window and the first channel of the panel on, channels last.
    pub(super) out: &'a mut [f32],
    /// Channels of a pixel, and those of this panel.
    pub(super) channels: usize,
    pub(super) count: usize,
    pub(super) write: Write,
    pub(super) tiling: PhantomData<T>,
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
