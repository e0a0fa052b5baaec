//! The tile of a convolution's weight gradient, beside the instruction paths that sum it.

/// Outputs whose sums are in registers.
pub(crate) const OUTPUTS: usize = 4;
/// Inputs whose sums are in registers.
pub(crate) const INPUTS: usize = 2;
/// Columns of a row of taps, and rows of taps.
pub(crate) const SIDE: usize = 3;

/// Sums of a tile.
pub(crate) type Sums = [[[f32; SIDE]; INPUTS]; OUTPUTS];

/// One row of taps of a few outputs and inputs.
pub(crate) struct Tile<'a, T> {
    /// Planes of the result's gradient.
    pub(crate) gradient: [&'a [T]; OUTPUTS],
    /// Planes of the input, with a row and a column of zeros around.
    pub(crate) input: [&'a [T]; INPUTS],
    /// Distances of rows in the two.
    pub(crate) strides: [usize; 2],
    /// The row of taps.
    pub(crate) row: usize,
    /// Height and width of the maps.
    pub(crate) size: [usize; 2],
}
