//! The stage on a small clip made here: what a field contains, same bytes for any number of threads and after a kill, what is
//! refused.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use std::path::Path;

use rogs_arrays::{NamedArray, npy_bytes, write_npz};
use rogs_lift_som::{ClipInputs, LiftSomParams, reconstruct};
use rogs_optimise::MotionBases;
use rogs_optimise::bases::{move_gaussians, shares};
use rogs_schemas::interim::Figures;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::motion_bases::{BasisGaussians, MotionBasisField};
use rogs_schemas::records::progress::Progress;
use rogs_schemas::records::robot::{NO_LINK, RobotMaps};
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::{Colour, Gaussians, RasterCamera, RasterConfig, render};
use rogs_worker::{Observer, StageError, StageResult, Unobserved};
use support::{FACTOR, FRAMES, HEIGHT, STEP_M, WIDTH, clip, sidecars};

/// Small numbers, for a clip of six frames in two batches.
fn params(updates: u32) -> LiftSomParams {
    LiftSomParams {
        erode_px: 1,
        dilate_px: 2,
        smallest_cluster: 10,
        clusters: 2,
        track_updates: 30,
        epochs: updates / 2,
        batch: 4,
        ..LiftSomParams::default()
    }
}

struct Case {
    clip: Clip,
    robot: RobotMaps,
    folder: tempfile::TempDir,
}

impl Case {
    fn new() -> Self {
        let (clip, robot) = clip();
        let folder = tempfile::tempdir().unwrap();
        sidecars(folder.path());
        Self { clip, robot, folder }
    }

    fn inputs(&self) -> ClipInputs<'_> {
        ClipInputs {
            clip: &self.clip,
            robot: &self.robot,
            sidecars: self.folder.path(),
        }
    }

    fn run(&self, params: &LiftSomParams) -> StageResult<MotionBasisField> {
        reconstruct(self.inputs(), params, None, &mut Unobserved)
    }

    fn error(&self) -> StageError {
        self.run(&params(2)).unwrap_err()
    }

    fn file(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join("ext2").join(name)
    }
}

/// Centres of the foreground at a frame.
fn foreground(own: &BasisGaussians, frame: usize) -> Vec<f32> {
    let bases = MotionBases {
        frames: own.frames,
        rotations: own.rotations.clone(),
        translations: own.translations.clone(),
    };
    let count = own.foreground();
    let shares = shares(&own.coefficients, own.bases);
    let (means, quats) = (&own.means[..3 * count], &own.quats[..4 * count]);
    move_gaussians(&bases.at(frame).unwrap(), &shares, means, quats)
        .unwrap()
        .means
}

/// Peak signal to noise of a camera's image at a frame, dB.
fn psnr(case: &Case, field: &MotionBasisField, camera: usize, frame: usize) -> f64 {
    let own = &field.cameras[camera].1;
    let mut means = foreground(own, frame);
    means.extend(&own.means[means.len()..]);
    let logistic = |value: &f32| 1.0 / (1.0 + (-value).exp());
    let gaussians = Gaussians {
        means,
        quats: own.quats.clone(),
        scales: own.scales.iter().map(|value| value.exp()).collect(),
        opacities: own.opacities.iter().map(logistic).collect(),
        colour: Colour::Rgb(own.colours.iter().map(logistic).collect()),
        extra: Vec::new(),
        extra_channels: 0,
    };
    let (index, at) = (CameraIndex(camera as u32), FrameIndex(frame as u32));
    let posed = rogs_geometry::PosedCamera::of_clip(&case.clip, &case.robot, index, at).unwrap();
    let config = RasterConfig {
        near: 0.01,
        background: [1.0; 3],
        ..RasterConfig::default()
    };
    let image = render(&gaussians, &RasterCamera::new(&posed, LengthUnit::Metre), &config).unwrap();
    let target = case.clip.target(index, at).unwrap();
    let errors = image.rgb.iter().zip(target.rgb());
    let square: f64 = errors
        .map(|(a, &b)| (f64::from(*a) - f64::from(b) / 255.0).powi(2))
        .sum();
    -10.0 * (square / image.rgb.len() as f64).log10()
}

