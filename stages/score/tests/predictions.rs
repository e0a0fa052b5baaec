//! Outside methods from files: the same field scored as PLY, as `.npz`, as rendered images and camera-wise must have the
//! scores that it has as a field of rogs.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use std::io::Write as _;
use std::path::{Path, PathBuf};

use rogs_field::{Axes, TimedField};
use rogs_geometry::{Pinhole, Pose, PosedCamera, Recon};
use rogs_r4c::source::hash_source;
use rogs_schemas::records::scores::{ScoreSheet, Scores};
use rogs_schemas::units::LengthUnit;
use rogs_splat::RasterCamera;
use serde_json::{Value, json};
use support::{Bench, FRAMES, HEIGHT, LOOKING_ALONG_X, QUERIES, STEP_M, WIDTH, clip, field};

/// An `.npz` archive, stored or deflated, as numpy writes it.
fn write_npz(path: &Path, arrays: &[(&str, Vec<usize>, Vec<f32>)], deflate: bool) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mut file = std::fs::File::create(path).unwrap();
    let (mut at, mut directory) = (0u32, Vec::new());
    for (name, shape, values) in arrays {
        let shape: Vec<String> = shape.iter().map(|length| format!("{length},")).collect();
        let header = format!(
            "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}\n",
            shape.join(" ")
        );
        let mut npy = b"\x93NUMPY\x01\x00".to_vec();
        npy.extend((header.len() as u16).to_le_bytes());
        npy.extend(header.as_bytes());
        npy.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        let packed = if deflate {
            miniz_oxide::deflate::compress_to_vec(&npy, 6)
        } else {
            npy.clone()
        };
        let name = format!("{name}.npy");
        // From "version needed" to "name length, extra length".
        let mut common = vec![20, 0, 0, 0, if deflate { 8 } else { 0 }, 0, 0, 0, 0, 0];
        common.extend(crc32fast::hash(&npy).to_le_bytes());
        common.extend((packed.len() as u32).to_le_bytes());
        common.extend((npy.len() as u32).to_le_bytes());
        common.extend((name.len() as u16).to_le_bytes());
        common.extend([0, 0]);
        let local = [b"PK\x03\x04".as_slice(), &common, name.as_bytes(), &packed].concat();
        directory.extend(
            [
                b"PK\x01\x02\x14\x00".as_slice(),
                &common,
                &[0; 10],
                &at.to_le_bytes(),
                name.as_bytes(),
            ]
            .concat(),
        );
        file.write_all(&local).unwrap();
        at += local.len() as u32;
    }
    let count = (arrays.len() as u16).to_le_bytes();
    let mut end = b"PK\x05\x06\0\0\0\0".to_vec();
    end.extend(count);
    end.extend(count);
    end.extend((directory.len() as u32).to_le_bytes());
    end.extend(at.to_le_bytes());
    end.extend([0, 0]);
    file.write_all(&directory).unwrap();
    file.write_all(&end).unwrap();
}

fn with_predictions(folder: &Path) -> Bench {
    let mut bench = Bench::new(&clip(true));
    bench.inputs.remove("field");
    bench.keys.remove("field");
    let hash = hash_source("predictions", folder).unwrap();
    bench.keys.insert("predictions".into(), hash.to_string());
    bench.inputs.insert("predictions".into(), folder.to_owned());
    bench
}

fn score(folder: &Path, prediction: Value) -> (Value, Option<Scores>) {
    let params = json!({"method": "other", "prediction": prediction});
    let (event, scores, _) = with_predictions(folder).run(&params, "2");
    (event, scores)
}

fn good(folder: &Path, prediction: Value) -> Scores {
    let (event, scores) = score(folder, prediction);
    scores.unwrap_or_else(|| panic!("no scores: {event}"))
}

fn native() -> Scores {
    Bench::new(&clip(true)).run(&json!({}), "2").1.unwrap()
}

