//! PNG images.

use std::io::BufReader;
use std::path::{Path, PathBuf};

use image::codecs::png::{PngDecoder, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageDecoder as _, ImageEncoder as _, Limits};

use crate::budget::within_budget;
use crate::error::{Error, Result};
use crate::remarks::Remarks;

/// Largest side, pixels.
const MAX_SIDE: u32 = 8192;
/// Most memory for decoding one image, bytes.
const MAX_ALLOC: u64 = 512 << 20;

/// An image whose header was read and found good.
pub struct Png {
    path: PathBuf,
    decoder: PngDecoder<BufReader<std::fs::File>>,
    /// What the file says of its pixels.
    pub remarks: Remarks,
    /// Columns, turned as the file says.
    pub width: u32,
    /// Rows, turned as the file says.
    pub height: u32,
}

impl Png {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// When the file cannot be read, is not a PNG, or is larger than 8192 pixels a side.
    pub fn open(path: &Path) -> Result<Self> {
        let file = rogs_files::open(path).map_err(|error| Error::io(path, error))?;
        let length = file.metadata().map_err(|error| Error::io(path, error))?.len();
        let mut file = BufReader::new(file);
        let remarks = Remarks::read(&mut file).map_err(|error| Error::io(path, error))?;
        let mut limits = Limits::default();
        limits.max_image_width = Some(MAX_SIDE);
        limits.max_image_height = Some(MAX_SIDE);
        limits.max_alloc = Some(MAX_ALLOC);
        let decoder = PngDecoder::with_limits(file, limits).map_err(|error| unreadable(path, &error))?;
        let (width, height) = remarks.size(decoder.dimensions());
        // The pixels, and a copy in another form.
        within_budget(path, length, decoder.total_bytes().saturating_mul(2), "is it an image?")?;
        Ok(Self {
            path: path.to_owned(),
            decoder,
            remarks,
            width,
            height,
        })
    }

    /// The pixels in the form that the file has them in, turned as it says.
    ///
    /// # Errors
    /// When the file is damaged.
    pub fn decode(self) -> Result<DynamicImage> {
        let decoded = DynamicImage::from_decoder(self.decoder);
        let mut image = decoded.map_err(|error| unreadable(&self.path, &error))?;
        self.remarks.turn(&mut image);
        Ok(image)
    }

    /// The pixels of a 16-bit grey image, such as depth in millimetres. `[H, W]`
    ///
    /// # Errors
    /// When the file is damaged or its pixels are of another kind.
    pub fn decode_grey16(self) -> Result<Vec<u16>> {
        let path = self.path.clone();
        match self.decode()? {
            DynamicImage::ImageLuma16(image) => Ok(image.into_raw()),
            other => {
                let what = format!("pixels are {:?}, expected 16-bit grey (millimetres)", other.color());
                Err(Error::wrong(&path, what))
            }
        }
    }
}

fn unreadable(path: &Path, error: &image::ImageError) -> Error {
    Error::wrong(path, format!("not a readable PNG image: {error}"))
}

/// Writes an 8-bit RGB image of `(width, height)` pixels. `[H, W, 3]`
///
/// # Errors
/// When there are other than so many pixels, or the operating system refuses.
pub fn write_png(path: &Path, size: (u32, u32), rgb: &[u8]) -> rogs_files::Result<()> {
    rogs_files::write_with(path, |out| encode(out, size, rgb))
}

/// The bytes of an 8-bit RGB image of `(width, height)` pixels. `[H, W, 3]`
///
/// # Errors
/// When there are other than so many pixels.
pub fn png_bytes(size: (u32, u32), rgb: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    encode(&mut bytes, size, rgb)?;
    Ok(bytes)
}

/// The bytes of an 8-bit grey image of `(width, height)` pixels. `[H, W]`
///
/// # Errors
/// When there are other than so many pixels.
pub fn grey_png_bytes(size: (u32, u32), grey: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    encode_as(&mut bytes, size, grey, ExtendedColorType::L8)?;
    Ok(bytes)
}

/// The bytes of a 16-bit grey image of `(width, height)` pixels. `[H, W]`
///
/// # Errors
/// When there are other than so many pixels.
pub fn grey16_png_bytes(size: (u32, u32), grey: &[u16]) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    // The encoder takes numbers as this machine has them.
    encode_as(&mut bytes, size, bytemuck::cast_slice(grey), ExtendedColorType::L16)?;
    Ok(bytes)
}

fn encode(out: impl std::io::Write, size: (u32, u32), rgb: &[u8]) -> std::io::Result<()> {
    encode_as(out, size, rgb, ExtendedColorType::Rgb8)
}

fn encode_as(
    out: impl std::io::Write,
    (width, height): (u32, u32),
    bytes: &[u8],
    kind: ExtendedColorType,
) -> std::io::Result<()> {
    let per_pixel = u64::from(kind.bits_per_pixel()) / 8;
    if bytes.len() as u64 != u64::from(width) * u64::from(height) * per_pixel {
        let what = format!("an image of {width}x{height} pixels was given {} bytes", bytes.len());
        return Err(std::io::Error::other(what));
    }
    PngEncoder::new(out)
        .write_image(bytes, width, height, kind)
        .map_err(std::io::Error::other)
}
