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
    /// Operands rounded to bfloat16, sums in f32: faster where [`bf16_is_fast`], as fast as f32 and the same bits on
    /// other CPUs. Only without gradients on the CPU; elsewhere this is as [`Self::F32`].
    Bf16,
}

/// Whether this CPU multiplies bfloat16 faster than f32: it has AVX512_BF16 and is an AMD's. Intel's make one such instruction
/// where they make two on f32, which comes to the same.
#[must_use]
pub fn bf16_is_fast() -> bool {
    #[cfg(target_arch = "x86_64")]
    return bf16::is_fast();
    #[cfg(not(target_arch = "x86_64"))]
    false
}

/// What an operand's row is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Units {
    /// Single numbers.
    Numbers,
    /// Pairs of numbers rounded to bfloat16, for the instruction that multiplies these.
    Pairs,
    /// Numbers rounded to bfloat16, as f32, of each pair the second one first: summed one after the other, they give what
    /// that instruction gives.
    Swapped,
}

impl Units {
    /// What this CPU is best at.
    pub(crate) fn of(precision: Precision) -> Self {
        match precision {
            Precision::F32 => Self::Numbers,
            Precision::Bf16 if bf16_is_fast() => Self::Pairs,
            Precision::Bf16 => Self::Swapped,
        }
    }

    /// Numbers in a unit.
    pub(crate) fn numbers(self) -> usize {
        match self {
            Self::Numbers | Self::Swapped => 1,
            Self::Pairs => 2,
        }
    }

    /// Units of a row of numbers.
    pub(crate) fn count(self, numbers: usize) -> usize {
        match self {
            Self::Numbers => numbers,
            Self::Pairs => numbers.div_ceil(2),
            Self::Swapped => numbers.next_multiple_of(2),
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
    fn unit(&self, row: usize, column: usize, units: Units) -> u32 {
        let at = |column: usize| {
            if column < self.size[1] {
                self.values[row * self.strides[0] + column * self.strides[1]]
            } else {
                0.0
            }
        };
        match units {
            Units::Numbers => at(column).to_bits(),
            Units::Pairs => bf16::pair(at(column), at(column + 1)),
            Units::Swapped => bf16::rounded(at(column ^ 1)) << 16,
        }
    }

    /// Units of some neighbouring rows at one column.
    fn across(&self, row: usize, column: usize, units: Units, out: &mut [u32]) {
        if self.strides[0] != 1 {
            for (row, out) in (row..).zip(out) {
                *out = self.unit(row, column, units);
            }
            return;
        }
        let count = out.len();
        let at = |column: usize| {
            if column < self.size[1] {
                &self.values[row + column * self.strides[1]..][..count]
            } else {
                &[0.0; COLUMNS][..count]
            }
        };
        match units {
            Units::Numbers => {
                for (out, value) in out.iter_mut().zip(at(column)) {
                    *out = value.to_bits();
                }
            }
            Units::Pairs => bf16::pack_two(at(column), at(column + 1), out),
            Units::Swapped => bf16::round(at(column ^ 1), out),
        }
    }

    /// Units of one row from a column on, as many as there are and fit.
    fn along(&self, row: usize, column: usize, units: Units, line: &mut Line) {
        let numbers = units.numbers();
        let count = self.size[1].saturating_sub(column).min(COLUMNS * numbers);
        if self.strides[1] != 1 {
            let whole = line.pairs_mut().iter_mut().take(units.count(count));
            for (unit, out) in whole.enumerate() {
                *out = self.unit(row, column + unit * numbers, units);
            }
            return;
        }
        let values = &self.values[row * self.strides[0] + column..][..count];
        match units {
            Units::Numbers => copy(values, &mut line.0),
            Units::Pairs => bf16::pack(values, line.pairs_mut()),
            Units::Swapped => bf16::round_swapped(values, line.pairs_mut()),
        }
    }

    /// A panel of weights: the units of at most [`COLUMNS`] rows side by side, a line for each unit.
    pub(crate) fn panel(&self, rows: Range<usize>, units: Units, lines: &mut [Line]) {
        // Some units at a time, so that both sides are read and written in whole cache lines.
        const PART: usize = 16;
        for (part, lines) in lines.chunks_mut(PART).enumerate() {
            let column = |unit: usize| (PART * part + unit) * units.numbers();
            if self.strides[0] == 1 {
                for (unit, line) in lines.iter_mut().enumerate() {
                    self.across(rows.start, column(unit), units, &mut line.pairs_mut()[..rows.len()]);
                }
                continue;
            }
            for (lane, row) in rows.clone().enumerate() {
                let values = &self.values[row * self.strides[0] + column(0) * self.strides[1]..];
                match units {
                    Units::Numbers => {
                        for (line, value) in lines.iter_mut().zip(values.iter().step_by(self.strides[1])) {
                            line.0[lane] = *value;
                        }
                    }
                    Units::Pairs | Units::Swapped => {
                        for (unit, line) in lines.iter_mut().enumerate() {
                            line.pairs_mut()[lane] = self.unit(row, column(unit), units);
                        }
                    }
                }
            }
        }
    }

    /// A strip of the left operand: units of at most [`ROWS`] rows from `first` on. `[chunks][ROWS]`, a line for each
    /// [`COLUMNS`] units of a row
    pub(crate) fn strip(&self, rows: Range<usize>, first: usize, units: Units, out: &mut [Line]) {
        for (chunk, lines) in out.chunks_exact_mut(ROWS).enumerate() {
            let column = (first + chunk * COLUMNS) * units.numbers();
            if self.strides[0] == 1 && self.strides[1] != 1 {
                let mut values = [0; ROWS];
                let values = &mut values[..rows.len()];
                let last = units.count(self.size[1]) * units.numbers();
                for unit in 0..COLUMNS {
                    let column = column + unit * units.numbers();
                    if column >= last {
                        break;
                    }
                    self.across(rows.start, column, units, values);
                    for (line, value) in lines.iter_mut().zip(&*values) {
                        line.pairs_mut()[unit] = *value;
                    }
                }
            } else {
                for (row, line) in rows.clone().zip(lines) {
                    self.along(row, column, units, line);
                }
            }
        }
    }
}
