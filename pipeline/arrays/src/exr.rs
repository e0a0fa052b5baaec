//! Flat OpenEXR images: one part, one value a pixel and channel.
//!
//! A header may announce any size. What it says is bounded, and shown to the caller, before anything is allocated for pixels.

use std::fs::File;
use std::io::{BufReader, Seek as _};
use std::path::{Path, PathBuf};

use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, ReadChannels as _,
    ReadLayers as _, WritableImage as _, read,
};

use crate::budget::within_budget;
use crate::error::{Error, Result};

/// Longest file, bytes.
const MAX_BYTES: u64 = 1 << 30;
/// Largest side, pixels.
const MAX_SIDE: usize = 1 << 15;
/// Most channels; all of a file's are decoded.
const MAX_CHANNELS: usize = 16;
/// Largest side of a tile, pixels.
const MAX_TILE: usize = 8192;

/// An image whose header was read and found good.
#[derive(Debug)]
pub struct FlatExr {
    path: PathBuf,
    file: File,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Names of the channels, in the order of the file.
    pub channels: Vec<String>,
    /// What the header says of the pixels and nobody uses, one statement each.
    pub notes: Vec<String>,
}

impl FlatExr {
    /// Opens a file and checks its header.
    ///
    /// # Errors
    /// When the file cannot be read, or is not a flat image within the bounds.
    pub fn open(path: &Path) -> Result<Self> {
        let io = |error| Error::io(path, error);
        let mut file = rogs_files::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        if length > MAX_BYTES {
            let what = format!("{length} bytes are more than the {MAX_BYTES} that an image may have");
            return Err(Error::wrong(path, what));
        }
        let meta = MetaData::read_from_buffered(BufReader::new(&mut file), true);
        let meta = meta.map_err(|error| unreadable(path, &error))?;
        let [header] = meta.headers.as_slice() else {
            let parts = meta.headers.len();
            return Err(Error::wrong(
                path,
                format!("it has {parts} parts, expected one; save the depth as a file of its own"),
            ));
        };
        check(header).map_err(|what| Error::wrong(path, what))?;
        // All channels, and those that are wanted in two forms.
        let (width, height) = (header.layer_size.0 as u64, header.layer_size.1 as u64);
        let a_pixel = 4 * header.channels.list.len() as u64 + 24;
        within_budget(path, length, width * height * a_pixel, "is it an image?")?;
        file.rewind().map_err(io)?;
        Ok(Self {
            path: path.to_owned(),
            file,
            width: header.layer_size.0,
            height: header.layer_size.1,
            channels: (header.channels.list.iter())
                .map(|channel| channel.name.to_string())
                .collect(),
            notes: notes(header),
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
    pub fn planes(self, chosen: &[usize]) -> Result<Vec<Vec<f32>>> {
        let path = &self.path;
        let image = read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_buffered(BufReader::new(self.file))
            .map_err(|error| unreadable(path, &error))?;
        let samples = image.layer_data.channel_data.list;
        let plane = |&channel: &usize| {
            let values: Vec<f32> = match samples.get(channel).map(|channel| &channel.sample_data) {
                Some(FlatSamples::F32(values)) => values.clone(),
                Some(FlatSamples::F16(values)) => values.iter().map(|value| value.to_f32()).collect(),
                Some(FlatSamples::U32(_)) => {
                    return Err(Error::wrong(path, "its channels must be floating point"));
                }
                None => return Err(Error::wrong(path, "a channel of its header is missing")),
            };
            if values.len() != self.height * self.width {
                return Err(Error::wrong(path, "its channels have another size than the image"));
            }
            Ok(values)
        };
        chosen.iter().map(plane).collect()
    }
}

fn unreadable(path: &Path, error: &exr::error::Error) -> Error {
    Error::wrong(path, format!("not a readable OpenEXR image: {error}"))
}

/// What is wrong with a header, if something is.
fn check(header: &Header) -> std::result::Result<(), String> {
    let display = header.shared_attributes.display_window;
    if header.own_attributes.layer_position != display.position || header.layer_size != display.size {
        return Err("data window and display window differ; save the whole image".into());
    }
    if header.own_attributes.environment_map.is_some() {
        return Err("it is a panorama (environment map), and the image of no camera".into());
    }
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

/// What a header says of its pixels and nobody uses. Of what `check` lets pass this is the whole list: cameras, clip
/// planes, times, exposures, names of programs, transforms for viewers and the like say nothing about which pixel is where
/// or what its number means.
fn notes(header: &Header) -> Vec<String> {
    let shared = &header.shared_attributes;
    let mut notes = Vec::new();
    if (shared.pixel_aspect - 1.0).abs() > 1e-4 {
        notes.push(format!(
            "its pixels have the aspect {}: images are read as stored, intrinsics must be those of stored pixels",
            shared.pixel_aspect
        ));
    }
    let other = shared.chromaticities.is_some_and(|own| {
        let own = [own.red, own.green, own.blue, own.white].map(|place| [place.0, place.1]);
        let rec709 = [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]];
        own.iter()
            .flatten()
            .zip(rec709.iter().flatten())
            .any(|(own, usual)| (own - usual).abs() > 0.005)
    });
    if other {
        notes.push("its colours are those of another space than Rec. 709: they are taken as they are".to_owned());
    }
    if let Some(nits) = header.own_attributes.white_luminance.filter(|nits| *nits != 1.0) {
        notes.push(format!(
            "its white has {nits} candelas per square metre: colours are taken as they are"
        ));
    }
    notes
}

/// Writes one channel of f32 values, `(width, height)` pixels, ZIP compressed. `[H, W]`
///
/// # Errors
/// When there are other than so many values, or the operating system refuses.
pub fn write_exr(
    path: &Path,
    (width, height): (usize, usize),
    channel: &str,
    values: Vec<f32>,
) -> rogs_files::Result<()> {
    rogs_files::write_with(path, |out| {
        if Some(values.len()) != width.checked_mul(height) {
            let what = format!("an image of {width}x{height} pixels was given {} values", values.len());
            return Err(std::io::Error::other(what));
        }
        let channel = AnyChannel::new(channel, FlatSamples::F32(values));
        let layer = Layer::new(
            (width, height),
            LayerAttributes::default(),
            Encoding {
                compression: Compression::ZIP16,
                ..Encoding::default()
            },
            AnyChannels::sort(std::iter::once(channel).collect()),
        );
        let written = Image::from_layer(layer).write().to_buffered(out);
        written.map_err(|error| match error {
            exr::error::Error::Io(error) => error,
            other => std::io::Error::other(other.to_string()),
        })
    })
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;

    #[test]
    fn what_a_header_says_of_its_pixels_is_told_or_refused() {
        use exr::meta::attribute::{Chromaticities, EnvironmentMap, IntegerBounds};

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image.exr");
        type Image = exr::prelude::Image<Layer<AnyChannels<FlatSamples>>>;
        let opened = |change: &dyn Fn(&mut Image)| {
            let channel = AnyChannel::new("Z", FlatSamples::F32(vec![1.0; 6]));
            let channels = AnyChannels::sort(std::iter::once(channel).collect());
            let layer = Layer::new((3, 2), LayerAttributes::default(), Encoding::default(), channels);
            let mut image = Image::from_layer(layer);
            change(&mut image);
            image.write().to_file(&path).unwrap();
            FlatExr::open(&path)
                .map(|image| image.notes.concat())
                .map_err(|error| error.to_string())
        };
        assert_eq!(opened(&|_| {}), Ok(String::new()));
        let wide = Chromaticities {
            red: (0.7347, 0.2653).into(),
            green: (0.0, 1.0).into(),
            blue: (0.0001, -0.077).into(),
            white: (0.32168, 0.33767).into(),
        };
        let rec709 = Chromaticities {
            red: (0.64, 0.33).into(),
            green: (0.3, 0.6).into(),
            blue: (0.15, 0.06).into(),
            white: (0.3127, 0.329).into(),
        };
        assert_eq!(
            opened(&|image| image.attributes.chromaticities = Some(rec709)),
            Ok(String::new())
        );
        for (told, words) in [
            (opened(&|image| image.attributes.pixel_aspect = 2.0), "aspect 2"),
            (
                opened(&|image| image.attributes.chromaticities = Some(wide)),
                "another space than Rec. 709",
            ),
            (
                opened(&|image| image.layer_data.attributes.white_luminance = Some(100.0)),
                "100 candelas",
            ),
        ] {
            assert!(told.as_ref().is_ok_and(|told| told.contains(words)), "{told:?}");
        }
        for (told, words) in [
            (
                opened(&|image| image.layer_data.attributes.environment_map = Some(EnvironmentMap::Cube)),
                "panorama",
            ),
            (
                opened(&|image| image.attributes.display_window = IntegerBounds::from_dimensions((5, 4))),
                "data window and display window differ",
            ),
            (
                opened(&|image| image.layer_data.attributes.layer_position = (1, 0).into()),
                "data window and display window differ",
            ),
        ] {
            assert!(told.as_ref().is_err_and(|told| told.contains(words)), "{told:?}");
        }
    }

    #[test]
    fn damaged_bytes_are_an_error_or_a_picture_never_a_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image.exr");
        let (width, height) = (23usize, 17usize);
        let values = (0..width * height).map(|pixel| pixel as f32 / 7.0).collect();
        write_exr(&path, (width, height), "Z", values).unwrap();
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
