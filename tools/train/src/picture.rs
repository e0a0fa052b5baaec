//! Pictures of held-out clips, and how much they resemble what a camera saw.

use std::path::Path;

use crate::error::{Error, Result};

/// RGB rows.
#[derive(Debug, Clone, Default)]
pub struct Picture {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `[H, W, 3]`
    pub rgb: Vec<u8>,
}

impl Picture {
    /// Writes a PNG.
    pub(crate) fn save(&self, path: &Path) -> Result<()> {
        let failed = |reason: String| Error::Folder {
            path: path.to_owned(),
            reason,
        };
        let mut png = std::io::Cursor::new(Vec::new());
        image::RgbImage::from_raw(self.width, self.height, self.rgb.clone())
            .ok_or_else(|| failed("the picture has another size than its pixels".into()))?
            .write_to(&mut png, image::ImageFormat::Png)
            .map_err(|error| failed(error.to_string()))?;
        Ok(rogs_files::write_bytes(path, png.get_ref())?)
    }
}

/// A picture of equal cells.
pub(crate) struct Canvas {
    cell: [usize; 2],
    columns: usize,
    picture: Picture,
}

impl Canvas {
    /// A black picture of `rows x columns` cells of `height x width` pixels.
    pub(crate) fn new(cell: [usize; 2], [rows, columns]: [usize; 2]) -> Self {
        let (height, width) = (rows * cell[0], columns * cell[1]);
        Self {
            cell,
            columns,
            picture: Picture {
                width: width as u32,
                height: height as u32,
                rgb: vec![0; height * width * 3],
            },
        }
    }

    /// Fills the cell at a row and column with `value(pixel, channel)` in 0..1.
    pub(crate) fn paint(&mut self, [row, column]: [usize; 2], value: impl Fn(usize, usize) -> f32) {
        let [height, width] = self.cell;
        for pixel in 0..height * width {
            let (y, x) = (row * height + pixel / width, column * width + pixel % width);
            for channel in 0..3 {
                self.picture.rgb[(y * self.columns * width + x) * 3 + channel] = byte(value(pixel, channel));
            }
        }
    }

    /// The picture.
    pub(crate) fn finish(self) -> Picture {
        self.picture
    }
}

/// A value in 0..1 as a byte.
fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// PSNR of an image against its reference, both in 0..1, dB.
pub(crate) fn peak_signal(image: &[f32], reference: &[f32]) -> f64 {
    let square = image
        .iter()
        .zip(reference)
        .map(|(a, b)| f64::from(a.clamp(0.0, 1.0) - b).powi(2));
    -10.0 * libm::log10((square.sum::<f64>() / reference.len() as f64).max(1e-10))
}
