//! Grey images.

use crate::error::{Error, Result};

/// An 8-bit grey image, row-major.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grey {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Grey {
    /// An image from its pixels. `[H, W]`
    ///
    /// # Errors
    /// When there are more or fewer of them.
    pub fn new(width: usize, height: usize, pixels: Vec<u8>) -> Result<Self> {
        check(width, height, width.saturating_mul(height), pixels.len())?;
        Ok(Self { width, height, pixels })
    }

    /// The luma (ITU-R BT.601) of an RGB image. `[H, W, 3]`
    ///
    /// # Errors
    /// When `rgb` has another length.
    pub fn of_rgb(width: usize, height: usize, rgb: &[u8]) -> Result<Self> {
        check(width, height, width.saturating_mul(height).saturating_mul(3), rgb.len())?;
        let luma = |[r, g, b]: &[u8; 3]| {
            ((299 * u32::from(*r) + 587 * u32::from(*g) + 114 * u32::from(*b) + 500) / 1000) as u8
        };
        let pixels = rgb.as_chunks::<3>().0.iter().map(luma).collect();
        Ok(Self { width, height, pixels })
    }

    /// Width, pixels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, pixels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// The pixels, row-major.
    #[must_use]
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// The image whose row `y` is row `y + rows` of this one, between rows linearly, beyond the border the border.
    pub(crate) fn begun_at_row(&self, rows: f32) -> Self {
        let whole = rows.floor();
        let last = self.height as i64 - 1;
        let of = |row: usize| {
            let upper = row as i64 + whole as i64;
            let [upper, lower] = [upper, upper + 1].map(|row| self.row(row.clamp(0, last) as usize));
            let blend = move |(&upper, &lower): (&u8, &u8)| {
                let (upper, lower) = (f32::from(upper), f32::from(lower));
                (upper + (rows - whole) * (lower - upper)).round() as u8
            };
            upper.iter().zip(lower).map(blend)
        };
        Self {
            width: self.width,
            height: self.height,
            pixels: (0..self.height).flat_map(of).collect(),
        }
    }

    /// One row.
    pub(crate) fn row(&self, row: usize) -> &[u8] {
        &self.pixels[row * self.width..(row + 1) * self.width]
    }
}

fn check(width: usize, height: usize, expected: usize, found: usize) -> Result<()> {
    if width == 0 || height == 0 || expected != found {
        return Err(Error::ImageSize {
            width,
            height,
            expected,
            found,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_moved_and_blended() {
        let image = Grey::new(2, 3, vec![10, 20, 30, 40, 50, 60]).unwrap();
        assert_eq!(image.begun_at_row(0.0), image);
        assert_eq!(image.begun_at_row(1.0).pixels(), [30, 40, 50, 60, 50, 60]);
        assert_eq!(image.begun_at_row(-0.5).pixels(), [10, 20, 20, 30, 40, 50]);
        assert_eq!(image.begun_at_row(0.25).pixels(), [15, 25, 35, 45, 50, 60]);
    }
}
