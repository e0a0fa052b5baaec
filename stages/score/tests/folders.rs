//! Scores of image files and folders.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use image::{Rgb, RgbImage};
use rogs_score::folders::{FolderError, score_paths};
use rogs_score::metrics::{Pixels, RgbView, SsimVariant, psnr, ssim};
use rogs_score::pictures::PictureError;

fn picture(seed: u32) -> RgbImage {
    RgbImage::from_fn(32, 24, |x, y| {
        Rgb([(x * 8 + seed) as u8, (y * 9) as u8, ((x * y + seed) % 256) as u8])
    })
}

#[test]
fn two_files_and_two_folders_give_the_scores_of_their_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own", "other"].map(|name| folder.path().join(name));
    for (folder, seed) in [(&own, 0), (&other, 5)] {
        std::fs::create_dir(folder).unwrap();
        for name in ["a.png", "b.png"] {
            picture(seed).save(folder.join(name)).unwrap();
        }
    }
    picture(0).save(own.join("c.png")).unwrap();
    std::fs::write(other.join("notes.txt"), "no image").unwrap();
    let variant = SsimVariant::Torchmetrics;
    let scores = score_paths(&own, &other, variant, None, [None; 2]).unwrap();
    let (a, b) = (picture(0), picture(5));
    let view = |image: &'static RgbImage| RgbView::new(24, 32, Pixels::Bytes(image.as_raw())).unwrap();
    let (a, b) = (view(Box::leak(Box::new(a))), view(Box::leak(Box::new(b))));
    assert_eq!(
        scores.pairs.iter().map(|pair| pair.name.as_str()).collect::<Vec<_>>(),
        ["a.png", "b.png"]
    );
    assert_eq!(scores.psnr, Some(psnr(&a, &b).unwrap()));
    assert_eq!(scores.ssim, Some(ssim(&a, &b, variant).unwrap()));
    assert_eq!(
        (scores.only_in_prediction, scores.only_in_reference),
        (vec!["c.png".to_owned()], vec![])
    );
    assert_eq!((scores.lpips, scores.lpips_note.is_some()), (None, true));

    let distance = |own: &RgbView<'_>, _: &RgbView<'_>| Some((own.height() * own.width()) as f64);
    let one = score_paths(
        &own.join("a.png"),
        &other.join("a.png"),
        variant,
        Some(&distance),
        [None; 2],
    )
    .unwrap();
    assert_eq!((one.psnr, one.lpips), (scores.psnr, Some(768.0)));
}

#[test]
fn what_cannot_be_scored_is_explained() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own", "other"].map(|name| folder.path().join(name));
    std::fs::create_dir_all(&own).unwrap();
    std::fs::create_dir_all(&other).unwrap();
    let variant = SsimVariant::default();
    assert!(matches!(
        score_paths(&own, &other, variant, None, [None; 2]),
        Err(FolderError::NothingInCommon { .. })
    ));
    picture(0).save(own.join("a.png")).unwrap();
    assert!(matches!(
        score_paths(&own.join("a.png"), &other, variant, None, [None; 2]),
        Err(FolderError::Mixed { .. })
    ));
    RgbImage::new(8, 8).save(other.join("a.png")).unwrap();
    let error = score_paths(&own, &other, variant, None, [None; 2]).unwrap_err();
    assert!(
        matches!(&error, FolderError::Pair { name, .. } if name == "a.png"),
        "{error}"
    );
    std::fs::write(other.join("a.png"), b"nonsense").unwrap();
    assert!(matches!(
        score_paths(&own, &other, variant, None, [None; 2]),
        Err(FolderError::Picture(PictureError::Image { .. }))
    ));
    let small = folder.path().join("small.png");
    RgbImage::new(8, 8).save(&small).unwrap();
    let scores = score_paths(&small, &small, variant, None, [None; 2]).unwrap();
    assert_eq!((scores.psnr, scores.ssim), (Some(100.0), None));
}

/// A depth map as an OpenEXR file with one channel.
fn write_depth(path: &std::path::Path, width: usize, height: usize, channel: &str, values: Vec<f32>) {
    use exr::prelude::*;
    let channel = AnyChannel::new(channel, FlatSamples::F32(values));
    let channels = AnyChannels::sort(std::iter::once(channel).collect());
    let attributes = LayerAttributes::default();
    let layer = Layer::new((width, height), attributes, Encoding::UNCOMPRESSED, channels);
    Image::from_layer(layer).write().to_file(path).unwrap();
}

