//! The other recordings of the reference data: every Ctrl-World clip, a rollout read from one, and the AgiBot samples.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use common::Scratch;
use rogs_arrays::{NpyFile, npy_bytes};
use rogs_ingest::{Observations, Params, RolloutParams, list_episodes, read_clip, read_rollout};
use rogs_needs::{needs, shared};
use rogs_schemas::records::clip::CameraMount;
use rogs_schemas::{CameraIndex, FrameIndex};

fn params(episode: &str) -> Params {
    Params {
        episode: episode.into(),
        ..Params::default()
    }
}

/// Every clip of both copies is read, with the one calibration that there is standing in for their own: what it says of
/// other rigs is wrong, and no matter here.
#[needs(shared, ffmpeg, long = "18 clips of three videos")]
#[test]
fn every_ctrl_world_clip_is_read() {
    let calibration = shared!("data/droid_ctrlworld/new_setup/calibration_0007.json");
    let mut read = 0;
    for root in [shared!("data/droid_ctrlworld"), shared!("data/droid_ctrlworld_more")] {
        for listed in list_episodes(&root).unwrap() {
            let folder = root.join(&listed.folder);
            let (clip, _) = read_clip(&folder, Some(&calibration), &params(&listed.selector), "c").unwrap();
            assert_eq!((clip.cameras.len(), clip.frame_count()), (3, 17), "{}", listed.selector);
            let last = |camera: u32| clip.target(CameraIndex(camera), FrameIndex(16)).unwrap().rgb();
            assert!(
                (0..3).all(|camera| last(camera).iter().any(|&value| value > 60)),
                "{}",
                listed.selector
            );
            read += 1;
        }
    }
    assert_eq!(read, 18);
}

/// The videos of the calibrated episode given as a rollout of it: the folder of three videos by Ctrl-World's numbers.
#[needs(shared, ffmpeg)]
#[test]
fn recorded_videos_in_the_place_of_a_rollout_are_found_to_begin_elsewhere() {
    let root = shared!("data/droid_ctrlworld/new_setup");
    let rollout = root.join("videos/0007");
    let at = |first_frame: u32| Params {
        observations: Observations::Rollout,
        rollout: RolloutParams {
            frames: Some(85),
            first_frame,
            ..RolloutParams::default()
        },
        ..params("0007")
    };
    let (clip, _) = read_rollout(&root, None, &rollout, &at(7), "c").unwrap();
    let own = clip.rollout.as_ref().unwrap();
    assert_eq!(own.layout, "views");
    assert!(
        own.first_frame_psnr_db
            .iter()
            .all(|figure| *figure == Some(f64::INFINITY)),
        "{own:?}"
    );
    for camera in &clip.cameras {
        assert!(camera.generated == camera.recorded, "{}", camera.id);
    }
    // A frame late, as far as the scene has moved by then.
    let near = read_rollout(&root, None, &rollout, &at(8), "c");
    println!(
        "one frame late: {:?}",
        near.as_ref().map(|_| ()).map_err(|error| &error.message)
    );
    // What the check can tell: the same scene at other moments, and other views.
    let figures = |first: u32| {
        let mut params = at(first);
        params.rollout.min_first_frame_psnr_db = -100.0;
        let (clip, _) = read_rollout(&root, None, &rollout, &params, "c").unwrap();
        clip.rollout.unwrap().first_frame_psnr_db
    };
    for first in [8, 20, 60] {
        println!(
            "first generated frame {first} against recorded 7: {:.1?} dB",
            figures(first)
        );
    }
    let elsewhere = read_rollout(&root, None, &rollout, &at(60), "c").unwrap_err();
    assert!(
        elsewhere
            .message
            .contains("is not the first recorded one of camera `wrist`"),
        "{elsewhere}"
    );
    let other = root.join("videos/0006");
    let mut params = at(7);
    params.rollout.frames = None;
    let length = read_rollout(&root, None, &other, &params, "c").unwrap_err();
    assert!(length.message.contains("the 17 frames of the clip need 24"), "{length}");
}

/// The AgiBot samples: three moving or fixed cameras with a pose for every frame, and both hands as joints.
#[needs(shared)]
#[test]
fn the_agibot_samples_become_clips_with_moving_cameras() {
    let root = shared!("data/agibot_gesim");
    let listed = list_episodes(&root).unwrap();
    let names: Vec<(&str, &str, Option<u64>)> = listed
        .iter()
        .map(|listed| (listed.name.as_str(), listed.layout.as_str(), listed.frames))
        .collect();
    assert_eq!(
        names,
        [("sample_0", "agibot", Some(4)), ("sample_1", "agibot", Some(4))]
    );
    const FRAMES: usize = 4;
    for listed in listed {
        let root = root.join(&listed.folder);
        let (clip, warnings) = read_clip(&root, None, &agibot_params(), "c").unwrap();
        assert!(
            warnings
                .iter()
                .any(|warning| warning.contains("300 steps for 4 images")),
            "{warnings:?}"
        );
        assert_eq!(
            (clip.cameras.len(), clip.frame_count(), clip.height, clip.width),
            (3, FRAMES, 154, 280)
        );
        for (camera, name) in clip.cameras.iter().zip(["hand_left", "hand_right", "head"]) {
            assert_eq!(camera.id, name);
            let CameraMount::Trajectory { base_from_camera } = &camera.mount else {
                panic!("a trajectory")
            };
            let mut stored = NpyFile::open(&root.join(format!("extrinsic_{name}.npy"))).unwrap();
            for (step, pose) in base_from_camera.iter().enumerate() {
                let matrix = stored.entry(step).unwrap();
                for (axis, value) in pose.translation.iter().enumerate() {
                    assert!((value - matrix[4 * axis + 3]).abs() < 1e-9, "{name}");
                }
            }
            // The images were squeezed: fx and fy differ by the aspect, which a cut keeps.
            assert!(
                camera.intrinsics.fx < 0.85 * camera.intrinsics.fy,
                "{name}: {:?}",
                camera.intrinsics
            );
        }
        let mut actions = NpyFile::open(&root.join("actions.npy")).unwrap();
        for frame in 0..FRAMES {
            let row = actions.entry(frame).unwrap();
            let joints = &clip.robot.positions[14 * frame..14 * (frame + 1)];
            assert_eq!((&joints[..3], &joints[7..10]), (&row[..3], &row[8..11]));
            // The quaternion again, out of yaw, pitch and roll.
            let turned = |angles: &[f64]| glam::DQuat::from_euler(glam::EulerRot::ZYX, angles[0], angles[1], angles[2]);
            let recorded = |at: usize| glam::DQuat::from_xyzw(row[at], row[at + 1], row[at + 2], row[at + 3]);
            assert!(turned(&joints[3..6]).dot(recorded(3)).abs() > 1.0 - 1e-6);
            assert!(turned(&joints[10..13]).dot(recorded(11)).abs() > 1.0 - 1e-6);
            assert!((joints[6] - (row[7] - 35.0) / 85.0).abs() < 1e-9);
        }
        assert!(is_lit(
            &clip.target(CameraIndex(0), FrameIndex(3)).unwrap().rgb()[..3000]
        ));
    }
}