#[test]
fn the_plate_is_found_in_metres_and_moves() {
    let case = Case::new();
    let long = |updates: u32| LiftSomParams {
        track_updates: 300,
        ..params(updates)
    };
    let before = case.run(&long(0)).unwrap();
    let field = case.run(&long(160)).unwrap();
    field.check().unwrap();
    assert_eq!(field.cameras.len(), 2);
    let description = &field.weights.description;
    assert!(
        description.contains(&format!("ext1 {FACTOR:.6}, ext2 {FACTOR:.6}")),
        "{description}"
    );
    for (camera, own) in &field.cameras {
        assert_eq!(own.frames, FRAMES);
        let (first, last) = (foreground(own, 0), foreground(own, FRAMES - 1));
        let count = own.foreground();
        assert!(count > 50 && own.len() > 2 * count / 2 + 20, "{count} of {}", own.len());
        let mean = |values: &[f32], axis: usize| {
            values.iter().skip(axis).step_by(3).map(|&v| f64::from(v)).sum::<f64>() / count as f64
        };
        let moved = [0, 1, 2].map(|axis| mean(&last, axis) - mean(&first, axis));
        let expected = STEP_M * (FRAMES - 1) as f64;
        assert!(
            (moved[0] - expected).abs() < 0.03 && moved[1].abs() < 0.02 && moved[2].abs() < 0.03,
            "{moved:?}"
        );
        assert!((mean(&first, 2) - 1.0).abs() < 0.05, "{}", mean(&first, 2));
        for frame in [0, 3] {
            let [start, end] = [&before, &field].map(|field| psnr(&case, field, camera.at(), frame));
            println!("camera {camera}, frame {frame}: {start:.1} dB, then {end:.1} dB");
            assert!(
                end > start + 3.0 && end > 18.0,
                "camera {camera}, frame {frame}: {start} {end}"
            );
        }
    }
}

#[test]
fn a_field_does_not_depend_on_the_number_of_threads() {
    let case = Case::new();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| case.run(&params(24)).unwrap())
    };
    assert_eq!(with(1), with(4));
}

/// Keeps what it is told to keep, and is killed at some time.
#[derive(Default)]
struct Killed {
    kept: Vec<Progress>,
    shown: Vec<Figures>,
    after: usize,
}

impl Observer for Killed {
    fn keep(&mut self, progress: &Progress) -> StageResult<()> {
        self.kept.push(progress.clone());
        if self.kept.len() == self.after {
            return Err(StageError::io("killed"));
        }
        Ok(())
    }

    fn show(&mut self, figures: &Figures, picture_png: &[u8]) {
        assert!(picture_png.starts_with(b"\x89PNG"));
        self.shown.push(figures.clone());
    }
}

#[test]
fn a_killed_job_goes_on_to_the_same_bytes() {
    let case = Case::new();
    // Batches of one, so that there are more than 300 updates: then Gaussians are split.
    let params = LiftSomParams {
        batch: 1,
        epochs: 51,
        ..params(0)
    };
    let mut whole = Killed::default();
    let field = reconstruct(case.inputs(), &params, None, &mut whole).unwrap();
    // Of every camera: before the first image, and after 100, 200 and 300 updates, the last with split Gaussians.
    assert_eq!(whole.kept.len(), 8);
    let counter = |progress: &Progress, name: &str| progress.counter(name).unwrap();
    let told: Vec<[u64; 2]> = (whole.kept.iter())
        .map(|progress| [counter(progress, "cameras"), counter(progress, "updates")])
        .collect();
    assert_eq!(told[..5], [[0, 0], [0, 100], [0, 200], [0, 300], [1, 0]]);
    // Whoever watches sees each camera, and the images get better.
    let shown: Vec<(&str, u32, u32)> = (whole.shown.iter())
        .map(|own| (own.part.as_deref().unwrap(), own.update, own.updates))
        .collect();
    let of = |camera: &'static str| [100, 200, 300].map(|update| (camera, update, 306));
    assert_eq!(shown, [of("ext1"), of("ext2")].concat());
    let psnr = |number: usize| whole.shown[number].source_psnr_db.unwrap();
    assert!(psnr(2) > psnr(0) + 0.5 && psnr(0) > 10.0, "{} {}", psnr(0), psnr(2));
    for after in [1, 3, 7] {
        let mut killed = Killed {
            after,
            ..Killed::default()
        };
        reconstruct(case.inputs(), &params, None, &mut killed).unwrap_err();
        let kept = killed.kept.pop();
        let again = reconstruct(case.inputs(), &params, kept, &mut Unobserved).unwrap();
        assert_eq!(again, field, "killed after {after}");
    }
    // What does not fit together counts as nothing.
    let mut other = whole.kept[1].clone();
    other.arrays.truncate(3);
    let short = LiftSomParams {
        epochs: 1,
        ..params.clone()
    };
    let kept = reconstruct(case.inputs(), &short, Some(other), &mut Unobserved).unwrap();
    assert_eq!(kept, case.run(&short).unwrap());
}