fn write_colours(path: &std::path::Path, width: usize, height: usize, value: impl Fn(usize, usize) -> f32 + Sync) {
    let pixel = |x, y| (value(x, y), value(x, y), value(x, y));
    exr::prelude::write_rgb_file(path, width, height, pixel).unwrap();
}

#[test]
fn depth_files_have_depth_errors_where_the_reference_lies_in_range() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own.exr", "other.exr"].map(|name| folder.path().join(name));
    write_depth(&own, 3, 2, "Z", vec![1.1, 2.0, f32::NAN, 9.0, 9.0, 9.0]);
    write_depth(&other, 3, 2, "Z", vec![1.0, 2.0, 4.0, 0.1, 5.0, f32::NAN]);
    let scores = score_paths(&own, &other, SsimVariant::default(), None, [None; 2]).unwrap();
    let pair = &scores.pairs[0];
    assert_eq!((pair.psnr, pair.support_n, scores.n.depth), (None, Some(3), 1));
    assert!((scores.absrel.unwrap() - (0.1 + 0.0 + 1.0) / 3.0).abs() < 1e-6);
    assert!((scores.delta1.unwrap() - 2.0 / 3.0).abs() < 1e-12);
    assert!(pair.notes[0].contains("1 values of the prediction"), "{:?}", pair.notes);

    // Millimetres, say: nothing lies in range.
    write_depth(&other, 3, 2, "Z", vec![1000.0; 6]);
    let scores = score_paths(&own, &other, SsimVariant::default(), None, [None; 2]).unwrap();
    assert_eq!((scores.absrel, scores.n.depth), (None, 0));
    assert!(scores.pairs[0].notes.iter().any(|note| note.contains("metres")));

    write_depth(&other, 2, 3, "Z", vec![1.0; 6]);
    let error = score_paths(&own, &other, SsimVariant::default(), None, [None; 2]).unwrap_err();
    assert!(matches!(error, FolderError::Pair { .. }), "{error}");
    write_colours(&other, 3, 2, |_, _| 0.5);
    let error = score_paths(&own, &other, SsimVariant::default(), None, [None; 2]).unwrap_err();
    assert!(
        error.to_string().contains("holds depth, the reference colours"),
        "{error}"
    );
}

#[test]
fn floats_keep_their_precision_and_say_what_is_clipped() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own.exr", "other.exr"].map(|name| folder.path().join(name));
    let ramp = |x: usize, y: usize| (x + y) as f32 / 100.0;
    write_colours(&own, 24, 20, |x, y| {
        if (x, y) == (3, 4) { f32::NAN } else { ramp(x, y) + 0.001 }
    });
    write_colours(&other, 24, 20, ramp);
    let scores = score_paths(&own, &other, SsimVariant::default(), None, [None; 2]).unwrap();
    let expected = 0.001f64.powi(2) * 479.0 / 480.0 + f64::from(ramp(3, 4)).powi(2) / 480.0;
    assert!((scores.psnr.unwrap() + 10.0 * expected.log10()).abs() < 1e-3);
    assert!(scores.pairs[0].notes[0].contains("3 values of the prediction"));
    let error = score_paths(&other, &own, SsimVariant::default(), None, [None; 2]).unwrap_err();
    assert!(error.to_string().contains("of the reference are not finite"), "{error}");
    write_colours(&own, 24, 20, |x, y| 255.0 * ramp(x, y));
    let scores = score_paths(&own, &other, SsimVariant::default(), None, [None; 2]).unwrap();
    assert!(scores.pairs[0].notes[0].contains("floats are colours in 0 to 1"));
}

