//! Reference depth in OpenEXR files.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::path::Path;

use common::{FRAMES, HEIGHT, Scratch, WIDTH, write_episode};
use exr::prelude::*;
use rogs_ingest::{Params, read_clip};

/// Pixels of an image.
const AREA: usize = (WIDTH * HEIGHT) as usize;

fn params() -> Params {
    Params {
        height: HEIGHT,
        width: WIDTH,
        ..Params::default()
    }
}

fn write(path: &Path, size: (u32, u32), compression: Compression, channels: Vec<(&str, FlatSamples)>) {
    let channels = channels
        .into_iter()
        .map(|(name, samples)| AnyChannel::new(name, samples));
    let encoding = Encoding {
        compression,
        ..Encoding::default()
    };
    let layer = Layer::new(
        (size.0 as usize, size.1 as usize),
        LayerAttributes::default(),
        encoding,
        AnyChannels::sort(channels.collect()),
    );
    Image::from_layer(layer).write().to_file(path).unwrap();
}

/// Metres at a pixel; a corner is unknown in three ways.
fn metres(frame: u32, pixel: usize) -> f32 {
    match pixel {
        0 => 0.0,
        1 => f32::NAN,
        2 => f32::INFINITY,
        _ => 0.5 + 0.25 * frame as f32 + pixel as f32 / 1024.0,
    }
}

/// The episode with the depth of the evaluation camera as EXR files, and what comes out: its depth or the complaint.
fn depth_of(name: &str, write: impl Fn(&Path, u32)) -> std::result::Result<Vec<f32>, String> {
    let scratch = Scratch::new(&format!("exr-{name}"));
    write_episode(&scratch.0);
    for frame in 0..FRAMES {
        let path = scratch.0.join(format!("right_depth/{frame:06}.png"));
        std::fs::remove_file(&path).unwrap();
        write(&path.with_extension("exr"), frame);
    }
    match read_clip(&scratch.0, None, &params(), "c") {
        Ok((clip, _)) => Ok(clip.cameras[2].depth.as_ref().unwrap().depth_m.clone()),
        Err(error) => Err(error.message.replace(&*scratch.0.to_string_lossy(), "EP")),
    }
}

fn plane(frame: u32) -> Vec<f32> {
    (0..AREA).map(|pixel| metres(frame, pixel)).collect()
}

#[test]
fn depth_in_metres_arrives_whatever_the_compression_and_the_company() {
    let other = || FlatSamples::F16(vec![f16::from_f32(0.5); AREA]);
    for (name, compression) in [
        ("zip", Compression::ZIP16),
        ("rle", Compression::RLE),
        ("plain", Compression::Uncompressed),
    ] {
        let depth = depth_of(name, |path, frame| {
            let channels = vec![("R", other()), ("Z", FlatSamples::F32(plane(frame))), ("A", other())];
            write(path, (WIDTH, HEIGHT), compression, channels);
        })
        .unwrap();
        assert_eq!(depth.len(), 17 * AREA);
        assert!(
            depth[..3].iter().all(|value| value.is_nan()),
            "{name}: unknown depth is NaN"
        );
        // The clip begins at episode frame 2.
        for (frame, pixel) in [(0usize, 3usize), (5, AREA / 2), (16, AREA - 1)] {
            assert_eq!(depth[frame * AREA + pixel], metres(frame as u32 + 2, pixel), "{name}");
        }
    }
}

#[test]
fn a_single_half_channel_needs_no_name() {
    let depth = depth_of("half", |path, _| {
        let values = vec![f16::from_f32(1.25); AREA];
        let channels = vec![("depth.V", FlatSamples::F16(values))];
        write(path, (WIDTH, HEIGHT), Compression::ZIP1, channels);
    });
    assert!(depth.unwrap().iter().all(|&value| value == 1.25));
}

#[test]
fn what_is_no_depth_image_is_refused_in_words() {
    let float = |count: usize| FlatSamples::F32(vec![1.0; count]);
    let size = (WIDTH, HEIGHT);
    let plain = Compression::Uncompressed;
    let refused = |name: &str, make: &dyn Fn(&Path)| depth_of(name, |path, _| make(path)).unwrap_err();
    let other = refused("size", &|path| write(path, (8, 8), plain, vec![("Z", float(64))]));
    assert!(other.contains("right_depth/000002.exr"), "{other}");
    assert!(other.contains("the image is 8x8, the episode says 40x22"), "{other}");
    let names = refused("names", &|path| {
        write(path, size, plain, vec![("B", float(AREA)), ("G", float(AREA))]);
    });
    assert!(names.contains("none of its channels (B, G) is `Z`"), "{names}");
    let integers = refused("integers", &|path| {
        write(path, size, plain, vec![("Z", FlatSamples::U32(vec![1; AREA]))]);
    });
    assert!(integers.contains("floating point"), "{integers}");
    let text = refused("text", &|path| std::fs::write(path, "no image at all").unwrap());
    assert!(text.contains("not a readable OpenEXR image"), "{text}");
    let cut = refused("cut", &|path| {
        write(path, size, Compression::ZIP16, vec![("Z", float(AREA))]);
        let bytes = std::fs::read(path).unwrap();
        std::fs::write(path, &bytes[..bytes.len() - 20]).unwrap();
    });
    assert!(cut.contains("not a readable OpenEXR image"), "{cut}");
}
