//! RGB pictures: put together, and encoded for the page.

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

/// An encoded picture with its caption.
pub(crate) struct Figure {
    /// What it shows.
    pub(crate) caption: String,
    /// For example `image/png`.
    pub(crate) media_type: &'static str,
    /// The file.
    pub(crate) bytes: Vec<u8>,
}

/// Width of the gap between pictures of a strip, pixels.
const GAP: usize = 4;

/// An RGB picture, row-major.
#[derive(Clone)]
pub(super) struct Picture {
    pub(super) width: usize,
    pub(super) height: usize,
    /// `[H, W, 3]`
    pub(super) rgb: Vec<u8>,
}

impl Picture {
    pub(super) fn new(width: usize, height: usize, fill: u8) -> Self {
        Self {
            width,
            height,
            rgb: vec![fill; width * height * 3],
        }
    }

    pub(super) fn from_rgb(width: u32, height: u32, rgb: &[u8]) -> Option<Self> {
        let (width, height) = (width as usize, height as usize);
        (rgb.len() == width * height * 3).then(|| Self {
            width,
            height,
            rgb: rgb.to_vec(),
        })
    }

    pub(super) fn blit(&mut self, source: &Self, left: usize, top: usize) {
        for row in 0..source.height {
            let to = ((top + row) * self.width + left) * 3;
            let from = row * source.width * 3;
            self.rgb[to..to + source.width * 3].copy_from_slice(&source.rgb[from..from + source.width * 3]);
        }
    }

    /// Photographs are JPEG: a report of twelve clips must stay a file that opens at once.
    pub(super) fn jpeg(&self, caption: String) -> Option<Figure> {
        let mut bytes = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut bytes, 88);
        self.write(encoder).then_some(Figure {
            caption,
            media_type: "image/jpeg",
            bytes,
        })
    }

    /// Maps are PNG: their colours are values.
    pub(super) fn png(&self, caption: String) -> Option<Figure> {
        let mut bytes = Vec::new();
        let encoder = PngEncoder::new(&mut bytes);
        self.write(encoder).then_some(Figure {
            caption,
            media_type: "image/png",
            bytes,
        })
    }

    /// Whether the encoder took the picture.
    fn write(&self, encoder: impl ImageEncoder) -> bool {
        let (width, height) = (self.width as u32, self.height as u32);
        encoder
            .write_image(&self.rgb, width, height, ExtendedColorType::Rgb8)
            .is_ok()
    }
}

/// A recorded image as a JPEG file; none where it has not that size.
pub(crate) fn photograph(width: u32, height: u32, rgb: &[u8]) -> Option<Vec<u8>> {
    let figure = Picture::from_rgb(width, height, rgb)?.jpeg(String::new())?;
    Some(figure.bytes)
}

/// Pictures in rows and columns, missing ones left grey. All cells have the size of the first picture.
pub(super) fn grid(rows: &[Vec<Option<Picture>>]) -> Option<Picture> {
    let first = rows.iter().flatten().flatten().next()?;
    let (width, height) = (first.width, first.height);
    let columns = rows.iter().map(Vec::len).max()?;
    let mut sheet = Picture::new(columns * (width + GAP) - GAP, rows.len() * (height + GAP) - GAP, 128);
    for (row, cells) in rows.iter().enumerate() {
        for (column, cell) in cells.iter().enumerate() {
            if let Some(cell) = cell
                .as_ref()
                .filter(|cell| cell.width == width && cell.height == height)
            {
                sheet.blit(cell, column * (width + GAP), row * (height + GAP));
            }
        }
    }
    Some(sheet)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_with_a_missing_picture_keeps_its_place() {
        let cell = Picture::new(2, 2, 255);
        let sheet = grid(&[vec![Some(cell.clone()), None], vec![None, Some(cell)]]).unwrap();
        assert_eq!((sheet.width, sheet.height), (2 * 2 + GAP, 2 * 2 + GAP));
        assert_eq!(&sheet.rgb[..3], [255, 255, 255]);
        assert_eq!(&sheet.rgb[(2 + GAP) * 3..(2 + GAP) * 3 + 3], [128, 128, 128]);
    }
}