/// Largest difference of the numbers of two sheets; they must have numbers in the same places.
fn difference(a: &ScoreSheet, b: &ScoreSheet) -> f64 {
    let mut worst = 0.0f64;
    let mut compare = |a: Option<f64>, b: Option<f64>| match (a, b) {
        (Some(a), Some(b)) => worst = worst.max((a - b).abs()),
        (a, b) => assert_eq!(a, b),
    };
    assert_eq!((a.images.len(), a.tracks.len()), (b.images.len(), b.tracks.len()));
    for (a, b) in a.images.iter().zip(&b.images) {
        assert_eq!((&a.camera, a.frame, a.support_n), (&b.camera, b.frame, b.support_n));
        for (a, b) in [
            (a.psnr, b.psnr),
            (a.ssim, b.ssim),
            (a.absrel, b.absrel),
            (a.rmse_m, b.rmse_m),
            (a.delta1, b.delta1),
        ] {
            compare(a, b);
        }
    }
    for (a, b) in a.tracks.iter().zip(&b.tracks) {
        assert_eq!((a.anchor, a.frame, a.n_tracks), (b.anchor, b.frame, b.n_tracks));
        compare(a.epe_mm, b.epe_mm);
    }
    for (a, b) in a.robot_depth.iter().zip(&b.robot_depth) {
        assert_eq!((a.frame, a.core_n), (b.frame, b.core_n));
        compare(a.robot_depth_mm, b.robot_depth_mm);
    }
    worst
}

/// The wall's Gaussians at the query times in the wrist camera's frame, metres, lengths divided by `unit`.
fn gaussians_npz(unit: f32) -> Vec<(&'static str, Vec<usize>, Vec<f32>)> {
    let field = field();
    let timed = TimedField::new(&field).unwrap();
    let n = HEIGHT * WIDTH;
    let mut means = Vec::new();
    for frame in QUERIES {
        let shift = STEP_M * frame as f32;
        means.extend(
            field
                .position_m
                .chunks_exact(3)
                .flat_map(|p| [(p[0] + shift) / unit, p[1] / unit, p[2] / unit]),
        );
    }
    let state = timed.gaussians(0.0).unwrap();
    let metre = |values: &[f32]| -> Vec<f32> {
        values
            .iter()
            .map(|&value| rogs_schemas::units::m_from_iu(value) / unit)
            .collect()
    };
    vec![
        ("frames", vec![3], QUERIES.iter().map(|&frame| frame as f32).collect()),
        ("means", vec![3, n, 3], means),
        ("quats", vec![n, 4], state.quats.clone()),
        ("scales", vec![n, 3], metre(&state.scales)),
        ("opacities", vec![n], state.opacities.clone()),
        ("rgb", vec![n, 3], state.colour.values().to_vec()),
    ]
}

#[test]
fn npz_fields_have_the_scores_of_the_same_field_of_our_own() {
    let native = native();
    for deflate in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        write_npz(&folder.path().join("gaussians.npz"), &gaussians_npz(1.0), deflate);
        let found = good(folder.path(), json!({"frame": "camera"}));
        let worst = difference(&native.summary, &found.summary);
        assert!(worst < 2e-3, "{worst}");
        assert_eq!(found.summary.method, "other");
        assert_eq!(found.renders.len(), native.renders.len());
    }
    // The pose in the file goes before the parameter.
    let folder = tempfile::tempdir().unwrap();
    let mut arrays = gaussians_npz(1.0);
    let (r, t) = (LOOKING_ALONG_X.rotation, LOOKING_ALONG_X.translation);
    let rows = (0..3).flat_map(|k| [r[3 * k], r[3 * k + 1], r[3 * k + 2], t[k]]);
    arrays.push(("base_from_field", vec![3, 4], rows.map(|value| value as f32).collect()));
    write_npz(&folder.path().join("gaussians.npz"), &arrays, false);
    let worst = difference(&native.summary, &good(folder.path(), json!({})).summary);
    assert!(worst < 2e-3, "{worst}");
}

#[test]
fn ply_files_have_the_scores_of_the_same_field_of_our_own() {
    let folder = tempfile::tempdir().unwrap();
    let (field, native) = (field(), native());
    let timed = TimedField::new(&field).unwrap();
    for frame in QUERIES {
        let path = folder.path().join(format!("frame-{frame:03}.ply"));
        rogs_field::export_field(&timed, f64::from(frame) / (FRAMES - 1) as f64, Axes::Recon, &path).unwrap();
    }
    let found = good(folder.path(), json!({"frame": "camera"}));
    let worst = difference(&native.summary, &found.summary);
    assert!(worst < 5e-3, "{worst}");
    assert!(found.summary.tracks.iter().all(|track| track.epe_mm.is_some()));

    std::fs::remove_file(folder.path().join("frame-009.ply")).unwrap();
    let (event, scores) = score(folder.path(), json!({"frame": "camera"}));
    assert!(scores.is_none());
    let message = event["message"].as_str().unwrap();
    assert!(
        message.contains("clip frame 9") && message.contains("frames: 0, 4"),
        "{message}"
    );
}

