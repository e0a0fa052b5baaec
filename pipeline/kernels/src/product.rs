//! Matrix products x W^T on slices.
//!
//! Weights are packed into panels of [`COLUMNS`] outputs. Rows of the left operand lie in chunks of as many units, a strip
//! of at most [`ROWS`] rows at a time: units are summed in blocks of [`DEPTH`], so that a tile's operands lie in the
//! first-level cache and its sums in registers. A unit is one f32, or where CPUs are made for it a pair of numbers rounded
//! to bfloat16 whose products are summed in f32 ([`Precision::Bf16`]). A sum takes its terms in ascending order, whatever the number of threads, of
//! rows in a strip and of units in a block.

use std::cell::Cell;
use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::matrix::Units;
use crate::tile::{COLUMNS, Line, ROWS, copy, for_rows, resized};
use crate::{Matrix, Precision, bf16, vectorised};

/// Units that are summed in one go.
const DEPTH: usize = 128;
/// Lines of a strip.
const STRIP: usize = DEPTH / COLUMNS * ROWS;
/// Rows of a task.
const TASK_ROWS: usize = 20 * ROWS;

thread_local! {
    /// Strips of the left operand, kept from one product to the next.
    static SCRATCH: Cell<Vec<Line>> = const { Cell::new(Vec::new()) };
}

/// Weights packed for products. `[panels][units]`, a line for each unit
#[derive(Debug, Clone)]
pub struct PackedWeight {
    lines: Vec<Line>,
    inputs: usize,
    outputs: usize,
    units: Units,
}

impl PackedWeight {
    /// Packs weights as PyTorch stores them. `[outputs, inputs]`
    #[must_use]
    pub fn new(weight: &[f32], inputs: usize, precision: Precision) -> Self {
        Self::of(Matrix::new(weight, inputs), precision)
    }

    /// Packs any matrix of weights. `[outputs, inputs]`
    #[must_use]
    pub fn of(weight: Matrix<'_>, precision: Precision) -> Self {
        let ([outputs, inputs], units) = (weight.size(), Units::of(precision));
        let count = units.count(inputs);
        let mut lines = vec![Line::ZERO; outputs.div_ceil(COLUMNS) * count];
        lines
            .par_chunks_mut(count.max(1))
            .enumerate()
            .for_each(|(panel, lines)| {
                let outputs = panel * COLUMNS..outputs.min((panel + 1) * COLUMNS);
                weight.panel(outputs, units, lines);
            });
        Self {
            lines,
            inputs,
            outputs,
            units,
        }
    }

    /// Outputs of a row.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// The product with rows of inputs on all threads. `finish(row, first column, values)` sees every result once, a part of
    /// a row at a time; mark it `#[inline(always)]`. `[rows, inputs]` to `[rows, outputs]`
    pub fn apply(&self, x: &[f32], finish: impl Fn(usize, usize, &mut [f32]) + Sync) -> Vec<f32> {
        self.apply_to(Matrix::new(x, self.inputs), finish)
    }

    /// [`Self::apply`] to the rows of any matrix.
    pub fn apply_to(&self, x: Matrix<'_>, finish: impl Fn(usize, usize, &mut [f32]) + Sync) -> Vec<f32> {
        let mut result = vec![0.0f32; x.size()[0] * self.outputs];
        result
            .par_chunks_mut(TASK_ROWS * self.outputs.max(1))
            .enumerate()
            .for_each(|(task, result)| {
                let rows = task * TASK_ROWS..x.size()[0].min((task + 1) * TASK_ROWS);
                self.run(
                    x,
                    rows,
                    (result, self.outputs, false),
                    #[inline(always)]
                    |row, column, values| finish(task * TASK_ROWS + row, column, values),
                );
            });
        result
    }

    /// The product with rows of inputs on the calling thread; rows of `result` are `stride` apart.
    pub fn rows(&self, x: &[f32], result: &mut [f32], stride: usize, finish: impl Fn(usize, usize, &mut [f32])) {
        let x = Matrix::new(x, self.inputs);
        self.run(x, 0..x.size()[0], (result, stride, false), finish);
    }

    /// Adds the product with the rows of any matrix to `result`, on the calling thread. `[rows, outputs]`
    pub fn add_rows(&self, x: Matrix<'_>, result: &mut [f32]) {
        self.run(x, 0..x.size()[0], (result, self.outputs, true), |_, _, _| {});
    }

