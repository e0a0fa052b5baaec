//! Matrix products x W^T on slices.
//!
//! Weights are packed into panels of [`COLUMNS`] outputs, inputs into strips of [`ROWS`] rows, both in blocks of [`DEPTH`]
//! units, so that a tile's operands lie in the first-level cache and its sums in registers. A unit is one f32, or a pair of
//! numbers rounded to bfloat16 whose products are summed in f32 ([`Precision::Bf16`]). A sum takes its terms in ascending
//! order block by block, whatever the number of threads.

use std::cell::Cell;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::{bf16, vectorised};

/// Rows of a tile.
pub(crate) const ROWS: usize = 12;
/// Columns of a tile.
pub(crate) const COLUMNS: usize = 32;
/// Units that are summed in one go.
pub(crate) const DEPTH: usize = 256;
/// Rows of a task.
const TASK_ROWS: usize = 20 * ROWS;

/// Repeats code for every row of a tile, a constant in it, so that sums stay in registers at any optimisation level.
macro_rules! for_rows {
    (|$row:ident| $body:block) => {
        for_rows!(@ $row $body 0 1 2 3 4 5 6 7 8 9 10 11)
    };
    (@ $row:ident $body:block $($index:literal)*) => {
        $({
            const $row: usize = $index;
            $body
        })*
    };
}
pub(crate) use for_rows;

/// The sums of a tile.
pub(crate) type Tile = [[f32; COLUMNS]; ROWS];

thread_local! {
    /// Packed rows, kept from one product to the next.
    static SCRATCH: Cell<Vec<u32>> = const { Cell::new(Vec::new()) };
}

/// Numbers that large matrix products are made of. Everything else is f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// f32 throughout.
    #[default]
    F32,
    /// Operands rounded to bfloat16, sums in f32: faster on processors with AVX512_BF16, the same bits on others. Only
    /// without gradients on the CPU; elsewhere this is as [`Self::F32`].
    Bf16,
}

impl Precision {
    /// Numbers in a unit.
    fn numbers(self) -> usize {
        match self {
            Self::F32 => 1,
            Self::Bf16 => 2,
        }
    }
}

/// Weights packed for products. `[blocks][panels][units of the block][COLUMNS]`
#[derive(Debug, Clone)]
pub struct PackedWeight {
    units: Vec<u32>,
    inputs: usize,
    outputs: usize,
    precision: Precision,
}

impl PackedWeight {
    /// Packs weights as PyTorch stores them. `[outputs, inputs]`
    pub fn new(weight: &[f32], inputs: usize, precision: Precision) -> Self {
        Self::strided(weight, [weight.len() / inputs.max(1), inputs], [inputs, 1], precision)
    }

    /// Packs weights `(output, input)` that lie at `output * strides[0] + input * strides[1]`.
    pub fn strided(weight: &[f32], [outputs, inputs]: [usize; 2], strides: [usize; 2], precision: Precision) -> Self {
        let (numbers, panels) = (precision.numbers(), outputs.div_ceil(COLUMNS));
        let count = inputs.div_ceil(numbers);
        let mut units = vec![0u32; count * panels * COLUMNS];
        let mut rest = units.as_mut_slice();
        for first in (0..count).step_by(DEPTH) {
            let length = DEPTH.min(count - first);
            let (block, after) = rest.split_at_mut(panels * length * COLUMNS);
            rest = after;
            block
                .par_chunks_mut(length * COLUMNS)
                .enumerate()
                .for_each(|(panel, out)| {
                    let lanes = COLUMNS.min(outputs - panel * COLUMNS);
                    // Some units at a time, so that both sides are read and written in whole cache lines.
                    for (part, out) in out.chunks_mut(16 * COLUMNS).enumerate() {
                        let first = first + 16 * part;
                        match precision {
                            Precision::F32 if strides[0] == 1 => {
                                for (unit, out) in out.chunks_exact_mut(COLUMNS).enumerate() {
                                    let values = &weight[panel * COLUMNS + (first + unit) * strides[1]..][..lanes];
                                    (out.iter_mut().zip(values)).for_each(|(out, value)| *out = value.to_bits());
                                }
                            }
                            Precision::F32 => {
                                for lane in 0..lanes {
                                    let values = &weight[(panel * COLUMNS + lane) * strides[0] + first * strides[1]..];
                                    let out = out.iter_mut().skip(lane).step_by(COLUMNS);
                                    out.zip(values.iter().step_by(strides[1]))
                                        .for_each(|(out, value)| *out = value.to_bits());
                                }
                            }
                            Precision::Bf16 if strides[0] == 1 => {
                                for (unit, out) in out.chunks_exact_mut(COLUMNS).enumerate() {
                                    let row = |input: usize| &weight[panel * COLUMNS + input * strides[1]..][..lanes];
                                    let input = (first + unit) * numbers;
                                    let second = if input + 1 < inputs {
                                        row(input + 1)
                                    } else {
                                        &[0.0; COLUMNS]
                                    };
                                    bf16::pack_two(row(input), second, out);
                                }
                            }
                            Precision::Bf16 => {
                                let at = |lane: usize, input: usize| {
                                    weight[(panel * COLUMNS + lane) * strides[0] + input * strides[1]]
                                };
                                for lane in 0..lanes {
                                    for (unit, out) in out.iter_mut().skip(lane).step_by(COLUMNS).enumerate() {
                                        let input = (first + unit) * numbers;
                                        let second = if input + 1 < inputs { at(lane, input + 1) } else { 0.0 };
                                        *out = bf16::pair(at(lane, input), second);
                                    }
                                }
                            }
                        }
                    }
                });
        }
        Self {
            units,
            inputs,
            outputs,
            precision,
        }
    }

