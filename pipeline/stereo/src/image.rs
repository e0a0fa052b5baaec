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
