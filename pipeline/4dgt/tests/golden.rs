//! The network against values of its own public code (tiny sizes), and its list of tensors against the released one.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use burn::tensor::{Device, Tensor};
use rogs_4dgt::config::HEADS;
use rogs_4dgt::decode::{RawFrame, decode};
use rogs_4dgt::rays::{RayCamera, Rays};
use rogs_4dgt::{FourDgt, FourDgtConfig, Stream, layout, mean_frame};
use rogs_geometry::{Pinhole, Pose};
use rogs_needs::{needs, shared};
use rogs_schemas::{Intrinsics, RigidPose};
use rogs_tensors::parameters::{Parameters, from_host, to_host};
use rogs_vit::EncoderSizes;
use safetensors::SafeTensors;

const FRAMES: usize = 3;
const SIZE: [usize; 2] = [28, 42];
const AREA: usize = SIZE[0] * SIZE[1];

fn f32s(file: &SafeTensors<'_>, name: &str) -> Vec<f32> {
    let bytes = file.tensor(name).unwrap().data();
    let (fours, _) = bytes.as_chunks::<4>();
    fours.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

fn f64s(file: &SafeTensors<'_>, name: &str) -> Vec<f64> {
    let bytes = file.tensor(name).unwrap().data();
    let (eights, _) = bytes.as_chunks::<8>();
    eights.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()
}

/// Fails where values differ by more than `absolute + relative |expected|`.
fn close(what: &str, found: &[f32], expected: &[f32], absolute: f32, relative: f32) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let mut worst = 0.0f32;
    for (index, (a, b)) in found.iter().zip(expected).enumerate() {
        let difference = (a - b).abs();
        assert!(
            difference <= absolute + relative * b.abs(),
            "{what}[{index}]: {a}, expected {b}"
        );
        worst = worst.max(difference);
    }
    println!("{what}: {worst:.1e}");
}

/// Planes one after the other to channels beside each other. `[C, T, H, W] -> [T, H, W, C]`
fn beside(planes: &[f32], channels: usize) -> Vec<f32> {
    let area = planes.len() / channels;
    let pixel = |pixel: usize| (0..channels).map(move |channel| planes[channel * area + pixel]);
    (0..area).flat_map(pixel).collect()
}

fn tiny(file: &SafeTensors<'_>) -> FourDgt {
    let device = Device::flex();
    let mut parameters = Parameters::new(&device);
    for name in file.names() {
        if let Some(own) = name.strip_prefix("w.").filter(|own| *own != "random_pattern") {
            let shape = file.tensor(name).unwrap().shape().to_vec();
            parameters.insert(own, &shape, f32s(file, name)).unwrap();
        }
    }
    let config = FourDgtConfig {
        name: "tiny".into(),
        width: 48,
        blocks: 2,
        heads: 4,
        head_hidden: 8,
        encoder_width: 16,
    };
    let encoder = EncoderSizes {
        width: 16,
        ..EncoderSizes::vit_b(0)
    };
    FourDgt::new(config, parameters, encoder, Parameters::new(&device)).unwrap()
}

fn stream(file: &SafeTensors<'_>) -> Stream {
    let (poses, lenses) = (f32s(file, "in.c2w"), f32s(file, "in.K"));
    let camera = |index: usize| {
        let pose: [f64; 16] = std::array::from_fn(|k| f64::from(poses[index * 16 + k]));
        let lens = |k: usize| f64::from(lenses[index * 9 + k]);
        RayCamera {
            lens: Pinhole {
                intrinsics: Intrinsics {
                    fx: lens(0),
                    fy: lens(4),
                    cx: lens(2),
                    cy: lens(5),
                },
                height: SIZE[0] as u32,
                width: SIZE[1] as u32,
            },
            mean_from_camera: Pose::from_matrix4(&pose).unwrap(),
        }
    };
    Stream {
        images: f32s(file, "in.images")
            .iter()
            .map(|value| (value + 1.0) / 2.0)
            .collect(),
        times_s: f32s(file, "in.times"),
        cameras: (0..FRAMES).map(camera).collect(),
    }
}

