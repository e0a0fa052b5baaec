//! Depth in OpenEXR files: one part, channel `Z` (or the only channel), floating point, metres.

use std::fs::File;
use std::io::{BufReader, Seek as _};
use std::path::Path;

use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::{FlatSamples, ReadChannels as _, ReadLayers as _, read};
use rogs_worker::StageResult;

use crate::checks::{io_error, wrong};

/// Longest file, bytes.
const MAX_FILE: u64 = 1 << 30;
/// Most channels; all of a file's are decoded.
const MAX_CHANNELS: usize = 16;
/// Largest side of a tile, pixels.
const MAX_TILE: usize = 8192;
/// The channel of depth, as the format's own description names it.
const DEPTH_CHANNEL: &str = "Z";

/// The depth of an OpenEXR file of the expected size, metres. `[h, w]`
pub(crate) fn read_exr(path: &Path, size: (u32, u32)) -> StageResult<Vec<f64>> {
    let bad = |error: exr::error::Error| wrong(path, format!("not a readable OpenEXR image: {error}"));
    let mut file = File::open(path).map_err(|error| io_error(path, &error))?;
    let length = file.metadata().map_err(|error| io_error(path, &error))?.len();
    if length > MAX_FILE {
        return Err(wrong(
            path,
            format!("{length} bytes are more than the {MAX_FILE} that an image may have"),
        ));
    }
    // The header is checked before anything is allocated for the pixels it announces.
    let meta = MetaData::read_from_buffered(BufReader::new(&mut file), true).map_err(bad)?;
    let [header] = meta.headers.as_slice() else {
        return Err(wrong(
            path,
            format!("it has {} parts, expected one", meta.headers.len()),
        ));
    };
    let channel = check(header, size).map_err(|what| wrong(path, what))?;
    file.rewind().map_err(|error| io_error(path, &error))?;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(BufReader::new(file))
        .map_err(bad)?;
    let samples = image.layer_data.channel_data.list.into_iter().nth(channel);
    let values: Vec<f64> = match samples.map(|channel| channel.sample_data) {
        Some(FlatSamples::F32(values)) => values.into_iter().map(f64::from).collect(),
        Some(FlatSamples::F16(values)) => values.into_iter().map(|value| value.to_f64()).collect(),
        Some(FlatSamples::U32(_)) => return Err(wrong(path, "depth must be floating point, in metres")),
        None => return Err(wrong(path, "the channel of depth is missing")),
    };
    if values.len() != size.0 as usize * size.1 as usize {
        return Err(wrong(path, format!("it has {} values", values.len())));
    }
    Ok(values)
}

/// The position of the depth channel, or what is wrong with the header.
fn check(header: &Header, (width, height): (u32, u32)) -> Result<usize, String> {
    if header.deep {
        return Err("deep images have several depths a pixel; save the nearest surface".into());
    }
    let size = header.layer_size;
    let display = header.shared_attributes.display_window;
    let corner = header.own_attributes.layer_position;
    if (size.0, size.1) != (width as usize, height as usize) {
        return Err(format!(
            "the image is {}x{}, the episode says {width}x{height}",
            size.0, size.1
        ));
    }
    if corner != display.position || size != display.size {
        return Err("data window and display window differ; save the whole image".into());
    }
    if let BlockDescription::Tiles(tiles) = header.blocks
        && (tiles.tile_size.0 > MAX_TILE || tiles.tile_size.1 > MAX_TILE)
    {
        return Err(format!("its tiles are {}x{}", tiles.tile_size.0, tiles.tile_size.1));
    }
    let channels = &header.channels.list;
    if channels.len() > MAX_CHANNELS {
        return Err(format!("it has {} channels, expected depth alone", channels.len()));
    }
    let names: Vec<String> = channels.iter().map(|channel| channel.name.to_string()).collect();
    let chosen = match names.as_slice() {
        [_] => Some(0),
        names => names.iter().position(|name| name == DEPTH_CHANNEL),
    };
    let chosen = chosen.ok_or_else(|| {
        format!(
            "none of its channels ({}) is `{DEPTH_CHANNEL}`; name the depth so or save it alone",
            names.join(", ")
        )
    })?;
    if channels
        .iter()
        .any(|channel| (channel.sampling.0, channel.sampling.1) != (1, 1))
    {
        return Err("channels are subsampled; save every pixel".into());
    }
    Ok(chosen)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A header may announce any size; nothing is allocated before it is compared with the episode.
    #[test]
    fn damaged_bytes_are_an_error_or_a_picture_never_a_panic() {
        use exr::prelude::*;

        let path = std::env::temp_dir().join(format!("rogs-exr-{}.exr", std::process::id()));
        let (width, height) = (23u32, 17u32);
        let values = (0..width * height).map(|pixel| pixel as f32 / 7.0).collect();
        let channel = AnyChannel::new("Z", FlatSamples::F32(values));
        let layer = Layer::new(
            (width as usize, height as usize),
            LayerAttributes::default(),
            Encoding {
                compression: Compression::ZIP16,
                ..Encoding::default()
            },
            AnyChannels::sort(std::iter::once(channel).collect()),
        );
        Image::from_layer(layer).write().to_file(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        assert_eq!(read_exr(&path, (width, height)).unwrap()[8], f64::from(8.0f32 / 7.0));
        let mut refused = 0;
        for at in 0..whole.len() {
            for bits in [0xff, 0x80, 0x01] {
                let mut bytes = whole.clone();
                bytes[at] ^= bits;
                std::fs::write(&path, bytes).unwrap();
                refused += usize::from(read_exr(&path, (width, height)).is_err());
            }
        }
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(read_exr(&path, (width, height)).is_err(), "cut to {length} bytes");
        }
        std::fs::remove_file(&path).unwrap();
        assert!(refused > 100, "only {refused} damaged files were refused");
    }
}