#[test]
fn rendered_images_have_the_scores_of_the_renders() {
    let (field, native) = (field(), native());
    let folder = tempfile::tempdir().unwrap();
    let (q, n) = (QUERIES.len(), HEIGHT * WIDTH);
    let mut arrays = vec![(
        "frames",
        vec![q],
        QUERIES.iter().map(|&frame| frame as f32).collect::<Vec<_>>(),
    )];
    let timed = TimedField::new(&field).unwrap();
    let lens = Pinhole {
        intrinsics: support::intrinsics(),
        width: WIDTH as u32,
        height: HEIGHT as u32,
    };
    let camera: PosedCamera<Recon> = PosedCamera::new(lens, Pose::IDENTITY);
    let camera = RasterCamera::new(&camera, LengthUnit::Internal);
    let (mut rgb, mut depth, mut displacement) = (Vec::new(), Vec::new(), Vec::new());
    for frame in QUERIES {
        let gaussians = timed.gaussians(f64::from(frame) / 16.0).unwrap();
        let render = rogs_splat::render(&gaussians, &camera, &rogs_splat::RasterConfig::default()).unwrap();
        depth.extend(render.depth_expected_m());
        rgb.extend(render.rgb);
        // Camera x is base -y.
        displacement.extend((0..n).flat_map(|_| [0.0, -STEP_M * frame as f32, 0.0]));
    }
    arrays.push(("rgb_wrist", vec![q, HEIGHT, WIDTH, 3], rgb));
    arrays.push(("depth_wrist", vec![q, HEIGHT, WIDTH], depth));
    arrays.push(("displacement_wrist", vec![q, HEIGHT, WIDTH, 3], displacement));
    write_npz(&folder.path().join("images.npz"), &arrays, true);
    let found = good(folder.path(), json!({}));
    let worst = difference(&native.summary, &found.summary);
    assert!(worst < 2e-3, "{worst}");

    // Without displacements there is no displacement error, and it is said why.
    arrays.pop();
    write_npz(&folder.path().join("images.npz"), &arrays, false);
    let (event, scores) = score(folder.path(), json!({}));
    assert!(
        scores
            .unwrap()
            .summary
            .tracks
            .iter()
            .all(|track| track.epe_mm.is_none())
    );
    assert!(
        event["warnings"][0]
            .as_str()
            .unwrap()
            .contains("no rendered displacements"),
        "{event}"
    );

    // Numbers of another unit are told.
    for (name, factor, words) in [
        ("depth_wrist", 1000.0, "millimetres instead of metres"),
        ("depth_wrist", 100.0, "centimetres"),
        ("depth_wrist", 10.0, "ten times"),
        ("depth_wrist", 5.0, "5000 steps"),
        ("depth_wrist", 0.001, "divided by 1000"),
        ("depth_wrist", 0.0, "no view shows anything"),
        ("rgb_wrist", 255.0, "floats are colours in 0 to 1"),
    ] {
        let mut scaled = arrays.clone();
        let array = scaled.iter_mut().find(|(own, ..)| *own == name).unwrap();
        array.2.iter_mut().for_each(|value| *value *= factor);
        write_npz(&folder.path().join("images.npz"), &scaled, false);
        let (event, _) = score(folder.path(), json!({}));
        let warnings = event["warnings"].as_array().unwrap();
        let told = |warning: &serde_json::Value| warning.as_str().unwrap().contains(words);
        assert!(warnings.iter().any(told), "{name} x {factor}: {event}");
    }

    arrays.push(("rgb_front", vec![1], vec![0.0]));
    write_npz(&folder.path().join("images.npz"), &arrays, false);
    let (event, _) = score(folder.path(), json!({}));
    assert!(event["message"].as_str().unwrap().contains("`rgb_front`"), "{event}");
}

#[test]
fn camera_wise_fields_in_a_unit_of_their_own_are_brought_to_metres() {
    let native = native();
    let folder = tempfile::tempdir().unwrap();
    // The reference depth is 1.02 m where the wall stands at 1 m: the factor is 2.5 times that.
    write_npz(&folder.path().join("wrist/gaussians.npz"), &gaussians_npz(2.5), false);
    let found = good(folder.path(), json!({"frame": "camera", "scale": "source-depth"}));
    let info = &found.summary.weights[0];
    let factor: f64 = info.description.rsplit(' ').next().unwrap().parse().unwrap();
    assert!(
        info.description.contains("wrist") && (factor - 2.55).abs() < 2e-3,
        "{info:?}"
    );
    let source = |sheet: &ScoreSheet| sheet.images[0].absrel.unwrap();
    assert!(source(&found.summary) < 2e-3 && source(&native.summary) > 0.015);
    // Displacements are scaled with the field.
    let epe = found.summary.tracks[1].epe_mm.unwrap();
    assert!((epe - 0.02 * 9.0 * f64::from(STEP_M) * 1000.0).abs() < 0.05, "{epe}");

    let (event, scores) = score(folder.path(), json!({"scale": "source-depth"}));
    assert!(
        scores.is_none() && event["message"].as_str().unwrap().contains("prediction.frame"),
        "{event}"
    );
}

