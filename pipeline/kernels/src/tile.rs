//! The shape of the tiles that matrix products are made of, beside the instruction paths that sum them.

/// Rows of a tile.
pub(crate) const ROWS: usize = 12;
/// Columns of a tile: outputs whose weights lie side by side.
pub(crate) const COLUMNS: usize = 32;

/// Numbers side by side, in whole cache lines: results of a row of a tile, weights of one unit for all columns, or units
/// of one row of the left operand. A unit is one f32, or the bits of a pair of bfloat16 numbers ([`Line::pairs`]).
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(crate) struct Line(pub(crate) [f32; COLUMNS]);

impl Line {
    /// All zero.
    pub(crate) const ZERO: Self = Self([0.0; COLUMNS]);

    /// The line as pairs.
    #[inline(always)]
    pub(crate) fn pairs(&self) -> &[u32; COLUMNS] {
        bytemuck::cast_ref(&self.0)
    }

    /// The line as pairs.
    #[inline(always)]
    pub(crate) fn pairs_mut(&mut self) -> &mut [u32; COLUMNS] {
        bytemuck::cast_mut(&mut self.0)
    }
}

/// Makes a vector at least so long; what is in it has no meaning.
pub(crate) fn resized(lines: &mut Vec<Line>, length: usize) -> &mut [Line] {
    if lines.len() < length {
        lines.resize(length, Line::ZERO);
    }
    &mut lines[..length]
}

/// Copies as many numbers as both have: mostly a whole row of a tile, whose size the compiler then knows.
#[inline(always)]
pub(crate) fn copy(from: &[f32], to: &mut [f32]) {
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
