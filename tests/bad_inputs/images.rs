//! Image files, and depth as `.npy` and OpenEXR.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use crate::cases::{Cases, Failure, Said, Warning, edit};

#[test]
fn images_and_depth() {
    let mut cases = Cases::new();
    let place = |cases: &mut Cases, name: &str, said: Said| cases.add(name, said).join("wrist/000009.png");
    let path = place(&mut cases, "huge", Failure("wrist/000009.png", ""));
    let mut bytes = std::fs::read(&path).unwrap();
    // The header declares 60,000 x 60,000 pixels.
    bytes[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    std::fs::write(path, bytes).unwrap();
    let path = place(&mut cases, "deep", Failure("expected 8-bit RGB or grey", ""));
    image::ImageBuffer::<image::Rgb<u16>, _>::new(56, 42)
        .save(path)
        .unwrap();
    let path = place(&mut cases, "alpha", Failure("the image is partly transparent", ""));
    image::RgbaImage::new(56, 42).save(path).unwrap();
    let path = place(
        &mut cases,
        "other-size",
        Failure("wrist/000009.png`: images are 8x8", "correct both"),
    );
    image::RgbImage::new(8, 8).save(path).unwrap();
    // A JPEG under the name of a PNG: neither its colours (CMYK) nor its rotation (EXIF) are guessed.
    let path = place(
        &mut cases,
        "jpeg",
        Failure("wrist/000009.png`: not a readable PNG image", ""),
    );
    image::RgbImage::new(56, 42)
        .save_with_format(path, image::ImageFormat::Jpeg)
        .unwrap();
    let path = place(
        &mut cases,
        "cut",
        Failure("wrist/000009.png`: not a readable PNG image", ""),
    );
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
    let path = place(
        &mut cases,
        "missing",
        Failure(
            "it has 16 PNG files, the episode 17 frames; `000009.png` is missing",
            "",
        ),
    );
    std::fs::remove_file(path).unwrap();

    // Depth as OpenEXR: two 32-bit integers of a window follow the word `box2i` and its length.
    let mut exr = |name: &str, said: Said, damage: &dyn Fn(&mut Vec<u8>)| {
        let folder = cases.add(name, said);
        std::fs::create_dir(folder.join("wrist-depth")).unwrap();
        for frame in 0..17 {
            let mut bytes = exr_image();
            if frame == 9 {
                damage(&mut bytes);
            }
            std::fs::write(folder.join(format!("wrist-depth/{frame:06}.exr")), bytes).unwrap();
        }
        edit(&folder, |episode| {
            episode["cameras"][0]["depth"]["path"] = "wrist-depth".into()
        });
    };
    // Of the data alone, or of what is to be shown too.
    let window = |values: [i32; 4], windows: usize| {
        move |bytes: &mut Vec<u8>| {
            let found: Vec<usize> = (0..bytes.len() - 6)
                .filter(|&at| &bytes[at..at + 6] == b"box2i\0")
                .collect();
            assert_eq!(found.len(), 2, "data and display window");
            for &at in &found[..windows] {
                for (index, value) in values.iter().enumerate() {
                    bytes[at + 10 + 4 * index..][..4].copy_from_slice(&value.to_le_bytes());
                }
            }
        }
    };
    // Read, and not where the robot is.
    exr("exr", Warning("times that of the robot's mesh"), &|_| {});
    exr(
        "exr-huge",
        Failure("wrist-depth/000009.exr", ""),
        &window([0, 0, 1 << 30, 1 << 30], 2),
    );
    exr(
        "exr-reversed",
        Failure("wrist-depth/000009.exr", ""),
        &window([0, 0, -57, -43], 2),
    );
    exr(
        "exr-before",
        Failure("data window and display window differ", ""),
        &window([-5, -5, 50, 36], 1),
    );
    exr("exr-deep", Failure("wrist-depth/000009.exr", ""), &|bytes| {
        bytes[5] |= 0x08
    });
    exr("exr-cut", Failure("not a readable OpenEXR image", ""), &|bytes| {
        bytes.truncate(bytes.len() - 20)
    });
    exr("exr-text", Failure("not a readable OpenEXR image", ""), &|bytes| {
        *bytes = b"no image at all".to_vec()
    });
    let path = cases
        .add("npy", Failure("does not fit its shape", ""))
        .join("depth/ext1.npy");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(path, &bytes[..bytes.len() - 8]).unwrap();
    cases.check();
}

/// Depth of one frame, with a value that is not known.
fn exr_image() -> Vec<u8> {
    use exr::prelude::*;

    let mut values = vec![1.5_f32; 56 * 42];
    values[7] = f32::NAN;
    let channel = AnyChannel::new("Z", FlatSamples::F32(values));
    let channels = AnyChannels::sort(std::iter::once(channel).collect());
    let encoding = Encoding {
        compression: Compression::ZIP16,
        ..Encoding::default()
    };
    let layer = Layer::new((56, 42), LayerAttributes::default(), encoding, channels);
    let mut bytes = std::io::Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}