#[test]
fn arrays_are_compared_by_name_and_time() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, arrays: &[(&str, Vec<usize>, f32)]| {
        let bytes: Vec<(&str, Vec<usize>, Vec<u8>)> = (arrays.iter())
            .map(|(name, shape, value)| {
                let count = shape.iter().product();
                (*name, shape.clone(), vec![value.to_le_bytes(); count].concat())
            })
            .collect();
        let views = bytes.iter().map(|(name, shape, bytes)| {
            let view = safetensors::tensor::TensorView::new(safetensors::Dtype::F32, shape.clone(), bytes).unwrap();
            (*name, view)
        });
        let path = folder.path().join(name);
        std::fs::write(&path, safetensors::serialize(views, None).unwrap()).unwrap();
        path
    };
    let frames = ("frames", vec![2], 1.0);
    let own = write(
        "own.safetensors",
        &[
            frames.clone(),
            ("rgb_wrist", vec![2, 12, 14, 3], 0.5),
            ("depth_wrist", vec![2, 12, 14], 1.1),
        ],
    );
    let other = write(
        "other.safetensors",
        &[
            frames.clone(),
            ("rgb_wrist", vec![1, 12, 14, 3], 0.4),
            ("depth_wrist", vec![2, 12, 14], 1.0),
        ],
    );
    let scores = score_paths(&own, &other, SsimVariant::default(), None, [None; 2]).unwrap();
    let names: Vec<&str> = scores
        .pairs
        .iter()
        .filter_map(|pair| pair.name.rsplit(':').next())
        .collect();
    assert_eq!(names, ["depth_wrist[0]", "depth_wrist[1]", "rgb_wrist[0]"]);
    assert!((scores.psnr.unwrap() - 20.0).abs() < 1e-4 && (scores.absrel.unwrap() - 0.1).abs() < 1e-6);
    assert_eq!((scores.n.psnr, scores.n.depth, scores.n.lpips), (1, 2, 0));
    assert!(scores.only_in_prediction[0].ends_with(":rgb_wrist[1]"));

    let lists = write("lists.safetensors", &[frames]);
    let error = score_paths(&lists, &other, SsimVariant::default(), None, [None; 2]).unwrap_err();
    assert!(
        error.to_string().contains("no array of images; it has: frames"),
        "{error}"
    );
    let strange = write("strange.safetensors", &[("rgb", vec![2, 2, 2, 2], 0.0)]);
    let error = score_paths(&strange, &other, SsimVariant::default(), None, [None; 2]).unwrap_err();
    assert!(error.to_string().contains("[2, 2, 2, 2]"), "{error}");
    let missing = folder.path().join("missing.png");
    let error = score_paths(&own, &missing, SsimVariant::default(), None, [None; 2]).unwrap_err();
    assert!(matches!(error, FolderError::Nothing { .. }), "{error}");
}

#[test]
fn units_of_depth_are_told_by_name_and_stated() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own.exr", "other.exr"].map(|name| folder.path().join(name));
    let truth = vec![0.9_f32, 1.0, 1.1, 1.2, 1.3, 1.4];
    let scaled = |factor: f32| truth.iter().map(|depth| depth * factor).collect::<Vec<f32>>();
    let notes = |own_unit: Option<f64>, other_unit: Option<f64>| {
        let scores = score_paths(&own, &other, SsimVariant::default(), None, [own_unit, other_unit]).unwrap();
        (scores.absrel, scores.pairs[0].notes.join("; "))
    };
    write_depth(&other, 3, 2, "Z", truth.clone());
    for (factor, words) in [
        (1000.0, "millimetres instead of metres"),
        (100.0, "centimetres instead of metres"),
        (57.29578, "57.29"),
        (39.37, "inches"),
        (10.0, "10000 steps"),
        (5.0, "5000 steps"),
        (0.001, "divided by 1000"),
        (0.2, "a fifth of the unit"),
    ] {
        write_depth(&own, 3, 2, "Z", scaled(factor));
        let (_, told) = notes(None, None);
        assert!(
            told.contains(words) && told.contains("--prediction-unit-m"),
            "{factor}: {told}"
        );
        let (absrel, told) = notes(Some(f64::from(1.0 / factor)), None);
        assert!(absrel.unwrap() < 1e-5 && told.is_empty(), "{factor}: {told}");
    }
    for factor in [1.0, 1.3, 2.0, 0.7] {
        write_depth(&own, 3, 2, "Z", scaled(factor));
        assert_eq!(notes(None, None).1, "", "{factor}");
    }
    write_depth(&own, 3, 2, "Z", truth.clone());
    for (factor, words) in [
        (1000.0, "millimetres instead"),
        (0.001, "divided by 1000"),
        (0.0, "no value is above 0"),
    ] {
        write_depth(&other, 3, 2, "Z", scaled(factor));
        let (absrel, told) = notes(None, None);
        assert!(absrel.is_none() && told.contains(words), "{factor}: {told}");
    }
    write_depth(&other, 3, 2, "Z", scaled(1000.0));
    let (absrel, told) = notes(None, Some(0.001));
    assert!(absrel.unwrap() < 1e-5 && told.is_empty(), "{told}");
}

