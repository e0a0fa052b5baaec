//! Position embeddings: the learned grid of the image encoder, rotary tables, and the sine map of the dense heads.

use std::sync::Arc;

use burn::tensor::{Device, Tensor};

use crate::kernels::differentiable;
use crate::parameters::from_host;

/// Resamples the learned position embedding of a square grid to `rows x columns` with antialiased bicubic weights
/// (kernel parameter -0.5). `table` is `[1 + side^2, width]`, row 0 (class token) passes through.
#[must_use]
pub fn resample_positions(table: &[f32], side: usize, width: usize, [rows, columns]: [usize; 2]) -> Vec<f32> {
    if rows == side && columns == side {
        return table.to_vec();
    }
    let (class, grid) = table.split_at(width);
    let (row_taps, column_taps) = (axis_taps(side, rows), axis_taps(side, columns));
    // Columns first: [side, columns, width].
    let mut narrowed = vec![0.0f32; side * columns * width];
    for row in 0..side {
        for (column, (first, weights)) in column_taps.iter().enumerate() {
            let out = &mut narrowed[(row * columns + column) * width..][..width];
            for (tap, &weight) in weights.iter().enumerate() {
                let source = &grid[(row * side + first + tap) * width..][..width];
                out.iter_mut()
                    .zip(source)
                    .for_each(|(sum, &value)| *sum += weight * value);
            }
        }
    }
    let mut result = class.to_vec();
    result.resize((1 + rows * columns) * width, 0.0);
    for (row, (first, weights)) in row_taps.iter().enumerate() {
        for column in 0..columns {
            let out = &mut result[(1 + row * columns + column) * width..][..width];
            for (tap, &weight) in weights.iter().enumerate() {
                let source = &narrowed[((first + tap) * columns + column) * width..][..width];
                out.iter_mut()
                    .zip(source)
                    .for_each(|(sum, &value)| *sum += weight * value);
            }
        }
    }
    result
}

/// Resampling weights as a matrix, so that gradients reach the learned grid: `[rows * columns, side^2]`.
#[must_use]
pub fn resampling_matrix(side: usize, [rows, columns]: [usize; 2]) -> Vec<f32> {
    let (row_taps, column_taps) = (axis_taps(side, rows), axis_taps(side, columns));
    let mut matrix = vec![0.0f32; rows * columns * side * side];
    for (row, (row_first, row_weights)) in row_taps.iter().enumerate() {
        for (column, (column_first, column_weights)) in column_taps.iter().enumerate() {
            let out = &mut matrix[(row * columns + column) * side * side..][..side * side];
            for (i, &row_weight) in row_weights.iter().enumerate() {
                for (j, &column_weight) in column_weights.iter().enumerate() {
                    out[(row_first + i) * side + column_first + j] = row_weight * column_weight;
                }
            }
        }
    }
    matrix
}

/// First tap and normalised weights of each output sample of one axis.
fn axis_taps(inputs: usize, outputs: usize) -> Vec<(usize, Vec<f32>)> {
    let step = inputs as f32 / outputs as f32;
    let stretch = step.max(1.0);
    let radius = 2.0 * stretch;
    let taps_of = |index: usize| {
        let centre = step * (index as f32 + 0.5);
        let first = (centre - radius + 0.5).trunc().max(0.0) as usize;
        let end = ((centre + radius + 0.5).trunc() as usize).min(inputs);
        let raw: Vec<f32> = (first..end)
            .map(|tap| cubic((tap as f32 - centre + 0.5) / stretch))
            .collect();
        let sum: f32 = raw.iter().sum();
        (first, raw.iter().map(|weight| weight / sum).collect())
    };
    (0..outputs).map(taps_of).collect()
}

/// The bicubic kernel with a = -0.5.
fn cubic(offset: f32) -> f32 {
    const A: f32 = -0.5;
    let t = offset.abs();
    if t < 1.0 {
        ((A + 2.0) * t - (A + 3.0)) * t * t + 1.0
    } else if t < 2.0 {
        ((A * t - 5.0 * A) * t + 8.0 * A) * t - 4.0 * A
    } else {
        0.0
    }
}

/// Base of the rotary frequencies.
const ROTARY_BASE: f64 = 100.0;

/// Cosines and sines of the rotary embedding for a list of positions. `[T, head_size]` each, laid out so that
/// `y = x * cos + swap(x) * sin` where `swap` exchanges the two quarters of each half and the sine of the first quarter
/// carries the minus sign (`docs/spec/stage1.md` section 5).
#[derive(Debug, Clone, PartialEq)]
pub struct RotaryTable {
    /// Cosines. `[T, head_size]`
    pub cosine: Vec<f32>,
    /// Signed sines. `[T, head_size]`
    pub sine: Vec<f32>,
    /// Channels of one head.
    pub head_size: usize,
}

