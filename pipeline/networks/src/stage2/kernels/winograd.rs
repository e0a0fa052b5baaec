//! 3x3 convolution of channels-last maps by minimal filtering: F(2x2, 3x3) of Lavin and Gray (2016).
//!
//! A tile of 2x2 outputs needs 4x4 inputs. Transformed inputs and weights meet in 16 matrix products over the channels
//! instead of 36 multiplications per output tile and pair of channels: 4/9 of the direct sum's work, at no larger rounding
//! error, as the transforms only add, subtract and halve. F(4x4, 3x3) would do with a quarter of the work, but its errors
//! (1e-5 of the features) decide which of two neighbours is the nearer one.

use rayon::prelude::*;

use super::Plane;
use crate::kernels::{PackedWeight, Precision, vectorised};
use crate::{Error, Result};

/// Side of an output tile.
const SIDE: usize = 2;
/// Side of an input tile.
const REACH: usize = SIDE + 2;
/// Numbers of a transformed tile.
const POINTS: usize = REACH * REACH;
/// Rows of tiles that one piece of work handles.
const TILE_ROWS: usize = 1;
/// Channels that are transformed together.
const LANES: usize = 16;

type Lanes = [f32; LANES];

/// A 3x3 convolution with stride 1 and zero padding, for maps with even sides.
#[derive(Debug, Clone)]
pub(crate) struct Winograd {
    inputs: usize,
    outputs: usize,
    /// Transformed weights of each point.
    weight: Vec<PackedWeight>,
    /// `[outputs]`
    bias: Vec<f32>,
}

impl Winograd {
    /// A convolution from PyTorch values: weight `[outputs, inputs, 3, 3]`, bias `[outputs]`.
    pub(crate) fn new(weight: &[f32], bias: Vec<f32>, inputs: usize, outputs: usize) -> Result<Self> {
        if weight.len() != outputs * inputs * 9 || bias.len() != outputs {
            return Err(Error::BadConfiguration(format!(
                "a 3x3 convolution {inputs} -> {outputs} has other weight sizes"
            )));
        }
        let mut transformed = vec![0.0; POINTS * inputs * outputs];
        for output in 0..outputs {
            for input in 0..inputs {
                let kernel = &weight[(output * inputs + input) * 9..][..9];
                for (point, value) in transformed_kernel(kernel).into_iter().enumerate() {
                    transformed[(point * outputs + output) * inputs + input] = value as f32;
                }
            }
        }
        Ok(Self {
            inputs,
            outputs,
            weight: transformed
                .chunks_exact(inputs * outputs)
                .map(|weight| PackedWeight::new(weight, inputs, Precision::F32))
                .collect(),
            bias,
        })
    }

    /// Adds the convolution of `map` to `out`. `map [height, width, inputs]`, `out [height * width * outputs]`
    ///
    /// # Panics
    /// When a side is odd, or the map has other channels.
    pub(crate) fn add_to(&self, map: &Plane, out: &mut [f32]) {
        assert!(
            map.height.is_multiple_of(SIDE) && map.width.is_multiple_of(SIDE) && map.channels == self.inputs,
            "the map does not fit the convolution"
        );
        let columns = map.width / SIDE;
        let line = SIDE * map.width * self.outputs;
        out.par_chunks_mut(TILE_ROWS * line).enumerate().for_each_init(
            || (Vec::new(), Vec::new()),
            |(inputs, outputs), (piece, out)| {
                let tiles = out.len() / line * columns;
                // The stride is no multiple of the page size, so that the 16 streams do not share cache sets.
                let (in_stride, out_stride) = (tiles * self.inputs + LANES, tiles * self.outputs + LANES);
                inputs.resize(POINTS * in_stride, 0.0);
                outputs.resize(POINTS * out_stride, 0.0);
                vectorised(
                    #[inline(always)]
                    || {
                        for tile in 0..tiles {
                            let corner = (piece * TILE_ROWS + tile / columns, tile % columns);
                            transform_inputs(map, corner, &mut inputs[tile * self.inputs..], in_stride);
                        }
                    },
                );
                for (point, weight) in self.weight.iter().enumerate() {
                    let values = &inputs[point * in_stride..][..tiles * self.inputs];
                    let results = &mut outputs[point * out_stride..][..tiles * self.outputs];
                    weight.rows(values, results, self.outputs, |_, _, _| {});
                }
                vectorised(
                    #[inline(always)]
                    || {
                        for tile in 0..tiles {
                            let start = (tile / columns * SIDE * map.width + tile % columns * SIDE) * self.outputs;
                            let values = &outputs[tile * self.outputs..];
                            self.transform_outputs(values, out_stride, &mut out[start..], map.width * self.outputs);
                        }
                    },
                );
            },
        );
    }

    /// Adds the outputs of one tile. `out` begins at its first pixel, its rows are `stride` apart.
    #[inline(always)]
    fn transform_outputs(&self, values: &[f32], point_stride: usize, out: &mut [f32], stride: usize) {
        for first in (0..self.outputs).step_by(LANES) {
            let count = LANES.min(self.outputs - first);
            let mut half = [[[0.0; LANES]; REACH]; SIDE];
            for column in 0..REACH {
                let m: [Lanes; REACH] =
                    std::array::from_fn(|row| load(&values[(row * REACH + column) * point_stride + first..], count));
                let rows = outputs_1d(&m);
                for row in 0..SIDE {
                    half[row][column] = rows[row];
                }
            }
            let bias = load(&self.bias[first..], count);
            for row in 0..SIDE {
                for (column, sums) in outputs_1d(&half[row]).iter().enumerate() {
                    let pixel = &mut out[row * stride + column * self.outputs + first..][..count];
                    for ((pixel, sum), bias) in pixel.iter_mut().zip(sums).zip(&bias) {
                        *pixel += sum + bias;
                    }
                }
            }
        }
    }
}

