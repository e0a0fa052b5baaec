//! The PLY reader and writer: exact convention, by name, bounded.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::path::Path;

use proptest::prelude::*;
use rogs_field::{read_ply, write_ply};
use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, Gaussians};

fn scene(degree: usize) -> Gaussians {
    let value = |k: usize| ((k * 2_654_435_761) % 1000) as f32 / 1000.0;
    let n = 5;
    let k = (degree + 1) * (degree + 1);
    Gaussians {
        means: (0..3 * n).map(|i| value(i) * 4.0 - 2.0).collect(),
        quats: (0..4 * n).map(|i| value(i + 3) - 0.4).collect(),
        scales: (0..3 * n).map(|i| value(i + 7) * 0.1 + 1e-3).collect(),
        opacities: (0..n).map(|i| value(i + 9) * 0.9 + 0.05).collect(),
        colour: Colour::Sh {
            degree,
            coefficients: (0..3 * k * n).map(|i| value(i + 1) - 0.5).collect(),
        },
        extra: Vec::new(),
        extra_channels: 0,
    }
}

fn written(gaussians: &Gaussians, unit: LengthUnit) -> Vec<u8> {
    let mut bytes = Vec::new();
    let comments = ["frame recon_opencv unit m".to_owned()];
    write_ply(gaussians, unit, &comments, &mut bytes, Path::new("memory")).unwrap();
    bytes
}

fn close(a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len());
    for (x, y) in a.iter().zip(b) {
        assert!((x - y).abs() <= tolerance * x.abs().max(1.0), "{x} {y}");
    }
}

#[test]
fn what_is_written_is_read_back_in_metres() {
    for degree in 0..=3 {
        let scene = scene(degree);
        let read = read_ply(&written(&scene, LengthUnit::Internal)).unwrap();
        assert_eq!(read.comments, ["frame recon_opencv unit m"]);
        close(
            &scene.means.iter().map(|v| v / 3.5).collect::<Vec<_>>(),
            &read.gaussians.means,
            0.0,
        );
        close(
            &scene.scales.iter().map(|v| v / 3.5).collect::<Vec<_>>(),
            &read.gaussians.scales,
            1e-6,
        );
        close(&scene.opacities, &read.gaussians.opacities, 1e-6);
        assert_eq!(scene.colour, read.gaussians.colour);
        for (a, b) in scene.quats.chunks(4).zip(read.gaussians.quats.chunks(4)) {
            let norm = a.iter().map(|v| v * v).sum::<f32>().sqrt();
            close(&a.iter().map(|v| v / norm).collect::<Vec<_>>(), b, 1e-6);
        }
    }
}