    /// Outputs of a row.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// The product with rows of inputs on all threads. `finish(row, first column, values)` sees every result once, a part of
    /// a row at a time; mark it `#[inline(always)]`. `[rows, inputs]` to `[rows, outputs]`
    pub fn apply(&self, x: &[f32], finish: impl Fn(usize, usize, &mut [f32]) + Sync) -> Vec<f32> {
        let (inputs, outputs) = (self.inputs.max(1), self.outputs.max(1));
        let mut result = vec![0.0f32; x.len() / inputs * self.outputs];
        result
            .par_chunks_mut(TASK_ROWS * outputs)
            .zip(x.par_chunks(TASK_ROWS * inputs))
            .enumerate()
            .for_each(|(task, (result, x))| {
                self.rows(
                    x,
                    result,
                    outputs,
                    #[inline(always)]
                    |row, column, values| finish(task * TASK_ROWS + row, column, values),
                );
            });
        result
    }

    /// The product with rows of inputs on the calling thread; rows of `result` are `stride` apart.
    pub fn rows(&self, x: &[f32], result: &mut [f32], stride: usize, finish: impl Fn(usize, usize, &mut [f32])) {
        let (inputs, outputs, numbers) = (self.inputs, self.outputs, self.precision.numbers());
        let (count, panels) = (inputs.div_ceil(numbers), outputs.div_ceil(COLUMNS));
        let rows = x.len() / inputs.max(1);
        let mut scratch = SCRATCH.take();
        scratch.resize(rows.next_multiple_of(ROWS) * DEPTH, 0);
        for first in (0..count).step_by(DEPTH) {
            let length = DEPTH.min(count - first);
            let is_last = first + length == count;
            for (x, out) in x.chunks(ROWS * inputs).zip(scratch.chunks_exact_mut(ROWS * DEPTH)) {
                for (row, x) in x.chunks_exact(inputs).enumerate() {
                    let x = &x[first * numbers..inputs.min((first + length) * numbers)];
                    self.pack(x, row, out);
                }
            }
            let block = &self.units[first * panels * COLUMNS..][..panels * length * COLUMNS];
            for (panel, weights) in block.chunks_exact(length * COLUMNS).enumerate() {
                let column = panel * COLUMNS;
                let width = COLUMNS.min(outputs - column);
                for (strip, values) in scratch.chunks_exact(ROWS * DEPTH).enumerate() {
                    let mut sums = [[0.0; COLUMNS]; ROWS];
                    if first > 0 {
                        for (sums, out) in sums.iter_mut().zip(result[strip * ROWS * stride..].chunks(stride)) {
                            copy(&out[column..column + width], sums);
                        }
                    }
                    self.tile(values, weights, &mut sums);
                    if is_last {
                        let count = ROWS.min(rows - strip * ROWS);
                        vectorised(
                            #[inline(always)]
                            || {
                                for (row, sums) in sums[..count].iter_mut().enumerate() {
                                    finish(strip * ROWS + row, column, &mut sums[..width]);
                                }
                            },
                        );
                    }
                    for (out, sums) in result[strip * ROWS * stride..].chunks_mut(stride).zip(&sums) {
                        copy(sums, &mut out[column..column + width]);
                    }
                }
            }
        }
        SCRATCH.set(scratch);
    }

    /// Packs a part of one row of a strip: `[DEPTH][ROWS]` of f32, `[ROWS][DEPTH]` of pairs.
    fn pack(&self, x: &[f32], row: usize, out: &mut [u32]) {
        match self.precision {
            Precision::F32 => {
                for (x, out) in x.iter().zip(out.chunks_exact_mut(ROWS)) {
                    out[row] = x.to_bits();
                }
            }
            Precision::Bf16 => bf16::pack(x, &mut out[row * DEPTH..(row + 1) * DEPTH]),
        }
    }

    /// Adds the products of one tile: `values` as packed, `weights [units][COLUMNS]`.
    fn tile(&self, values: &[u32], weights: &[u32], sums: &mut Tile) {
        match self.precision {
            Precision::F32 => Arch::new().dispatch(Single {
                values: bytemuck::cast_slice(values),
                weights: bytemuck::cast_slice(weights),
                sums,
            }),
            Precision::Bf16 => bf16::tile(values, weights, sums),
        }
    }
}

