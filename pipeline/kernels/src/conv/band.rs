//! The input rows of a band of a convolution's output rows, and the tile that both instruction paths sum over it.

use std::cell::Cell;

use rayon::prelude::*;

/// Output channels of a register tile.
pub(crate) const TILE: usize = 8;
/// Zero columns left of the image in a band buffer.
const LEFT: usize = 1;
/// Widest vector of any instruction set, for sizing buffers.
const MAX_LANES: usize = 16;

thread_local! {
    /// The buffer of a band, kept from one to the next.
    static SCRATCH: Cell<Vec<f32>> = const { Cell::new(Vec::new()) };
}

/// Computes bands of rows of planar images side by side. `compute(image, first row, rows, planes)` fills the rows of every
/// channel; the result is `[images, channels, height, width]`. `step` is the number of rows of a band.
pub(crate) fn in_bands(
    images: usize,
    channels: usize,
    [height, width]: [usize; 2],
    step: usize,
    compute: impl Fn(usize, usize, usize, &mut [&mut [f32]]) + Sync,
) -> Vec<f32> {
    let (area, bands) = (height * width, height.div_ceil(step));
    let mut output = vec![0.0f32; images * channels * area];
    let mut tasks: Vec<Vec<&mut [f32]>> = Vec::new();
    tasks.resize_with(images * bands, || Vec::with_capacity(channels));
    for (plane, values) in output.chunks_exact_mut(area.max(1)).enumerate() {
        for (band, rows) in values.chunks_mut((step * width).max(1)).enumerate() {
            tasks[plane / channels * bands + band].push(rows);
        }
    }
    tasks.into_par_iter().enumerate().for_each(|(task, mut planes)| {
        let first = task % bands * step;
        compute(task / bands, first, step.min(height - first), &mut planes);
    });
    output
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