    /// The product with some rows; `result` with its stride, and whether to add to what is there.
    fn run(
        &self,
        x: Matrix<'_>,
        rows: Range<usize>,
        (result, stride, add): (&mut [f32], usize, bool),
        finish: impl Fn(usize, usize, &mut [f32]),
    ) {
        if rows.is_empty() {
            return;
        }
        let count = self.units.count(self.inputs);
        let strips = rows.len().div_ceil(ROWS);
        let mut scratch = SCRATCH.take();
        let packed = resized(&mut scratch, strips * STRIP);
        for first in (0..count).step_by(DEPTH) {
            let length = DEPTH.min(count - first);
            let (is_last, add) = (first + length == count, add || first > 0);
            for (strip, out) in packed.chunks_exact_mut(STRIP).enumerate() {
                let own = rows_of(strip, rows.len());
                let own = rows.start + own.start..rows.start + own.end;
                x.strip(own, first, self.units, &mut out[..length.div_ceil(COLUMNS) * ROWS]);
            }
            for (panel, weights) in self.lines.chunks_exact(count).enumerate() {
                let column = panel * COLUMNS;
                let width = COLUMNS.min(self.outputs - column);
                let panel = Panel {
                    values: packed,
                    rows: rows.len(),
                    weights: &weights[first..first + length],
                    result: &mut result[column..],
                    stride,
                    add,
                };
                match self.units {
                    Units::Pairs => panel.by_strips(width, |values, weights, sums| {
                        bf16::product(values, ROWS, weights, sums);
                    }),
                    _ if width == COLUMNS => Arch::new().dispatch(panel),
                    _ => panel.by_strips(width, |values, weights, sums| {
                        product(values, ROWS, weights, sums, true);
                    }),
                }
                if is_last {
                    vectorised(
                        #[inline(always)]
                        || {
                            for (row, values) in result[column..].chunks_mut(stride).take(rows.len()).enumerate() {
                                finish(row, column, &mut values[..width]);
                            }
                        },
                    );
                }
            }
        }
        SCRATCH.set(scratch);
    }
}

/// The rows of a strip, of as many as there are: strips are as alike as can be.
fn rows_of(strip: usize, rows: usize) -> Range<usize> {
    let strips = rows.div_ceil(ROWS);
    strip * rows / strips..(strip + 1) * rows / strips
}

/// Some units of one panel of weights, for all strips.
struct Panel<'a> {
    /// The strips.
    values: &'a [Line],
    /// Rows of all strips together.
    rows: usize,
    weights: &'a [Line],
    /// From the panel's first column on; rows are `stride` apart.
    result: &'a mut [f32],
    stride: usize,
    /// Whether to add to what is there.
    add: bool,
}

impl Panel<'_> {
    /// Strip by strip, `product(values, weights, sums)` adding to the sums of its rows, of which `width` are results.
    fn by_strips(self, width: usize, product: impl Fn(&[Line], &[Line], &mut [Line])) {
        for (strip, values) in self.values.chunks_exact(STRIP).enumerate() {
            let own = rows_of(strip, self.rows);
            let mut sums = [Line::ZERO; ROWS];
            let sums = &mut sums[..own.len()];
            let result = &mut self.result[own.start * self.stride..];
            if self.add {
                for (sums, result) in sums.iter_mut().zip(result.chunks(self.stride)) {
                    copy(&result[..width], &mut sums.0);
                }
            }
            product(values, self.weights, sums);
            for (result, sums) in result.chunks_mut(self.stride).zip(&*sums) {
                copy(&sums.0, &mut result[..width]);
            }
        }
    }
}

impl WithSimd for Panel<'_> {
    type Output = ();

    /// Of a panel with as many outputs as it can have: sums go from registers to the result.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for (strip, values) in self.values.chunks_exact(STRIP).enumerate() {
            let own = rows_of(strip, self.rows);
            let out = Strided {
                values: &mut self.result[own.start * self.stride..],
                stride: self.stride,
            };
            Product {
                values,
                stride: ROWS,
                weights: self.weights,
                rows: own.len(),
                out,
                add: self.add,
            }
            .with_simd(simd);
        }
    }
}

/// Sums `values * weights` for any number of rows and one panel of weights, `weights` a line for each unit. Chunk `c` of row
/// `r` is line `c * stride + r` of `values`; the sums are added to what is in `out` if `add`.
///
/// A sum takes its terms in ascending order, so how rows are grouped does not matter.
pub(crate) fn product(values: &[Line], stride: usize, weights: &[Line], out: &mut [Line], add: bool) {
    Arch::new().dispatch(Product {
        values,
        stride,
        weights,
        rows: out.len(),
        out,
        add,
    });
}

/// Where the sums of rows lie.
trait Sums {
    /// The sums of a row.
    fn row(&mut self, row: usize) -> &mut [f32];
}

impl Sums for &mut [Line] {
    #[inline(always)]
    fn row(&mut self, row: usize) -> &mut [f32] {
        &mut self[row].0
    }
}

/// Rows at a distance.
struct Strided<'a> {
    values: &'a mut [f32],
    stride: usize,
}

