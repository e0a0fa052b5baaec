//! Convolution of maps with channels last, of any size and stride: receptive fields copied together are the rows of a
//! matrix product.

use rayon::prelude::*;

use crate::layers::ROWS_PER_PIECE;
use crate::pointwise::{add_assign, relu_in_place};
use crate::{FeatureMap, Matrix, PackedWeight, Precision};

/// A square convolution with zero padding.
#[derive(Debug, Clone)]
pub struct Conv {
    size: usize,
    stride: usize,
    padding: usize,
    inputs: usize,
    outputs: usize,
    /// `[size, size, inputs, outputs]`
    weight: Vec<f32>,
    packed: PackedWeight,
    /// `[outputs]`
    bias: Vec<f32>,
}

impl Conv {
    /// A convolution from PyTorch values: weight `[outputs, inputs, size, size]`, bias `[outputs]` or none. Padding is
    /// `size / 2`.
    ///
    /// # Panics
    /// When the values have other sizes.
    #[must_use]
    pub fn new(
        weight: &[f32],
        bias: Option<Vec<f32>>,
        inputs: usize,
        outputs: usize,
        size: usize,
        stride: usize,
    ) -> Self {
        let bias = bias.unwrap_or_else(|| vec![0.0; outputs]);
        assert!(
            weight.len() == outputs * inputs * size * size && bias.len() == outputs,
            "a {size}x{size} convolution {inputs} -> {outputs} has other weight sizes"
        );
        let mut reordered = vec![0.0; weight.len()];
        for out in 0..outputs {
            for input in 0..inputs {
                for tap in 0..size * size {
                    reordered[(tap * inputs + input) * outputs + out] =
                        weight[(out * inputs + input) * size * size + tap];
                }
            }
        }
        Self {
            size,
            stride,
            padding: size / 2,
            inputs,
            outputs,
            packed: packed(&reordered, outputs),
            weight: reordered,
            bias,
        }
    }

    /// Folds a per-channel affine map `y -> scale y + shift` of the output into the convolution.
    pub fn followed_by(mut self, scale: &[f32], shift: &[f32]) -> Self {
        for row in self.weight.chunks_exact_mut(self.outputs) {
            for (weight, scale) in row.iter_mut().zip(scale) {
                *weight *= scale;
            }
        }
        for ((bias, scale), shift) in self.bias.iter_mut().zip(scale).zip(shift) {
            *bias = *bias * scale + shift;
        }
        self.packed = packed(&self.weight, self.outputs);
        self
    }

    /// Channels of the result.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// The convolution of a map.
    #[must_use]
    pub fn forward(&self, map: &FeatureMap) -> FeatureMap {
        let [height, width] = self.output_size([map.height, map.width]);
        let mut out = FeatureMap::zeros(height, width, self.outputs);
        self.run(&map.data, [map.height, map.width], false, &mut out.data);
        out
    }

    /// Rows and columns of the convolution of a map of this size.
    #[must_use]
    pub fn output_size(&self, size: [usize; 2]) -> [usize; 2] {
        size.map(|n| (n + 2 * self.padding - self.size) / self.stride + 1)
    }

    /// The convolution of a map with channels last; negative values become 0 if `rectify`. `map [height, width, inputs]`,
    /// `out [height', width', outputs]`
    pub fn run(&self, map: &[f32], size: [usize; 2], rectify: bool, out: &mut [f32]) {
        let [_, width] = self.output_size(size);
        let columns = self.size * self.size * self.inputs;
        // As many output rows a piece as give about 256 pixels, for small maps; the piece size is a function of the
        // shape alone.
        let rows = (ROWS_PER_PIECE / width).max(1);
        out.par_chunks_mut(rows * width * self.outputs)
            .enumerate()
            .for_each_init(Vec::new, |patches, (piece, data)| {
                let pixels = data.len() / self.outputs;
                patches.clear();
                patches.resize(pixels * columns, 0.0);
                for (row, patches) in patches.chunks_exact_mut(width * columns).enumerate() {
                    self.gather_row(map, size, piece * rows + row, patches);
                }
                self.packed.rows(
                    patches,
                    data,
                    self.outputs,
                    #[inline(always)]
                    |_, column, values| {
                        add_assign(values, &self.bias[column..]);
                        if rectify {
                            relu_in_place(values);
                        }
                    },
                );
            });
    }

