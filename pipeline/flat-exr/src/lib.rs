//! Reading of flat OpenEXR images that users hand in: one part, one value a pixel and channel.
//!
//! A header may announce any size. What it says is bounded, and shown to the caller, before anything is allocated for pixels.

use std::fs::File;
use std::io::{BufReader, Seek as _};
use std::path::Path;

use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::{FlatSamples, ReadChannels as _, ReadLayers as _, read};

/// Longest file, and most memory that the pixels of one may take, bytes.
const MAX_BYTES: u64 = 1 << 30;
/// Largest side, pixels.
const MAX_SIDE: usize = 1 << 15;
/// Most channels; all of a file's are decoded.
const MAX_CHANNELS: usize = 16;
/// Largest side of a tile, pixels.
const MAX_TILE: usize = 8192;

/// Why an image cannot be read. Messages do not name the file, which the caller knows.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExrError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(std::io::Error),
    /// It is no OpenEXR file, or a damaged one.
    #[error("not a readable OpenEXR image: {0}")]
    Format(String),
    /// It holds something else than a flat image of floating-point channels, or more than is read.
    #[error("{0}")]
    Wrong(String),
}

impl ExrError {
    fn format(error: exr::error::Error) -> Self {
        Self::Format(error.to_string())
    }
}

/// An image whose header was read and found good.
#[derive(Debug)]
pub struct FlatExr {
    file: File,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Names of the channels, in the order of the file.
    pub channels: Vec<String>,
    /// Whether the pixels are the whole picture: data window and display window agree.
    pub whole: bool,
}

impl FlatExr {
    /// Opens a file and checks its header.
    ///
    /// # Errors
    /// When the file cannot be read, or is no flat image within the bounds.
    pub fn open(path: &Path) -> Result<Self, ExrError> {
        let mut file = File::open(path).map_err(ExrError::Read)?;
        let length = file.metadata().map_err(ExrError::Read)?.len();
        if length > MAX_BYTES {
            return Err(ExrError::Wrong(format!(
                "{length} bytes are more than the {MAX_BYTES} that an image may have"
            )));
        }
        let meta = MetaData::read_from_buffered(BufReader::new(&mut file), true).map_err(ExrError::format)?;
        let [header] = meta.headers.as_slice() else {
            let parts = meta.headers.len();
            return Err(ExrError::Wrong(format!("it has {parts} parts, expected one")));
        };
        check(header).map_err(ExrError::Wrong)?;
        file.rewind().map_err(ExrError::Read)?;
        let display = header.shared_attributes.display_window;
        Ok(Self {
            file,
            width: header.layer_size.0,
            height: header.layer_size.1,
            channels: (header.channels.list.iter())
                .map(|channel| channel.name.to_string())
                .collect(),
            whole: header.own_attributes.layer_position == display.position && header.layer_size == display.size,
        })
    }

    /// Position of a channel.
    #[must_use]
    pub fn position(&self, name: &str) -> Option<usize> {
        self.channels.iter().position(|own| own == name)
    }

    /// Values of the channels at `chosen` positions, in that order. Each `[H, W]`
    ///
    /// # Errors
    /// When the file is damaged, or a chosen channel is missing or no floating-point one.
    pub fn planes(self, chosen: &[usize]) -> Result<Vec<Vec<f32>>, ExrError> {
        let image = read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_buffered(BufReader::new(self.file))
            .map_err(ExrError::format)?;
        let samples = image.layer_data.channel_data.list;
        let plane = |&channel: &usize| {
            let values: Vec<f32> = match samples.get(channel).map(|channel| &channel.sample_data) {
                Some(FlatSamples::F32(values)) => values.clone(),
                Some(FlatSamples::F16(values)) => values.iter().map(|value| value.to_f32()).collect(),
                Some(FlatSamples::U32(_)) => {
                    return Err(ExrError::Wrong("its channels must be floating point".into()));
                }
                None => return Err(ExrError::Wrong("a channel of its header is missing".into())),
            };
            if values.len() != self.height * self.width {
                return Err(ExrError::Wrong("its channels have another size than the image".into()));
            }
            Ok(values)
        };
        chosen.iter().map(plane).collect()
    }
}

/// What is wrong with a header, if something is.
fn check(header: &Header) -> Result<(), String> {
    if header.deep {
        return Err("deep images have several values a pixel; save a flat image of the nearest surface".into());
    }
    let (width, height) = (header.layer_size.0, header.layer_size.1);
    let list = &header.channels.list;
    if width > MAX_SIDE || height > MAX_SIDE || list.len() > MAX_CHANNELS {
        return Err(format!(
            "it is {height}x{width} pixels of {} channels; at most {MAX_SIDE} a side and {MAX_CHANNELS} are read",
            list.len()
        ));
    }
    if (width * height * list.len()) as u64 > MAX_BYTES / 4 {
        return Err("its pixels take more than 1 GiB".into());
    }
    if let BlockDescription::Tiles(tiles) = header.blocks
        && (tiles.tile_size.0 > MAX_TILE || tiles.tile_size.1 > MAX_TILE)
    {
        return Err(format!("its tiles are {}x{}", tiles.tile_size.0, tiles.tile_size.1));
    }
    if list
        .iter()
        .any(|channel| (channel.sampling.0, channel.sampling.1) != (1, 1))
    {
        return Err("channels are subsampled; save every pixel".into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use exr::prelude::*;

    use super::FlatExr;

    #[test]
    fn damaged_bytes_are_an_error_or_a_picture_never_a_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image.exr");
        let (width, height) = (23usize, 17usize);
        let values = (0..width * height).map(|pixel| pixel as f32 / 7.0).collect();
        let channel = AnyChannel::new("Z", FlatSamples::F32(values));
        let layer = Layer::new(
            (width, height),
            LayerAttributes::default(),
            Encoding {
                compression: Compression::ZIP16,
                ..Encoding::default()
            },
            AnyChannels::sort(std::iter::once(channel).collect()),
        );
        Image::from_layer(layer).write().to_file(&path).unwrap();
        let depth = || FlatExr::open(&path).and_then(|image| image.planes(&[0]));
        let whole = std::fs::read(&path).unwrap();
        assert_eq!(depth().unwrap()[0][8], 8.0f32 / 7.0);
        let mut refused = 0;
        for at in 0..whole.len() {
            for bits in [0xff, 0x80, 0x01] {
                let mut bytes = whole.clone();
                bytes[at] ^= bits;
                std::fs::write(&path, bytes).unwrap();
                refused += usize::from(depth().is_err());
            }
        }
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(depth().is_err(), "cut to {length} bytes");
        }
        assert!(refused > 100, "only {refused} damaged files were refused");
    }
}