impl Sums for Strided<'_> {
    #[inline(always)]
    fn row(&mut self, row: usize) -> &mut [f32] {
        &mut self.values[row * self.stride..][..COLUMNS]
    }
}

struct Product<'a, O> {
    values: &'a [Line],
    stride: usize,
    weights: &'a [Line],
    rows: usize,
    out: O,
    add: bool,
}

impl<O: Sums> WithSimd for Product<'_, O> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // As many sums at a time as registers hold.
        match S::F32_LANES {
            16 => self.groups::<S, ROWS, 2>(simd),
            8 => self.groups::<S, 3, 4>(simd),
            4 => self.groups::<S, 3, 8>(simd),
            _ => self.groups::<S, 1, COLUMNS>(simd),
        }
    }
}

/// Runs code for a number of rows from 1 to [`ROWS`], a constant in it.
macro_rules! with_rows {
    ($count:expr, |$rows:ident| $body:block) => {
        with_rows!(@ $count, $rows $body 1 2 3 4 5 6 7 8 9 10 11 12)
    };
    (@ $count:expr, $rows:ident $body:block $($index:literal)*) => {
        match $count {
            $($index => {
                const $rows: usize = $index;
                $body
            })*
            _ => {}
        }
    };
}

impl<O: Sums> Product<'_, O> {
    /// Groups of at most `MOST` rows, as alike as can be, `V` vectors of columns each.
    #[inline(always)]
    fn groups<S: Simd, const MOST: usize, const V: usize>(mut self, simd: S) {
        let count = self.rows;
        let groups = count.div_ceil(MOST);
        let mut first = 0;
        for group in 0..groups {
            let next = (group + 1) * count / groups;
            with_rows!(next - first, |R| {
                if R <= MOST {
                    self.rows::<S, R, V>(simd, first);
                }
            });
            first = next;
        }
    }

    /// The sums of `R` rows.
    #[inline(always)]
    fn rows<S: Simd, const R: usize, const V: usize>(&mut self, simd: S, first: usize) {
        let mut total = [[simd.splat_f32s(0.0); V]; R];
        if self.add {
            for_rows!(|ROW| {
                if ROW < R {
                    let (sums, _) = S::as_simd_f32s(self.out.row(first + ROW));
                    total[ROW].copy_from_slice(&sums[..V]);
                }
            });
        }
        let values = self.values[first..].chunks(self.stride);
        for (values, weights) in values.zip(self.weights.chunks(COLUMNS)) {
            let Some(values) = values.first_chunk::<R>() else {
                return;
            };
            for (unit, weights) in (0..COLUMNS).zip(weights) {
                let (weights, _) = S::as_simd_f32s(&weights.0);
                for_rows!(|ROW| {
                    if ROW < R {
                        let value = simd.splat_f32s(values[ROW].0[unit]);
                        for vector in 0..V {
                            total[ROW][vector] = simd.mul_add_f32s(value, weights[vector], total[ROW][vector]);
                        }
                    }
                });
            }
        }
        for_rows!(|ROW| {
            if ROW < R {
                let (sums, _) = S::as_mut_simd_f32s(self.out.row(first + ROW));
                sums[..V].copy_from_slice(&total[ROW]);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::noise;

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
        let turned = |values: &[f32], rows: usize| -> Vec<f32> {
            let columns = values.len() / rows;
            (0..values.len())
                .map(|k| values[k % rows * columns + k / rows])
                .collect()
        };
        let (turned_x, turned_weight) = (turned(&x, rows), turned(&weight, outputs));
        for precision in [Precision::F32, Precision::Bf16] {
            let expected = PackedWeight::new(&weight, inputs, precision).apply(&x, |_, _, _| {});
            let packed = PackedWeight::of(Matrix::new(&turned_weight, outputs).transposed(), precision);
            let mut found = vec![7.0; (rows - 1) * stride + outputs];
            packed.rows(&x, &mut found, stride, |_, _, _| {});
            for (row, expected) in expected.chunks_exact(outputs).enumerate() {
                assert_eq!(&found[row * stride..][..outputs], expected);
            }
            assert_eq!(found[outputs], 7.0, "what lies between rows is left alone");
            let x = Matrix::new(&turned_x, rows).transposed();
            assert_eq!(packed.apply_to(x, |_, _, _| {}), expected);
            // Every second column of a matrix twice as wide.
            let spread: Vec<f32> = turned_x.iter().flat_map(|&value| [value, f32::NAN]).collect();
            let x = Matrix::strided(&spread, [rows, inputs], [2, 2 * rows]);
            assert_eq!(packed.apply_to(x, |_, _, _| {}), expected);
            let mut sums = vec![1.0; rows * outputs];
            packed.add_rows(x, &mut sums);
            for (sum, expected) in sums.iter().zip(&expected) {
                assert!((sum - expected - 1.0).abs() < 1e-4);
            }
        }
    }
}