    /// Copies the receptive fields of one output row. `[width, size, size, inputs]`
    fn gather_row(&self, map: &[f32], [height, width]: [usize; 2], row: usize, patches: &mut [f32]) {
        let (size, channels) = (self.size, self.inputs);
        for (column, patch) in patches.chunks_exact_mut(size * size * channels).enumerate() {
            let left = (column * self.stride) as isize - self.padding as isize;
            let first = (-left).clamp(0, size as isize) as usize;
            let last = (width as isize - left).clamp(0, size as isize) as usize;
            for (tap, line) in patch.chunks_exact_mut(size * channels).enumerate() {
                let y = (row * self.stride + tap) as isize - self.padding as isize;
                if y < 0 || y >= height as isize || first >= last {
                    line.fill(0.0);
                    continue;
                }
                let start = (y as usize * width + (left + first as isize) as usize) * channels;
                line[..first * channels].fill(0.0);
                line[first * channels..last * channels].copy_from_slice(&map[start..start + (last - first) * channels]);
                line[last * channels..].fill(0.0);
            }
        }
    }
}

/// Weights `[taps and inputs, outputs]` packed for products.
fn packed(weight: &[f32], outputs: usize) -> PackedWeight {
    PackedWeight::of(Matrix::new(weight, outputs).transposed(), Precision::F32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The convolution sum written out.
    fn plain(map: &FeatureMap, weight: &[f32], outputs: usize, size: usize, stride: usize) -> FeatureMap {
        let pad = size / 2;
        let mut out = FeatureMap::zeros(
            (map.height + 2 * pad - size) / stride + 1,
            (map.width + 2 * pad - size) / stride + 1,
            outputs,
        );
        for row in 0..out.height {
            for column in 0..out.width {
                for o in 0..outputs {
                    let mut sum = 0.0;
                    for i in 0..map.channels {
                        for dy in 0..size {
                            for dx in 0..size {
                                let (y, x) = (
                                    (row * stride + dy) as isize - pad as isize,
                                    (column * stride + dx) as isize - pad as isize,
                                );
                                if y >= 0 && x >= 0 && (y as usize) < map.height && (x as usize) < map.width {
                                    sum += weight[((o * map.channels + i) * size + dy) * size + dx]
                                        * map.data[(y as usize * map.width + x as usize) * map.channels + i];
                                }
                            }
                        }
                    }
                    out.data[(row * out.width + column) * outputs + o] = sum;
                }
            }
        }
        out
    }

    #[test]
    fn convolutions_of_every_kind_used_equal_the_plain_sum() {
        for (height, width, inputs, outputs, size, stride) in [
            (7, 9, 3, 4, 7, 2),
            (6, 5, 4, 3, 3, 1),
            (7, 8, 4, 5, 3, 2),
            (5, 6, 3, 4, 1, 2),
            (2, 2, 2, 2, 7, 2),
            (3, 700, 2, 3, 3, 1),
        ] {
            let data = (0..height * width * inputs)
                .map(|i| ((i * 31) % 17) as f32 / 8.0 - 1.0)
                .collect();
            let map = FeatureMap {
                height,
                width,
                channels: inputs,
                data,
            };
            let weight: Vec<f32> = (0..outputs * inputs * size * size)
                .map(|i| ((i * 13) % 11) as f32 / 8.0 - 0.5)
                .collect();
            let fast = Conv::new(&weight, None, inputs, outputs, size, stride).forward(&map);
            let slow = plain(&map, &weight, outputs, size, stride);
            assert_eq!((fast.height, fast.width), (slow.height, slow.width));
            assert!(
                fast.data.iter().zip(&slow.data).all(|(a, b)| (a - b).abs() < 1e-4),
                "{height}x{width} {size}/{stride}"
            );
        }
    }
}