#[needs(shared)]
#[test]
fn the_tiny_network_is_as_published() {
    let bytes = std::fs::read(shared!("golden/baselines/4dgt_tiny.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let (network, stream) = (tiny(&file), stream(&file));
    let expected = |name: &str| f32s(&file, name);

    let rays: Vec<Rays> = stream.cameras.iter().map(Rays::new).collect();
    let directions: Vec<f32> = rays.iter().flat_map(|own| own.direction.clone()).collect();
    close("directions", &directions, &beside(&expected("mid.ray_d"), 3), 1e-5, 0.0);
    let plucker: Vec<f32> = rays.iter().flat_map(|own| beside(&own.plucker(SIZE[1]), 6)).collect();
    close("plucker", &plucker, &beside(&expected("mid.plucker"), 6), 1e-5, 0.0);

    // The class token of the supplied features is dropped.
    let dino: Tensor<3> = from_host(expected("in.dino_x_prenorm"), [FRAMES, 7, 16], &Device::flex());
    let features = dino.narrow(1, 1, 6);
    let projected = to_host(network.projected(&stream, features.clone()).unwrap()).unwrap();
    close("input_linear", &projected, &expected("act.input_linear"), 1e-4, 0.0);
    let tokens = network.tokens(&stream, features).unwrap();
    close(
        "tokens",
        &to_host(tokens.clone()).unwrap(),
        &expected("act.tokens"),
        1e-4,
        0.0,
    );
    let mut running = network.with_class(tokens.clone()).unwrap();
    for index in 0..2 {
        running = network.block(index).unwrap().forward(running, None);
        let name = format!("act.block{index}");
        close(&name, &to_host(running.clone()).unwrap(), &expected(&name), 1e-4, 0.0);
    }
    let last = network.transform(tokens).unwrap();
    let normed = expected("act.norm_with_cls_last");
    close("norm", &to_host(last.clone()).unwrap(), &normed[..18 * 48], 1e-4, 0.0);

    let heads = network.heads(last).unwrap();
    let raw = |name: &str| match name {
        "scale" => "raw.scaling".to_owned(),
        "rgb" => "raw.feature".to_owned(),
        other => format!("raw.{other}"),
    };
    macro_rules! check_head {
        ($($index:literal: $channels:literal),*) => {$({
            let (name, channels) = HEADS[$index];
            assert_eq!(channels, $channels);
            let mut found = Vec::new();
            for frame in 0..FRAMES {
                let own = RawFrame::new(&heads, frame, SIZE);
                for pixel in 0..AREA {
                    found.extend(own.pixel::<$channels>($index, pixel / SIZE[1], pixel % SIZE[1]));
                }
            }
            close(name, &found, &expected(&raw(name)), 1e-4, 0.0);
        })*};
    }
    check_head!(0: 1, 1: 1, 2: 3, 3: 4, 4: 4, 5: 16, 6: 1, 7: 8, 8: 4);

    let mut field = rogs_schemas::records::polynomial::Polynomials::default();
    for frame in 0..FRAMES {
        field.append(decode(
            &RawFrame::new(&heads, frame, SIZE),
            &rays[frame],
            stream.times_s[frame],
        ));
    }
    field.check().unwrap();
    close("xyz", &field.centre_m, &expected("gs.xyz"), 1e-4, 2e-5);
    close("t", &field.time_s, &expected("gs.t"), 1e-4, 0.0);
    close("cov_t", &field.variance_s2, &expected("gs.cov_t"), 0.0, 2e-5);
    close("ms3", &field.velocity, &expected("gs.ms3"), 1e-4, 0.0);
    close("omega", &field.angular, &expected("gs.omega"), 1e-4, 0.0);
    close("rotation", &field.rotation, &expected("gs.rotation"), 1e-4, 0.0);
    close("scaling", &field.scale_m, &expected("gs.scaling"), 1e-4, 0.0);
    close("opacity", &field.opacity, &expected("gs.opacity"), 1e-4, 0.0);
    let rgb: Vec<f32> = expected("gs.feature")
        .chunks_exact(4)
        .flat_map(|one| one[..3].to_vec())
        .collect();
    close("feature", &field.rgb, &rgb, 1e-4, 0.0);
}

#[needs(shared)]
#[test]
fn recentring_is_as_published() {
    let bytes = std::fs::read(shared!("golden/baselines/4dgt_tiny.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    // The first three rows of a row-major matrix.
    let pose = |m: &[f64]| RigidPose {
        rotation: [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]],
        translation: [m[3], m[7], m[11]],
    };
    let mut error = 0.0f64;
    for case in ["pose", "pose_fixed"] {
        let poses: Vec<RigidPose> = f64s(&file, &format!("{case}.c2w")).chunks_exact(16).map(pose).collect();
        let found = mean_frame(&poses).unwrap();
        let expected = pose(&f64s(&file, &format!("{case}.avg")));
        let rotations = found.rotation.iter().zip(&expected.rotation);
        let pairs = rotations.chain(found.translation.iter().zip(&expected.translation));
        error = pairs.map(|(a, b)| (a - b).abs()).fold(error, f64::max);
    }
    println!("recentring: {error:.1e}");
    assert!(error < 1e-9);
}

#[needs(shared)]
#[test]
fn the_tensors_of_the_full_network_are_the_released_ones() {
    let text = std::fs::read_to_string(shared!("golden/baselines/4dgt_state_dict.tsv")).unwrap();
    let mut released: Vec<(String, Vec<usize>)> = Vec::new();
    for line in text.lines() {
        let [name, shape, dtype] = line.split('\t').collect::<Vec<_>>()[..] else {
            panic!("{line}");
        };
        let name = name.strip_prefix("image_coder.").unwrap();
        if name == "random_pattern" {
            assert_eq!(dtype, "int64");
            continue;
        }
        assert_eq!(dtype, "float32", "{line}");
        let sides = shape
            .trim_matches(['(', ')'])
            .split(',')
            .filter(|side| !side.is_empty());
        released.push((
            name.to_owned(),
            sides.map(|side| side.trim().parse().unwrap()).collect(),
        ));
    }
    let mut own: Vec<_> = layout::network(&FourDgtConfig::full())
        .into_iter()
        .map(|spec| (spec.name, spec.shape))
        .collect();
    released.sort();
    own.sort();
    assert_eq!(own.len(), 128);
    assert_eq!(own, released);
}
