//! Operands of matrix products: matrices in slices, and the numbers that products are made of.

use std::ops::Range;

use crate::bf16;
use crate::tile::{COLUMNS, Line, ROWS, copy};

/// Numbers that large matrix products are made of. Everything else is f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// f32 throughout.
    #[default]
    F32,
    /// Operands rounded to bfloat16, sums in f32: faster on CPUs with AVX512_BF16, the same bits on others. Only
    /// without gradients on the CPU; elsewhere this is as [`Self::F32`].
    Bf16,
}

impl Precision {
    /// Numbers in a unit.
    pub(crate) fn numbers(self) -> usize {
        match self {
            Self::F32 => 1,
            Self::Bf16 => 2,
        }
    }
}

/// A matrix in a slice: `(row, column)` lies at `row * strides[0] + column * strides[1]`.
#[derive(Debug, Clone, Copy)]
pub struct Matrix<'a> {
    values: &'a [f32],
    size: [usize; 2],
    strides: [usize; 2],
}

impl<'a> Matrix<'a> {
    /// All of a slice, row by row.
    #[must_use]
    pub fn new(values: &'a [f32], columns: usize) -> Self {
        Self::strided(values, [values.len() / columns.max(1), columns], [columns, 1])
    }

    /// Rows and columns at some distance.
    ///
    /// # Panics
    /// When the slice ends before the last number.
    #[must_use]
    pub fn strided(values: &'a [f32], size: [usize; 2], strides: [usize; 2]) -> Self {
        if let [Some(row), Some(column)] = size.map(|count| count.checked_sub(1)) {
            assert!(
                row * strides[0] + column * strides[1] < values.len(),
                "the matrix is longer than its slice"
            );
        }
        Self { values, size, strides }
    }

    /// Rows and columns exchanged.
    #[must_use]
    pub fn transposed(self) -> Self {
        let ([rows, columns], [down, across]) = (self.size, self.strides);
        Self {
            size: [columns, rows],
            strides: [across, down],
            ..self
        }
    }

    /// Rows and columns.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// The unit of a row that begins at a column.
    #[inline(always)]
    fn unit(&self, row: usize, column: usize, precision: Precision) -> u32 {
        let at = |column: usize| self.values[row * self.strides[0] + column * self.strides[1]];
        match precision {
            Precision::F32 => at(column).to_bits(),
            Precision::Bf16 => {
                let second = if column + 1 < self.size[1] { at(column + 1) } else { 0.0 };
                bf16::pair(at(column), second)
            }
        }
    }

    /// Units of some neighbouring rows at one column.
    fn across(&self, row: usize, column: usize, precision: Precision, out: &mut [u32]) {
        if self.strides[0] != 1 {
            for (row, out) in (row..).zip(out) {
                *out = self.unit(row, column, precision);
            }
            return;
        }
        let count = out.len();
        let at = |column: usize| &self.values[row + column * self.strides[1]..][..count];
        match precision {
            Precision::F32 => {
                for (out, value) in out.iter_mut().zip(at(column)) {
                    *out = value.to_bits();
                }
            }
            Precision::Bf16 if column + 1 < self.size[1] => bf16::pack_two(at(column), at(column + 1), out),
            Precision::Bf16 => bf16::pack_two(at(column), &[0.0; COLUMNS], out),
        }
    }

    /// Units of one row from a column on, as many as there are and fit.
    fn along(&self, row: usize, column: usize, precision: Precision, line: &mut Line) {
        let count = self.size[1].saturating_sub(column).min(COLUMNS * precision.numbers());
        if self.strides[1] != 1 {
            for (unit, out) in line
                .pairs_mut()
                .iter_mut()
                .take(count.div_ceil(precision.numbers()))
                .enumerate()
            {
                *out = self.unit(row, column + unit * precision.numbers(), precision);
            }
            return;
        }
        let values = &self.values[row * self.strides[0] + column..][..count];
        match precision {
            Precision::F32 => copy(values, &mut line.0),
            Precision::Bf16 => bf16::pack(values, line.pairs_mut()),
        }
    }

    /// A panel of weights: the units of at most [`COLUMNS`] rows side by side, a line for each unit.
    pub(crate) fn panel(&self, rows: Range<usize>, precision: Precision, lines: &mut [Line]) {
        // Some units at a time, so that both sides are read and written in whole cache lines.
        const PART: usize = 16;
        for (part, lines) in lines.chunks_mut(PART).enumerate() {
            let column = |unit: usize| (PART * part + unit) * precision.numbers();
            if self.strides[0] == 1 {
                for (unit, line) in lines.iter_mut().enumerate() {
                    self.across(rows.start, column(unit), precision, &mut line.pairs_mut()[..rows.len()]);
                }
                continue;
            }
            for (lane, row) in rows.clone().enumerate() {
                let values = &self.values[row * self.strides[0] + column(0) * self.strides[1]..];
                match precision {
                    Precision::F32 => {
                        for (line, value) in lines.iter_mut().zip(values.iter().step_by(self.strides[1])) {
                            line.0[lane] = *value;
                        }
                    }
                    Precision::Bf16 => {
                        for (unit, line) in lines.iter_mut().enumerate() {
                            line.pairs_mut()[lane] = self.unit(row, column(unit), precision);
                        }
                    }
                }
            }
        }
    }

    /// A strip of the left operand: units of at most [`ROWS`] rows from `first` on. `[chunks][ROWS]`, a line for each
    /// [`COLUMNS`] units of a row
    pub(crate) fn strip(&self, rows: Range<usize>, first: usize, precision: Precision, out: &mut [Line]) {
        for (chunk, lines) in out.chunks_exact_mut(ROWS).enumerate() {
            let column = (first + chunk * COLUMNS) * precision.numbers();
            if self.strides[0] == 1 && self.strides[1] != 1 {
                let mut units = [0; ROWS];
                let units = &mut units[..rows.len()];
                for unit in 0..COLUMNS {
                    let column = column + unit * precision.numbers();
                    if column >= self.size[1] {
                        break;
                    }
                    self.across(rows.start, column, precision, units);
                    for (line, value) in lines.iter_mut().zip(&*units) {
                        line.pairs_mut()[unit] = *value;
                    }
                }
            } else {
                for (row, line) in rows.clone().zip(lines) {
                    self.along(row, column, precision, line);
                }
            }
        }
    }
}
