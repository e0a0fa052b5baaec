//! 3x3 convolution by minimal filtering: F(2x2, 3x3) of Lavin and Gray (2016).
//!
//! A tile of 2x2 outputs needs 4x4 inputs. Transformed inputs and weights meet in 16 matrix products over the channels
//! instead of 36 multiplications per output tile and pair of channels: 4/9 of the direct sum's work, at no larger rounding
//! error, as the transforms only add, subtract and halve. F(4x4, 3x3) would do with a quarter of the work, but its errors
//! (1e-5 of the features) decide which of two neighbours is the nearer one.

use rayon::prelude::*;

use super::transpose::transposed;
use super::{After, PackedWeight, Precision, vectorised};
use crate::ShapeError;

/// Side of an output tile.
const SIDE: usize = 2;
/// Side of an input tile.
const REACH: usize = SIDE + 2;
/// Numbers of a transformed tile.
const POINTS: usize = REACH * REACH;
/// Tiles that one piece of work should have, so that weights are read for many of them at a time.
const PIECE_TILES: usize = 96;
/// Channels that are transformed together.
const LANES: usize = 16;

type Lanes = [f32; LANES];

/// A 3x3 convolution with stride 1 and zero padding, for maps with even sides.
#[derive(Debug, Clone)]
pub struct Winograd {
    inputs: usize,
    outputs: usize,
    /// Transformed weights of each point.
    weight: Vec<PackedWeight>,
    /// `[outputs]`
    bias: Vec<f32>,
}

impl Winograd {
    /// A convolution from PyTorch values: weight `[outputs, inputs, 3, 3]`, bias `[outputs]`.
    pub fn new(weight: &[f32], bias: Vec<f32>, inputs: usize, outputs: usize) -> Result<Self, ShapeError> {
        if weight.len() != outputs * inputs * 9 || bias.len() != outputs {
            return Err(ShapeError(format!(
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

    /// Whether maps of this size can be convolved.
    pub fn fits([height, width]: [usize; 2]) -> bool {
        height.is_multiple_of(SIDE) && width.is_multiple_of(SIDE)
    }

    /// Convolves planar images as [`super::Conv3x3::run`] does. `[B, in, H, W] -> [B, out, H, W]`
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
        let images = input.chunks_exact(self.inputs * area);
        for (image, (input, result)) in images.zip(result.chunks_exact_mut(self.outputs * area)).enumerate() {
            // Channels last.
            let map = if rectify {
                transposed(input, self.inputs, |value| value.max(0.0))
            } else {
                transposed(input, self.inputs, |value| value)
            };
            let mut sums = vec![0.0; self.outputs * area];
            self.add_to(&map, size, &mut sums);
            let residual = residual.map(|residual| &residual[image * result.len()..][..result.len()]);
            result
                .par_chunks_mut(LANES * area)
                .enumerate()
                .for_each(|(piece, planes)| {
                    let first = piece * LANES;
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
                        planes
                            .iter_mut()
                            .zip(residual)
                            .for_each(|(value, other)| *value += other.max(0.0));
                    }
                });
        }
        result
    }

    /// Adds the convolution of a map with channels last to `out`. `map [height * width * inputs]`,
    /// `out [height * width * outputs]`
    ///
    /// # Panics
    /// When a side is odd, or the map has other channels.
    pub fn add_to(&self, map: &[f32], [height, width]: [usize; 2], out: &mut [f32]) {
        assert!(
            Self::fits([height, width]) && map.len() == height * width * self.inputs,
            "the map does not fit the convolution"
        );
        let map = Map {
            values: map,
            height,
            width,
            channels: self.inputs,
        };
        let columns = width / SIDE;
        let line = SIDE * width * self.outputs;
        let tile_rows = PIECE_TILES.div_ceil(columns);
        out.par_chunks_mut(tile_rows * line).enumerate().for_each_init(
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
                            let corner = (piece * tile_rows + tile / columns, tile % columns);
                            transform_inputs(&map, corner, &mut inputs[tile * self.inputs..], in_stride);
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
                            let start = (tile / columns * SIDE * width + tile % columns * SIDE) * self.outputs;
                            let values = &outputs[tile * self.outputs..];
                            self.transform_outputs(values, out_stride, &mut out[start..], width * self.outputs);
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

/// A map with channels last.
struct Map<'a> {
    values: &'a [f32],
    height: usize,
    width: usize,
    channels: usize,
}

/// Transforms one tile of inputs; `out` begins at the tile's values of the first point.
#[inline(always)]
fn transform_inputs(map: &Map<'_>, (tile_row, tile_column): (usize, usize), out: &mut [f32], point_stride: usize) {
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
                    *d = load(&map.values[(y * map.width + x) * channels + first..], count);
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
    use super::super::product::tests::noise;
    use super::super::{After, Conv3x3};
    use super::*;

    #[test]
    fn equals_the_direct_convolution() {
        for (height, width, inputs, outputs) in [(4, 4, 1, 1), (8, 12, 3, 5), (2, 6, 16, 33), (22, 40, 48, 48)] {
            let (weight, bias) = (noise(outputs * inputs * 9, 2), noise(outputs, 3));
            let (tiled, direct) = (
                Winograd::new(&weight, bias.clone(), inputs, outputs).unwrap(),
                Conv3x3::new(&weight, &bias, outputs, inputs, Precision::F32),
            );
            let input = noise(2 * inputs * height * width, 1);
            let residual = noise(2 * outputs * height * width, 4);
            let bound = 1e-6 * (9.0 * inputs as f32 + 1.0);
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
                        "{height}x{width} {inputs} -> {outputs}: {found} {expected}"
                    );
                }
            }
        }
        assert!(Winograd::new(&[0.0; 8], vec![0.0], 1, 1).is_err());
    }
}