/// Copies as many numbers as both have: mostly a whole row of a tile, whose size the compiler then knows.
fn copy(from: &[f32], to: &mut [f32]) {
    if let (Ok(from), Ok(to)) = (
        <&[f32; COLUMNS]>::try_from(from),
        <&mut [f32; COLUMNS]>::try_from(&mut *to),
    ) {
        *to = *from;
        return;
    }
    let count = from.len().min(to.len());
    to[..count].copy_from_slice(&from[..count]);
}

/// A tile of f32 units.
struct Single<'a> {
    values: &'a [f32],
    weights: &'a [f32],
    sums: &'a mut Tile,
}

impl WithSimd for Single<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // As many sums at a time as registers hold.
        match S::F32_LANES {
            16 => strips::<S, ROWS, 2>(simd, self),
            8 => strips::<S, 3, 4>(simd, self),
            4 => strips::<S, 3, 8>(simd, self),
            _ => strips::<S, 1, COLUMNS>(simd, self),
        }
    }
}

/// A tile, `R` rows of `V` vectors at a time.
#[inline(always)]
fn strips<S: Simd, const R: usize, const V: usize>(simd: S, Single { values, weights, sums }: Single<'_>) {
    for (strip, sums) in sums.chunks_exact_mut(R).enumerate() {
        let mut total = [[simd.splat_f32s(0.0); V]; R];
        for_rows!(|ROW| {
            if ROW < R {
                for vector in 0..V {
                    total[ROW][vector] = S::as_simd_f32s(&sums[ROW]).0[vector];
                }
            }
        });
        let (values, _) = values.as_chunks::<ROWS>();
        for (values, weights) in values.iter().zip(weights.as_chunks::<COLUMNS>().0) {
            let (weights, _) = S::as_simd_f32s(weights);
            for_rows!(|ROW| {
                if ROW < R {
                    let value = simd.splat_f32s(values[strip * R + ROW]);
                    for vector in 0..V {
                        total[ROW][vector] = simd.mul_add_f32s(value, weights[vector], total[ROW][vector]);
                    }
                }
            });
        }
        for_rows!(|ROW| {
            if ROW < R {
                for vector in 0..V {
                    S::as_mut_simd_f32s(&mut sums[ROW]).0[vector] = total[ROW][vector];
                }
            }
        });
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(in super::super) fn noise(count: usize, seed: usize) -> Vec<f32> {
        (0..count)
            .map(|k| (((k * 7919 + seed * 104_729) % 10_009) as f32 / 5004.5) - 1.0)
            .collect()
    }

    #[test]
    fn equals_the_sum_of_products_at_odd_sizes() {
        for precision in [Precision::F32, Precision::Bf16] {
            let operand = |value: f32| match precision {
                Precision::F32 => f64::from(value),
                Precision::Bf16 => f64::from(half::bf16::from_f32(value).to_f32()),
            };
            for (rows, inputs, outputs) in [(1, 1, 1), (13, 7, 33), (250, 64, 40), (12, 513, 32), (25, 1030, 70)] {
                let (x, weight) = (noise(rows * inputs, 1), noise(outputs * inputs, 2));
                let packed = PackedWeight::new(&weight, inputs, precision);
                let found = packed.apply(&x, |row, column, values| {
                    let places = (column..).zip(values);
                    places.for_each(|(column, value)| *value = 2.0 * *value + (row * outputs + column) as f32);
                });
                assert_eq!(found.len(), rows * outputs);
                for (row, x) in x.chunks_exact(inputs).enumerate() {
                    for (output, weight) in weight.chunks_exact(inputs).enumerate() {
                        let terms = x.iter().zip(weight).map(|(a, b)| operand(*a) * operand(*b));
                        let (sum, size) = terms.fold((0.0, 0.0), |(sum, size), term| (sum + term, size + term.abs()));
                        let place = row * outputs + output;
                        let (value, expected) = (f64::from(found[place]), 2.0 * sum + place as f64);
                        assert!(
                            (value - expected).abs() <= 1e-5 * (size + place as f64),
                            "{precision:?} {rows}x{inputs}x{outputs}: {value} {expected}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn strided_operands_and_results() {
        let (rows, inputs, outputs, stride) = (30, 300, 20, 50);
        let (x, weight) = (noise(rows * inputs, 1), noise(outputs * inputs, 2));
        let transposed: Vec<f32> = (0..inputs * outputs)
            .map(|k| weight[(k % outputs) * inputs + k / outputs])
            .collect();
        for precision in [Precision::F32, Precision::Bf16] {
            let expected = PackedWeight::new(&weight, inputs, precision).apply(&x, |_, _, _| {});
            let packed = PackedWeight::strided(&transposed, [outputs, inputs], [1, outputs], precision);
            let mut found = vec![7.0; (rows - 1) * stride + outputs];
            packed.rows(&x, &mut found, stride, |_, _, _| {});
            for (row, expected) in expected.chunks_exact(outputs).enumerate() {
                assert_eq!(&found[row * stride..][..outputs], expected);
            }
            assert_eq!(found[outputs], 7.0, "what lies between rows is left alone");
        }
    }
}