#[test]
fn depth_comes_as_npy_and_as_16_bit_png() {
    let folder = tempfile::tempdir().unwrap();
    let [steps, metres] = ["steps.png", "metres.npy"].map(|name| folder.path().join(name));
    let picture =
        image::ImageBuffer::<image::Luma<u16>, _>::from_fn(4, 2, |x, y| image::Luma([(900 + 100 * x + y) as u16]));
    picture.save(&steps).unwrap();
    let values: Vec<f32> = picture.as_raw().iter().map(|step| f32::from(*step) / 1000.0).collect();
    std::fs::write(&metres, rogs_arrays::npy_bytes(&[2, 4, 1], &values)).unwrap();
    let score = |unit: Option<f64>| {
        let scores = score_paths(&steps, &metres, SsimVariant::default(), None, [unit, None]).unwrap();
        (scores.psnr, scores.absrel.unwrap(), scores.pairs[0].notes.join("; "))
    };
    let (psnr, absrel, told) = score(None);
    assert!(psnr.is_none() && absrel < 1e-6, "{absrel}");
    assert!(
        told.contains("16-bit grey pixels are taken as depth in millimetres"),
        "{told}"
    );
    let (_, absrel, told) = score(Some(0.001));
    assert!(absrel < 1e-6 && told.is_empty(), "{told}");
    let (_, absrel, told) = score(Some(0.0002));
    assert!(absrel > 0.79 && told.contains("a fifth"), "{told}");
}

#[test]
fn folders_are_compared_without_what_systems_leave_in_them() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own", "other"].map(|name| folder.path().join(name));
    for folder in [&own, &other] {
        std::fs::create_dir(folder).unwrap();
        picture(0).save(folder.join("a.png")).unwrap();
        for stray in [
            "._a.png",
            "a.png.part",
            "Thumbs.db",
            "a.sync-conflict-20260131-1.png",
            "~$a.png",
        ] {
            std::fs::write(folder.join(stray), "no image").unwrap();
        }
    }
    let scores = score_paths(&own, &other, SsimVariant::default(), None, [None; 2]).unwrap();
    assert_eq!((scores.pairs.len(), scores.n.psnr), (1, 1));
}

#[test]
fn bytes_that_were_colours_in_0_to_1_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own.png", "other.png"].map(|name| folder.path().join(name));
    RgbImage::from_fn(32, 24, |x, _| Rgb([(x % 2) as u8; 3]))
        .save(&own)
        .unwrap();
    picture(0).save(&other).unwrap();
    let scores = score_paths(&own, &other, SsimVariant::default(), None, [None; 2]).unwrap();
    assert!(
        scores.pairs[0].notes[0].contains("bytes go to 255"),
        "{:?}",
        scores.pairs[0].notes
    );
}

/// A photograph that its Exif data turn is compared as viewers show it, and that is told; what else images say, too.
#[test]
fn images_are_compared_as_they_say_they_lie() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let turned = place("turned.jpg");
    let stored = image::imageops::rotate270(&picture(0));
    stored.save(&turned).unwrap();
    picture(0).save(place("upright.png")).unwrap();
    // Orientation 6 behind the head: to be turned by a quarter with the clock.
    let mut bytes = std::fs::read(&turned).unwrap();
    let mut exif = b"\xff\xe1\0\x22Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0".to_vec();
    let length = exif.len() as u8 - 2;
    exif[3] = length;
    bytes.splice(2..2, exif);
    std::fs::write(&turned, bytes).unwrap();
    let scores = |own: &str| {
        let variant = SsimVariant::Torchmetrics;
        score_paths(&place(own), &place("upright.png"), variant, None, [None; 2])
    };
    let told = scores("turned.jpg").unwrap();
    assert!(told.psnr.unwrap() > 25.0, "{told:?}");
    assert!(
        told.pairs[0].notes.concat().contains("prediction: its Exif data"),
        "{told:?}"
    );
    // Four components: the colours of a printer.
    let mut bytes = std::fs::read(place("turned.jpg")).unwrap();
    let frame = bytes.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
    bytes[frame + 9] = 4;
    std::fs::write(place("printer.jpg"), bytes).unwrap();
    let error = scores("printer.jpg").unwrap_err();
    assert!(error.to_string().contains("those of printers"), "{error}");
}