#[test]
fn a_camera_that_does_not_see_the_robot_is_named() {
    let mut case = Case::new();
    for map in case.robot.maps.iter_mut().filter(|map| map.camera == CameraIndex(1)) {
        map.link.fill(NO_LINK);
    }
    let error = case.error();
    assert!(
        error.message.contains("the foreground mask of camera `ext2` is empty"),
        "{}",
        error.message
    );
    assert!(error.hint.unwrap().contains("the clip counts as failed"));
    for map in &mut case.robot.maps {
        map.link.fill(0);
    }
    let error = case.error();
    assert!(
        error.message.contains("no pixel of camera `ext1` is background"),
        "{}",
        error.message
    );
}

#[test]
fn without_stereo_depth_there_is_no_factor() {
    let mut case = Case::new();
    case.clip.cameras[1].depth = None;
    let error = case.error();
    assert!(
        error
            .message
            .contains("needs stereo depth of camera `ext2`: the clip has none"),
        "{}",
        error.message
    );
    assert!(error.hint.unwrap().contains("[references]"));
}

#[test]
fn sidecars_that_are_missing_or_of_other_images_are_named() {
    let shape = [FRAMES, HEIGHT, WIDTH];
    let ones = vec![1.0f32; FRAMES * HEIGHT * WIDTH];
    let write = |path: &Path, shape: &[usize], values: &[f32]| std::fs::write(path, npy_bytes(shape, values)).unwrap();
    let told = |change: &dyn Fn(&Case), expected: &[&str]| {
        let case = Case::new();
        change(&case);
        let error = case.error();
        for expected in ["clip `clip`", "ext2"].iter().chain(expected) {
            assert!(error.message.contains(expected), "{expected}: {}", error.message);
        }
        assert!(error.hint.unwrap().contains("docs/sidecars.md"));
    };
    for name in ["unidepth.npy", "depth-anything.npy", "tracks.npz"] {
        told(
            &|case| std::fs::remove_file(case.file(name)).unwrap(),
            &[name, "it is not there"],
        );
        told(&|case| std::fs::write(case.file(name), b"no array").unwrap(), &[name]);
    }
    told(
        &|case| write(&case.file("unidepth.npy"), &[FRAMES, WIDTH, HEIGHT], &ones),
        &["its shape is [6, 40, 26]: expected [6, 26, 40]"],
    );
    told(
        &|case| {
            write(
                &case.file("depth-anything.npy"),
                &[FRAMES - 1, HEIGHT, WIDTH],
                &ones[HEIGHT * WIDTH..],
            )
        },
        &["its shape is [5, 26, 40]"],
    );
    let mut wrong = ones.clone();
    wrong[HEIGHT * WIDTH + WIDTH + 3] = f32::NAN;
    told(
        &|case| write(&case.file("unidepth.npy"), &shape, &wrong),
        &["frame 1, row 1, column 3 is NaN: expected finite numbers"],
    );
    wrong[HEIGHT * WIDTH + WIDTH + 3] = 0.0;
    told(
        &|case| write(&case.file("unidepth.npy"), &shape, &wrong),
        &["is 0: expected depths above 0"],
    );
    wrong[HEIGHT * WIDTH + WIDTH + 3] = -1.0;
    told(
        &|case| write(&case.file("depth-anything.npy"), &shape, &wrong),
        &["is -1: expected disparities from 0 to 65535"],
    );
    let tracks = |case: &Case, track: [f32; 4], frames: usize, queries: usize| {
        let values: Vec<f32> = (0..frames).flat_map(|_| track).collect();
        let arrays: Vec<NamedArray> = (0..queries)
            .map(|query| NamedArray::new(&query.to_string(), &[1, frames, 4], &values))
            .collect();
        write_npz(&case.file("tracks.npz"), &arrays).unwrap();
    };
    told(
        &|case| tracks(case, [4.0, 8.0, 0.0, 0.0], FRAMES - 1, FRAMES),
        &["array `0`", "[1, 5, 4]"],
    );
    told(
        &|case| tracks(case, [4.0, 8.0, 0.0, 0.0], FRAMES, FRAMES - 1),
        &["it has no array `5`"],
    );
    told(
        &|case| tracks(case, [40.0, 8.0, 0.0, 0.0], FRAMES, FRAMES),
        &["point 0 begins at (40, 8)", "an image of 40x26"],
    );
    told(
        &|case| tracks(case, [4.5, 8.0, 0.0, 0.0], FRAMES, FRAMES),
        &["begins at (4.5, 8)"],
    );
    told(
        &|case| tracks(case, [4.0, 8.0, f32::INFINITY, 0.0], FRAMES, FRAMES),
        &["point 0, frame 0, column 2 is inf"],
    );
}