#[test]
fn bytes_follow_the_convention() {
    let scene = scene(1);
    let bytes = written(&scene, LengthUnit::Metre);
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    assert!(header.starts_with("ply\nformat binary_little_endian 1.0\ncomment frame recon_opencv unit m\n"));
    let names: Vec<&str> = header
        .lines()
        .filter_map(|l| l.strip_prefix("property float "))
        .collect();
    assert_eq!(names[..7], ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0"]);
    assert_eq!(
        names[names.len() - 5..],
        ["scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    );
    let row: Vec<f32> = bytes[end..][..4 * names.len()]
        .chunks(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect();
    let Colour::Sh { coefficients, .. } = &scene.colour else {
        panic!()
    };
    // Channel major: f_rest_3 is the first coefficient of green.
    assert_eq!(row[6 + 3], coefficients[3 + 1]);
    let opacity = scene.opacities[0];
    assert!((row[15] - (opacity / (1.0 - opacity)).ln()).abs() < 1e-6);
    assert!((row[16] - scene.scales[0].ln()).abs() < 1e-6);
}

#[test]
fn properties_are_found_by_name_and_others_skipped() {
    let names = [
        "nx", "rot_3", "rot_2", "rot_1", "rot_0", "scale_2", "scale_1", "scale_0", "f_dc_2", "f_dc_1", "f_dc_0",
        "opacity", "z", "y", "x",
    ];
    let mut bytes =
        b"ply\r\nformat binary_little_endian 1.0\nelement camera 2\nproperty double t\nelement vertex 1\n".to_vec();
    bytes.extend(b"property uchar flag\n");
    for name in names {
        bytes.extend(format!("property float {name}\n").bytes());
    }
    bytes.extend(b"element face 1\nproperty list uchar int vertex_indices\nend_header\n");
    bytes.extend([0; 16]);
    bytes.push(7);
    for k in 0..names.len() {
        bytes.extend((k as f32).to_le_bytes());
    }
    let read = read_ply(&bytes).unwrap().gaussians;
    assert_eq!(read.means, [14.0, 13.0, 12.0]);
    assert_eq!(read.quats, [4.0, 3.0, 2.0, 1.0]);
    assert_eq!(read.colour.values(), [10.0, 9.0, 8.0]);
}

#[test]
fn damage_is_named() {
    let good = written(&scene(1), LengthUnit::Metre);
    let says = |bytes: &[u8], what: &str| {
        let message = read_ply(bytes).unwrap_err().to_string();
        assert!(message.contains(what), "{message}");
    };
    says(&good[..good.len() - 1], "5 vertices");
    says(b"obj\n", "does not begin with `ply`");
    says(b"ply\nformat ascii 1.0\n", "binary_little_endian");
    let text = |from: &str, to: &str| {
        let end = good.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let header = std::str::from_utf8(&good[..end]).unwrap().replace(from, to);
        [header.as_bytes(), &good[end..]].concat()
    };
    says(&text("f_rest_8", "other"), "8 properties `f_rest_*`");
    says(&text("rot_2", "rot_9"), "`rot_2` is missing");
    says(
        &text("element vertex 5", "element vertex 99999999999999999999"),
        "count",
    );
    says(&text("element vertex 5", "element vertex 900000000"), "vertices");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        let _ = read_ply(&bytes);
    }

    #[test]
    fn damaged_files_never_panic(at in 0_usize..1500, value in any::<u8>(), cut in 0_usize..1500) {
        let mut bytes = written(&scene(1), LengthUnit::Metre);
        let length = bytes.len();
        bytes[at % length] = value;
        bytes.truncate(length - cut % length);
        if let Ok(read) = read_ply(&bytes) {
            prop_assert!(read.gaussians.validate().is_ok());
        }
    }
}

/// A header and one vertex, for files of other programs.
fn foreign(properties: &[(&str, &str)], numbers: &[u8]) -> Vec<u8> {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\nelement vertex 1\n");
    for (kind, name) in properties {
        text += &format!("property {kind} {name}\n");
    }
    text += "end_header\n";
    [text.as_bytes(), numbers].concat()
}

const SHAPE: [&str; 11] = [
    "x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
];

#[test]
fn doubles_and_colours_as_bytes_are_read() {
    let of_shape = |kind: &'static str| SHAPE.iter().map(move |&name| (kind, name));
    let shape = |value: fn(f64) -> Vec<u8>| {
        (0..11)
            .flat_map(move |n| value(f64::from(n) / 4.0))
            .collect::<Vec<u8>>()
    };
    let doubles = shape(|value| value.to_le_bytes().to_vec());
    let floats = shape(|value| (value as f32).to_le_bytes().to_vec());
    let bytes = ["red", "green", "blue"].map(|name| ("uchar", name));
    let colours = [0_u8, 255, 102];
    let harmonics = ["f_dc_0", "f_dc_1", "f_dc_2"].map(|name| ("float", name));
    let same = colours.map(|byte| (f32::from(byte) / 255.0 - 0.5) / 0.282_094_8);
    let same: Vec<u8> = same.iter().flat_map(|value| value.to_le_bytes()).collect();
    let plain: Vec<_> = of_shape("float").chain(harmonics).collect();
    let expected = read_ply(&foreign(&plain, &[floats.clone(), same.clone()].concat()))
        .unwrap()
        .gaussians;
    for (properties, numbers) in [
        (
            of_shape("double").chain(harmonics).collect::<Vec<_>>(),
            [doubles, same].concat(),
        ),
        (
            of_shape("float").chain(bytes).collect(),
            [floats, colours.to_vec()].concat(),
        ),
    ] {
        let read = read_ply(&foreign(&properties, &numbers)).unwrap().gaussians;
        assert_eq!(
            (&read.means, &read.quats, &read.opacities),
            (&expected.means, &expected.quats, &expected.opacities)
        );
        let (Colour::Sh { coefficients: got, .. }, Colour::Sh { coefficients: want, .. }) =
            (&read.colour, &expected.colour)
        else {
            panic!("no harmonics");
        };
        close(want, got, 1e-6);
    }
}

#[test]
fn forms_that_are_not_read_are_named_with_a_way_on() {
    let packed = [("uint", "packed_position"), ("uint", "packed_rotation")];
    let chunk = b"ply\nformat binary_little_endian 1.0\nelement chunk 1\nproperty float min_x\nend_header\n".to_vec();
    let shape: Vec<_> = SHAPE.iter().map(|&name| ("float", name)).collect();
    let wide = shape
        .iter()
        .copied()
        .chain([("float", "red"), ("float", "green"), ("float", "blue")])
        .collect::<Vec<_>>();
    let filtered: Vec<_> = shape.iter().copied().chain([("float", "filter_3D")]).collect();
    for (file, words) in [
        (foreign(&packed, &[0; 8]), "element `chunk`"),
        (chunk, "promises more"),
        (foreign(&shape, &[0; 44]), "`f_dc_0` is missing"),
        (foreign(&wide, &[0; 56]), "sh_coeffs"),
        (foreign(&filtered, &[0; 48]), "`filter_3D` of Mip-Splatting"),
        (
            foreign(&[("float", "x"), ("float", "nx")], &[0; 8]),
            "this one has x, nx",
        ),
        (b"ply\nformat ascii 1.0\n".to_vec(), "save it as that"),
        (b"ply\nformat binary_big_endian 1.0\n".to_vec(), "binary_little_endian"),
    ] {
        let message = read_ply(&file).unwrap_err().to_string();
        assert!(
            message.contains(words) && message.starts_with("not a readable 3DGS PLY"),
            "{message}"
        );
    }
}

#[test]
fn infinite_logits_are_opacities_of_zero_and_one() {
    let properties: Vec<_> = SHAPE
        .iter()
        .chain(&["f_dc_0", "f_dc_1", "f_dc_2"])
        .map(|&name| ("float", name))
        .collect();
    for (logit, opacity) in [(f32::INFINITY, 1.0), (f32::NEG_INFINITY, 0.0), (88.0, 1.0)] {
        let mut numbers = [0.0_f32; 14];
        numbers[3] = logit;
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        assert_eq!(
            read_ply(&foreign(&properties, &bytes)).unwrap().gaussians.opacities,
            [opacity]
        );
    }
}

#[cfg(unix)]
#[test]
fn what_is_no_file_is_refused_before_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("scene.ply");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.unwrap().success());
    for path in [pipe.as_path(), Path::new("/dev/zero"), folder.path()] {
        assert!(rogs_field::read_ply_file(path).is_err(), "{}", path.display());
    }
}