fn agibot_params() -> Params {
    Params {
        frames: 4,
        source_frames: vec![FrameIndex(0), FrameIndex(3)],
        ..Params::default()
    }
}

fn is_lit(rgb: &[u8]) -> bool {
    rgb.iter().any(|&value| value > 20)
}

/// What is missing or wrong in a sample is told with the way to get it.
#[needs(shared)]
#[test]
fn agibot_samples_without_calibration_or_with_a_wrong_one_are_refused() {
    let root = shared!("data/agibot_gesim").join("sample_1");
    let sample = |name: &str| {
        let scratch = Scratch::new(name);
        for entry in std::fs::read_dir(&root).unwrap() {
            let entry = entry.unwrap();
            let target = scratch.0.join(entry.file_name());
            if entry.path().is_dir() {
                std::fs::create_dir_all(&target).unwrap();
                for image in std::fs::read_dir(entry.path()).unwrap() {
                    let image = image.unwrap();
                    std::fs::write(target.join(image.file_name()), std::fs::read(image.path()).unwrap()).unwrap();
                }
            } else {
                std::fs::write(target, std::fs::read(entry.path()).unwrap()).unwrap();
            }
        }
        scratch
    };
    let refused = |scratch: &Scratch| {
        let error = read_clip(&scratch.0, None, &agibot_params(), "c").unwrap_err();
        format!("{} / {}", error.message, error.hint.unwrap_or_default())
    };
    let numbers = |name: &str| NpyFile::open(&root.join(name)).unwrap().all().unwrap();

    let lens = sample("agibot-lens");
    std::fs::remove_file(lens.0.join("intrinsic_head.npy")).unwrap();
    let text = refused(&lens);
    assert!(
        text.contains("the calibration (intrinsics) of camera `head` is missing")
            && text.contains("docs/calibration-format.md"),
        "{text}"
    );
    let poses = sample("agibot-poses");
    std::fs::remove_file(poses.0.join("extrinsic_hand_left.npy")).unwrap();
    assert!(refused(&poses).contains("(camera-to-base poses) of camera `hand_left` is missing"));

    // Poses that map base to camera.
    let inverted = sample("agibot-inverted");
    let matrices = numbers("extrinsic_hand_right.npy");
    let inverse: Vec<f64> = matrices
        .chunks_exact(16)
        .flat_map(|matrix| {
            let rows: [f64; 16] = matrix.try_into().unwrap();
            glam::DMat4::from_cols_array(&rows)
                .transpose()
                .inverse()
                .transpose()
                .to_cols_array()
        })
        .collect();
    std::fs::write(
        inverted.0.join("extrinsic_hand_right.npy"),
        npy_bytes(&[300, 4, 4], &inverse),
    )
    .unwrap();
    assert!(
        refused(&inverted).contains("the poses map base to camera"),
        "{}",
        refused(&inverted)
    );

    // Millimetres, a lens of other images, a missing image, fewer steps than images.
    let millimetres: Vec<f64> = matrices
        .iter()
        .enumerate()
        .map(|(at, value)| {
            if at % 4 == 3 && at % 16 < 12 {
                1000.0 * value
            } else {
                *value
            }
        })
        .collect();
    let far = sample("agibot-millimetres");
    std::fs::write(
        far.0.join("extrinsic_hand_right.npy"),
        npy_bytes(&[300, 4, 4], &millimetres),
    )
    .unwrap();
    assert!(refused(&far).contains(" m"), "{}", refused(&far));
    let gap = sample("agibot-gap");
    std::fs::remove_file(gap.0.join("head_color/1.png")).unwrap();
    assert!(refused(&gap).contains("are not numbered from `0.png` on without a gap"));
    let short = sample("agibot-short");
    let actions = numbers("actions.npy");
    std::fs::write(short.0.join("actions.npy"), npy_bytes(&[3, 16], &actions[..48])).unwrap();
    assert!(
        refused(&short).contains("it has 3 steps for 4 images"),
        "{}",
        refused(&short)
    );

    // AgiBot World as released is another form.
    let world = Scratch::new("agibot-world");
    for folder in ["observations", "parameters", "proprio_stats"] {
        std::fs::create_dir_all(world.0.join(folder)).unwrap();
    }
    let error = list_episodes(&world.0).unwrap_err();
    assert!(error.message.contains("AgiBot World as released"), "{error}");
}