impl RotaryTable {
    /// The table of `(row, column)` positions.
    #[must_use]
    pub fn new(positions: &[[usize; 2]], head_size: usize) -> Self {
        let (half, quarter) = (head_size / 2, head_size / 4);
        let mut cosine = vec![0.0f32; positions.len() * head_size];
        let mut sine = cosine.clone();
        for (token, position) in positions.iter().enumerate() {
            for (axis, &place) in position.iter().enumerate() {
                for m in 0..quarter {
                    let frequency = libm::pow(ROTARY_BASE, -(2.0 * m as f64) / half as f64) as f32;
                    let angle = place as f32 * frequency;
                    let (c, s) = (libm::cosf(angle), libm::sinf(angle));
                    let first = token * head_size + axis * half + m;
                    cosine[first] = c;
                    cosine[first + quarter] = c;
                    sine[first] = -s;
                    sine[first + quarter] = s;
                }
            }
        }
        Self {
            cosine,
            sine,
            head_size,
        }
    }

    /// Number of positions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cosine.len() / self.head_size
    }

    /// True for no positions.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cosine.is_empty()
    }

    /// The table as tensors.
    #[must_use]
    pub fn on(&self, device: &Device) -> Rotary {
        let shape = [1, 1, self.len(), self.head_size];
        let table = Arc::new(self.clone());
        Rotary {
            table,
            cosine: from_host(self.cosine.clone(), shape, device),
            sine: from_host(self.sine.clone(), shape, device),
        }
    }
}

/// A [`RotaryTable`] on a device. `[1, 1, T, head_size]` each
#[derive(Debug, Clone)]
pub struct Rotary {
    /// The table of one period; the positions of longer token lists repeat it.
    table: Arc<RotaryTable>,
    cosine: Tensor<4>,
    sine: Tensor<4>,
}

impl Rotary {
    /// Rotates queries or keys. `[B, heads, T, head_size]`
    #[must_use]
    pub fn apply(&self, input: Tensor<4>) -> Tensor<4> {
        if differentiable::usable(&input) {
            return differentiable::rotate(input, self.table.clone());
        }
        self.apply_on_tensors(input)
    }

    /// [`Self::apply`] in operations of the framework.
    pub(crate) fn apply_on_tensors(&self, input: Tensor<4>) -> Tensor<4> {
        let [batch, heads, tokens, size] = input.dims();
        let quarter = size / 4;
        let part = |index: usize| input.clone().narrow(3, index * quarter, quarter);
        let swapped = Tensor::cat(vec![part(1), part(0), part(3), part(2)], 3).reshape([batch, heads, tokens, size]);
        input.clone() * self.cosine.clone() + swapped * self.sine.clone()
    }

    /// The values of one period of positions.
    pub(crate) fn table(&self) -> &Arc<RotaryTable> {
        &self.table
    }

    /// The same table for `frames` copies of the token list, one after another.
    #[must_use]
    pub fn repeated(&self, frames: usize) -> Self {
        let repeat = |table: &Tensor<4>| table.clone().repeat(&[1, 1, frames, 1]);
        Self {
            table: self.table.clone(),
            cosine: repeat(&self.cosine),
            sine: repeat(&self.sine),
        }
    }
}

/// Positions of a frame's tokens: (0, 0) for the special ones, (row + 1, column + 1) for patches.
#[must_use]
pub fn token_positions(special: usize, [rows, columns]: [usize; 2]) -> Vec<[usize; 2]> {
    let patches = (0..rows * columns).map(|patch| [patch / columns + 1, patch % columns + 1]);
    std::iter::repeat_n([0, 0], special).chain(patches).collect()
}

/// Sine and cosine position map of the dense heads, `[channels, rows, columns]`, for images of aspect width / height.
#[must_use]
pub fn head_positions(channels: usize, [rows, columns]: [usize; 2], aspect: f64) -> Vec<f32> {
    let diagonal = (1.0 + aspect * aspect).sqrt();
    let (span_x, span_y) = (aspect / diagonal, 1.0 / diagonal);
    let coordinate = |index: usize, count: usize, span: f64| {
        let end = span * (count - 1) as f64 / count as f64;
        if count == 1 {
            -end
        } else {
            -end + 2.0 * end * index as f64 / (count - 1) as f64
        }
    };
    let (area, quarter) = (rows * columns, channels / 4);
    let mut map = vec![0.0f32; channels * area];
    for m in 0..quarter {
        let frequency = libm::pow(100.0, -(m as f64) / quarter as f64);
        for column in 0..columns {
            let angle = coordinate(column, columns, span_x) * frequency;
            let (s, c) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
            for row in 0..rows {
                map[m * area + row * columns + column] = s;
                map[(quarter + m) * area + row * columns + column] = c;
            }
        }
        for row in 0..rows {
            let angle = coordinate(row, rows, span_y) * frequency;
            let (s, c) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
            for column in 0..columns {
                map[(2 * quarter + m) * area + row * columns + column] = s;
                map[(3 * quarter + m) * area + row * columns + column] = c;
            }
        }
    }
    map
}