/// Transforms one tile of inputs; `out` begins at the tile's values of the first point.
#[inline(always)]
fn transform_inputs(map: &Plane, (tile_row, tile_column): (usize, usize), out: &mut [f32], point_stride: usize) {
    let channels = map.channels;
    for first in (0..channels).step_by(LANES) {
        let count = LANES.min(channels - first);
        let mut half = [[[0.0; LANES]; REACH]; REACH];
        for column in 0..REACH {
            let x = (tile_column * SIDE + column).wrapping_sub(1);
            let mut d = [[0.0; LANES]; REACH];
            for (row, d) in d.iter_mut().enumerate() {
                let y = (tile_row * SIDE + row).wrapping_sub(1);
                if x < map.width && y < map.height {
                    *d = load(&map.data[(y * map.width + x) * channels + first..], count);
                }
            }
            let rows = inputs_1d(&d);
            for row in 0..REACH {
                half[row][column] = rows[row];
            }
        }
        for row in 0..REACH {
            for (column, values) in inputs_1d(&half[row]).iter().enumerate() {
                out[(row * REACH + column) * point_stride + first..][..count].copy_from_slice(&values[..count]);
            }
        }
    }
}

/// `count` values, the rest zero.
#[inline(always)]
fn load(values: &[f32], count: usize) -> Lanes {
    let mut lanes = [0.0; LANES];
    if count == LANES {
        lanes.copy_from_slice(&values[..LANES]);
    } else {
        lanes[..count].copy_from_slice(&values[..count]);
    }
    lanes
}

/// Sum of some vectors with factors.
#[inline(always)]
fn sum<const N: usize>(terms: [(f32, &Lanes); N]) -> Lanes {
    let mut total = [0.0; LANES];
    for (factor, values) in terms {
        for lane in 0..LANES {
            total[lane] += factor * values[lane];
        }
    }
    total
}

/// The input transform B^T d.
#[inline(always)]
fn inputs_1d(d: &[Lanes; REACH]) -> [Lanes; REACH] {
    [
        sum([(1.0, &d[0]), (-1.0, &d[2])]),
        sum([(1.0, &d[1]), (1.0, &d[2])]),
        sum([(-1.0, &d[1]), (1.0, &d[2])]),
        sum([(1.0, &d[1]), (-1.0, &d[3])]),
    ]
}

/// The output transform A^T m.
#[inline(always)]
fn outputs_1d(m: &[Lanes; REACH]) -> [Lanes; SIDE] {
    [
        sum([(1.0, &m[0]), (1.0, &m[1]), (1.0, &m[2])]),
        sum([(1.0, &m[1]), (-1.0, &m[2]), (-1.0, &m[3])]),
    ]
}

/// The weight transform G g G^T.
fn transformed_kernel(kernel: &[f32]) -> [f64; POINTS] {
    const G: [[f64; 3]; REACH] = [[1.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.5, -0.5, 0.5], [0.0, 0.0, 1.0]];
    let at = |row: usize, column: usize| f64::from(kernel[3 * row + column]);
    std::array::from_fn(|point| {
        let (row, column) = (point / REACH, point % REACH);
        let mut total = 0.0;
        for y in 0..3 {
            for x in 0..3 {
                total += G[row][y] * at(y, x) * G[column][x];
            }
        }
        total
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage2::kernels::Conv;

    #[test]
    fn equals_the_direct_convolution() {
        for (height, width, inputs, outputs) in [(4, 4, 1, 1), (8, 12, 3, 5), (2, 6, 16, 33), (22, 40, 48, 48)] {
            let noise = |count: usize, seed: usize| -> Vec<f32> {
                (0..count)
                    .map(|k| ((k * 7919 + seed * 104_729) % 1009) as f32 / 504.5 - 1.0)
                    .collect()
            };
            let map = Plane {
                height,
                width,
                channels: inputs,
                data: noise(height * width * inputs, 1),
            };
            let (weight, bias) = (noise(outputs * inputs * 9, 2), noise(outputs, 3));
            let direct = Conv::new(&weight, Some(bias.clone()), inputs, outputs, 3, 1)
                .unwrap()
                .forward(&map);
            let mut found = noise(direct.data.len(), 4);
            let before = found.clone();
            Winograd::new(&weight, bias, inputs, outputs)
                .unwrap()
                .add_to(&map, &mut found);
            for ((found, before), direct) in found.iter().zip(&before).zip(&direct.data) {
                let bound = 5e-7 * (9.0 * inputs as f32 + 1.0);
                assert!(
                    (found - before - direct).abs() < bound,
                    "{height}x{width} {inputs} -> {outputs}: {found} {before} {direct}"
                );
            }
        }
        assert!(Winograd::new(&[0.0; 8], vec![0.0], 1, 1).is_err());
    }
}
