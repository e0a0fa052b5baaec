//! Convolution and pooling of channels-last maps.

use rayon::prelude::*;

use super::Plane;
use super::dense::add_assign;
use crate::ShapeError;
use crate::{PackedWeight, Precision};

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
    pub fn new(
        weight: &[f32],
        bias: Option<Vec<f32>>,
        inputs: usize,
        outputs: usize,
        size: usize,
        stride: usize,
    ) -> Result<Self, ShapeError> {
        let bias = bias.unwrap_or_else(|| vec![0.0; outputs]);
        if weight.len() != outputs * inputs * size * size || bias.len() != outputs {
            return Err(ShapeError(format!(
                "a {size}x{size} convolution {inputs} -> {outputs} has other weight sizes"
            )));
        }
        let mut reordered = vec![0.0; weight.len()];
        for out in 0..outputs {
            for input in 0..inputs {
                for tap in 0..size * size {
                    reordered[(tap * inputs + input) * outputs + out] =
                        weight[(out * inputs + input) * size * size + tap];
                }
            }
        }
        Ok(Self {
            size,
            stride,
            padding: size / 2,
            inputs,
            outputs,
            packed: packed(&reordered, outputs),
            weight: reordered,
            bias,
        })
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

    /// The convolution of a map.
    pub fn forward(&self, map: &Plane) -> Plane {
        let length = |n: usize| (n + 2 * self.padding - self.size) / self.stride + 1;
        let mut out = Plane::zeros(length(map.height), length(map.width), self.outputs);
        let columns = self.size * self.size * self.inputs;
        // As many output rows a piece as give about 256 pixels, for small maps; the piece size is a function of the
        // shape alone.
        let rows = (super::ROWS_PER_PIECE / out.width).max(1);
        out.data
            .par_chunks_mut(rows * out.width * self.outputs)
            .enumerate()
            .for_each_init(Vec::new, |patches, (piece, data)| {
                let pixels = data.len() / self.outputs;
                patches.clear();
                patches.resize(pixels * columns, 0.0);
                for row in 0..pixels / out.width {
                    let patches = &mut patches[row * out.width * columns..][..out.width * columns];
                    self.gather_row(map, piece * rows + row, patches);
                }
                self.packed.rows(
                    patches,
                    data,
                    self.outputs,
                    #[inline(always)]
                    |_, column, values| add_assign(values, &self.bias[column..]),
                );
            });
        out
    }

    /// Copies the receptive fields of one output row. `[width, size, size, inputs]`
    fn gather_row(&self, map: &Plane, row: usize, patches: &mut [f32]) {
        let (size, channels) = (self.size, self.inputs);
        for (column, patch) in patches.chunks_exact_mut(size * size * channels).enumerate() {
            let left = (column * self.stride) as isize - self.padding as isize;
            let first = (-left).clamp(0, size as isize) as usize;
            let last = (map.width as isize - left).clamp(0, size as isize) as usize;
            for (tap, line) in patch.chunks_exact_mut(size * channels).enumerate() {
                let y = (row * self.stride + tap) as isize - self.padding as isize;
                if y < 0 || y >= map.height as isize || first >= last {
                    line.fill(0.0);
                    continue;
                }
                let start = (y as usize * map.width + (left + first as isize) as usize) * channels;
                line[..first * channels].fill(0.0);
                line[first * channels..last * channels]
                    .copy_from_slice(&map.data[start..start + (last - first) * channels]);
                line[last * channels..].fill(0.0);
            }
        }
    }
}

/// Weights `[taps and inputs, outputs]` packed for products.
fn packed(weight: &[f32], outputs: usize) -> PackedWeight {
    let inputs = weight.len() / outputs.max(1);
    PackedWeight::strided(weight, [outputs, inputs], [1, outputs], Precision::F32)
}

/// 3x3 maximum, stride 2, padding 1.
pub fn max_pool_3x3_stride_2(map: &Plane) -> Plane {
    let mut out = Plane::zeros(map.height.div_ceil(2), map.width.div_ceil(2), map.channels);
    let (width, channels) = (out.width, map.channels);
    out.data
        .par_chunks_mut(width * channels)
        .enumerate()
        .for_each(|(row, line)| {
            for (column, pixel) in line.chunks_exact_mut(channels).enumerate() {
                pixel.fill(f32::NEG_INFINITY);
                for y in (2 * row).saturating_sub(1)..(2 * row + 2).min(map.height) {
                    for x in (2 * column).saturating_sub(1)..(2 * column + 2).min(map.width) {
                        let source = &map.data[(y * map.width + x) * channels..][..channels];
                        for (best, &value) in pixel.iter_mut().zip(source) {
                            *best = best.max(value);
                        }
                    }
                }
            }
        });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The convolution sum written out.
    fn plain(map: &Plane, weight: &[f32], outputs: usize, size: usize, stride: usize) -> Plane {
        let pad = size / 2;
        let mut out = Plane::zeros(
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
            let map = Plane {
                height,
                width,
                channels: inputs,
                data,
            };
            let weight: Vec<f32> = (0..outputs * inputs * size * size)
                .map(|i| ((i * 13) % 11) as f32 / 8.0 - 0.5)
                .collect();
            let fast = Conv::new(&weight, None, inputs, outputs, size, stride)
                .unwrap()
                .forward(&map);
            let slow = plain(&map, &weight, outputs, size, stride);
            assert_eq!((fast.height, fast.width), (slow.height, slow.width));
            assert!(
                fast.data.iter().zip(&slow.data).all(|(a, b)| (a - b).abs() < 1e-4),
                "{height}x{width} {size}/{stride}"
            );
        }
    }

    #[test]
    fn pooling_takes_the_maximum_of_the_window() {
        let map = Plane {
            height: 3,
            width: 4,
            channels: 1,
            data: (0..12).map(|i| -(i as f32)).collect(),
        };
        assert_eq!(max_pool_3x3_stride_2(&map).data, vec![0.0, -1.0, -4.0, -5.0]);
    }
}
