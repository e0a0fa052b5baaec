//! Feature maps in panels of channels with a border of zeros, which the convolutions read without asking for the edge.

/// Channels that lie together.
pub(super) const PANEL: usize = 32;

/// Values of one pixel for the channels of one panel.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Pixel(pub(super) [f32; PANEL]);

impl Pixel {
    pub(super) const ZERO: Self = Self([0.0; PANEL]);
}

/// Zeros, or a shorter vector's start: what `values` held before is of no meaning.
pub(super) fn resized(values: &mut Vec<Pixel>, length: usize) -> &mut [Pixel] {
    if values.len() < length {
        values.resize(length, Pixel::ZERO);
    }
    &mut values[..length]
}

/// Tiles are at most so many pixels wide; the border is rounded up to them.
const ROUND: usize = 4;

/// The maps of one layer. `[panels][rows][columns]`, pixel (0, 0) of the image at row 1, column 1.
///
/// Channels beyond the layer's own, up to a whole panel, are zero.
#[derive(Debug, Default)]
pub(super) struct Maps {
    pub(super) panels: usize,
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) rows: usize,
    pub(super) columns: usize,
    values: Vec<Pixel>,
}

impl Maps {
    /// Takes another size. The border becomes zero; pixels of the image hold nothing of meaning until they are written.
    pub(super) fn reshape(&mut self, panels: usize, height: usize, width: usize) {
        let (rows, columns) = (height.next_multiple_of(ROUND) + 2, width.next_multiple_of(ROUND) + 2);
        (self.panels, self.height, self.width) = (panels, height, width);
        (self.rows, self.columns) = (rows, columns);
        let values = resized(&mut self.values, panels * rows * columns);
        for plane in values.chunks_exact_mut(rows * columns) {
            for (row, pixels) in plane.chunks_exact_mut(columns).enumerate() {
                if row == 0 || row > height {
                    pixels.fill(Pixel::ZERO);
                } else {
                    pixels[0] = Pixel::ZERO;
                    pixels[width + 1..].fill(Pixel::ZERO);
                }
            }
        }
    }

    /// Pixels of a plane, border included.
    pub(super) fn plane(&self) -> usize {
        self.rows * self.columns
    }

    /// All planes.
    pub(super) fn values(&self) -> &[Pixel] {
        &self.values[..self.panels * self.plane()]
    }

    /// All planes.
    pub(super) fn values_mut(&mut self) -> &mut [Pixel] {
        let length = self.panels * self.plane();
        &mut self.values[..length]
    }

    /// The pixels of one row of the image, without border.
    pub(super) fn row(&self, panel: usize, row: usize) -> &[Pixel] {
        &self.values[panel * self.plane() + (row + 1) * self.columns + 1..][..self.width]
    }

    /// The image's rows in bands of `count`: for each band the rows of every panel, borders left and right included.
    pub(super) fn bands(&mut self, count: usize) -> Vec<Vec<&mut [Pixel]>> {
        let (plane, columns, panels) = (self.plane(), self.columns, self.panels);
        let mut bands: Vec<Vec<_>> = (0..self.height.div_ceil(count))
            .map(|_| Vec::with_capacity(panels))
            .collect();
        for plane in self.values_mut().chunks_exact_mut(plane) {
            let rows = plane[columns..].chunks_mut(count * columns);
            for (band, rows) in bands.iter_mut().zip(rows) {
                band.push(rows);
            }
        }
        bands
    }
}