#[test]
fn four_dgt_and_shape_of_motion_fields_enter_as_they_are() {
    let n = HEIGHT * WIDTH;
    let arrays = gaussians_npz(1.0);
    let of = |name: &str| arrays.iter().find(|(own, ..)| *own == name).unwrap().2.clone();
    let means = of("means")[..3 * n].to_vec();
    let native = native();
    let folder = tempfile::tempdir().unwrap();
    let mut velocity = vec![0.0; 12 * n];
    // Metres a second, for 15 frames a second.
    velocity.chunks_exact_mut(12).for_each(|own| own[0] = STEP_M * 15.0);
    let fourdgt: Vec<(&str, Vec<usize>, Vec<f32>)> = vec![
        ("xyz", vec![n, 3], means.clone()),
        ("t", vec![n], vec![0.0; n]),
        ("cov_t", vec![n], vec![1e9; n]),
        ("ms3", vec![n, 4, 3], velocity),
        ("omega", vec![n, 2, 3], vec![0.0; 6 * n]),
        ("rotation", vec![n, 4], of("quats")),
        ("scaling", vec![n, 3], of("scales")),
        ("opacity", vec![n], of("opacities")),
        ("rgb", vec![n, 3], of("rgb")),
    ];
    write_npz(&folder.path().join("4dgt.npz"), &fourdgt, false);
    let worst = difference(
        &native.summary,
        &good(folder.path(), json!({"frame": "camera"})).summary,
    );
    assert!(worst < 5e-3, "4DGT: {worst}");

    let folder = tempfile::tempdir().unwrap();
    let logit = |value: f32| libm::logf(value / (1.0 - value));
    let rotations = (0..FRAMES).flat_map(|_| [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let translations = (0..FRAMES).flat_map(|frame| [STEP_M * frame as f32, 0.0, 0.0]);
    let som: Vec<(&str, Vec<usize>, Vec<f32>)> = vec![
        (
            "model.motion_bases.params.rots",
            vec![1, FRAMES, 6],
            rotations.collect(),
        ),
        (
            "model.motion_bases.params.transls",
            vec![1, FRAMES, 3],
            translations.collect(),
        ),
        ("model.fg.params.motion_coefs", vec![n, 1], vec![0.5; n]),
        ("model.fg.params.means", vec![n, 3], means),
        ("model.fg.params.quats", vec![n, 4], of("quats")),
        (
            "model.fg.params.scales",
            vec![n, 3],
            of("scales").into_iter().map(libm::logf).collect(),
        ),
        (
            "model.fg.params.opacities",
            vec![n],
            of("opacities").into_iter().map(logit).collect(),
        ),
        (
            "model.fg.params.colors",
            vec![n, 3],
            of("rgb").into_iter().map(logit).collect(),
        ),
    ];
    write_npz(&folder.path().join("som.npz"), &som, false);
    let worst = difference(
        &native.summary,
        &good(folder.path(), json!({"frame": "camera"})).summary,
    );
    assert!(worst < 5e-3, "SoM: {worst}");
}

#[test]
fn a_clip_without_predictions_has_an_empty_sheet() {
    let folder = tempfile::tempdir().unwrap();
    let (event, scores) = score(folder.path(), json!({}));
    let sheet = scores.unwrap().summary;
    assert_eq!(
        (sheet.method.as_str(), sheet.images.len(), sheet.tracks.len()),
        ("other", 0, 0)
    );
    assert!(event["warnings"][0].as_str().unwrap().contains("left out"), "{event}");
}

#[test]
fn damaged_archives_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path: PathBuf = folder.path().join("gaussians.npz");
    write_npz(&path, &gaussians_npz(1.0), true);
    let good = std::fs::read(&path).unwrap();
    let reads = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        rogs_arrays::ArrayFile::open(&path).is_ok_and(|file| rogs_score::outside::SampledField::read(&file).is_ok())
    };
    for cut in [0, 3, 30, good.len() / 2, good.len() - 5] {
        assert!(!reads(&good[..cut]), "cut at {cut}");
    }
    // A flipped bit of the packed centres is found by the checksum or before.
    for at in (200..1200).step_by(37) {
        let mut bytes = good.clone();
        bytes[at] ^= 1;
        assert!(!reads(&bytes), "byte {at}");
    }
    assert!(reads(&good));
}
