//! The input rows of a band of a convolution's output rows, and the tile that both instruction paths sum over it.

use std::cell::Cell;
use std::ops::Range;

use rayon::prelude::*;

use crate::{bf16, vectorised};

/// Output channels of a register tile.
pub(crate) const TILE: usize = 8;
/// Zero columns left of the image in a band buffer.
const LEFT: usize = 1;
/// Widest vector of any instruction set, for sizing buffers.
const MAX_LANES: usize = 16;

/// Repeats code for every channel of a tile, a constant in it, so that sums stay in registers: indices of a loop keep them
/// in memory.
macro_rules! for_channels {
    (|$channel:ident| $body:block) => {
        crate::tile::for_rows!(@ $channel $body 0 1 2 3 4 5 6 7)
    };
}
pub(crate) use for_channels;

thread_local! {
    /// The buffer of a band, kept from one to the next.
    static SCRATCH: Cell<Vec<f32>> = const { Cell::new(Vec::new()) };
}

/// Planar images that are worked on band by band.
pub(crate) struct Bands {
    /// Images.
    pub(crate) images: usize,
    /// Channels of the result.
    pub(crate) channels: usize,
    /// Rows and columns of an image.
    pub(crate) size: [usize; 2],
    /// Rows of a band.
    pub(crate) rows: usize,
    /// Images that go together, side by side.
    pub(crate) across: usize,
}

impl Bands {
    /// Computes all bands side by side. `compute(images, rows, planes)` fills the rows of every channel of the first image,
    /// then of the next; the result is `[images, channels, height, width]`.
    pub(crate) fn run(&self, compute: impl Fn(Range<usize>, Range<usize>, &mut [&mut [f32]]) + Sync) -> Vec<f32> {
        let &Self {
            images,
            channels,
            size: [height, width],
            rows,
            across,
        } = self;
        let (area, bands) = (height * width, height.div_ceil(rows));
        let mut output = vec![0.0f32; images * channels * area];
        let mut tasks: Vec<Vec<&mut [f32]>> = Vec::new();
        tasks.resize_with(images.div_ceil(across) * bands, || {
            Vec::with_capacity(across * channels)
        });
        for (plane, values) in output.chunks_exact_mut(area.max(1)).enumerate() {
            for (band, rows) in values.chunks_mut((rows * width).max(1)).enumerate() {
                tasks[plane / channels / across * bands + band].push(rows);
            }
        }
        tasks.into_par_iter().enumerate().for_each(|(task, mut planes)| {
            let (image, row) = (task / bands * across, task % bands * rows);
            compute(
                image..images.min(image + across),
                row..height.min(row + rows),
                &mut planes,
            );
        });
        output
    }
}

/// How many images of a width side by side, with a column between them, fill vectors best.
pub(crate) fn across(images: usize, width: usize) -> usize {
    /// Columns from which the last vector of a row hardly matters.
    const WIDE: usize = 128;
    let vectors = |across: usize| images.div_ceil(across) * (across * (width + 1) - 1).div_ceil(MAX_LANES);
    let most = images.min(WIDE / width.max(1)).max(1);
    (1..=most).min_by_key(|&across| vectors(across)).unwrap_or(1)
}

/// Rows of a band: the buffer of the inputs should fit the second-level cache.
pub(crate) fn band_rows(inputs: usize, width: usize) -> usize {
    const CACHE_FLOATS: usize = 160 << 10;
    (CACHE_FLOATS / (inputs * (width + 2 * MAX_LANES)).max(1))
        .saturating_sub(2)
        .clamp(2, 16)
}

/// Input rows of a band of output rows, with a row above and below, padded with zeros. `[inputs][rows + 2][stride]`
pub(crate) struct Band {
    values: Vec<f32>,
    rows: usize,
    width: usize,
    stride: usize,
}

impl Band {
    pub(crate) fn new(inputs: usize, rows: usize, width: usize) -> Self {
        // Tiles read whole vectors, up to one beyond the last column and its right neighbour.
        let stride = width.next_multiple_of(MAX_LANES) + MAX_LANES;
        let mut values = SCRATCH.take();
        values.clear();
        values.resize(inputs * (rows + 2) * stride, 0.0);
        Self {
            values,
            rows,
            width,
            stride,
        }
    }

    /// Rows and columns that are computed.
    pub(crate) fn size(&self) -> [usize; 2] {
        [self.rows, self.width]
    }

    /// Distance of rows in the buffer.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// Distance of channels in the buffer.
    pub(crate) fn plane(&self) -> usize {
        (self.rows + 2) * self.stride
    }

    /// The buffer. `[inputs][rows + 2][stride]`
    pub(crate) fn values(&self) -> &[f32] {
        &self.values
    }

    /// Rounds all values to bfloat16.
    pub(crate) fn round(&mut self) {
        vectorised(
            #[inline(always)]
            || {
                for value in &mut self.values {
                    *value = bf16::nearest(*value);
                }
            },
        );
    }

    /// Fills each input row: `row(channel, index, out)` where index 0 is the row above the band. Rows left alone are zero.
    pub(crate) fn fill(&mut self, mut row: impl FnMut(usize, usize, &mut [f32])) {
        let rows = self.rows + 2;
        for (index, values) in self.values.chunks_exact_mut(self.stride).enumerate() {
            row(index / rows, index % rows, &mut values[LEFT..LEFT + self.width]);
        }
    }
}

impl Drop for Band {
    fn drop(&mut self) {
        SCRATCH.set(std::mem::take(&mut self.values));
    }
}
