//! The other recordings of the reference data: every Ctrl-World clip, a rollout read from one, and the AgiBot samples.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::path::Path;

use common::Scratch;
use rogs_arrays::{NpyFile, npy_bytes};
use rogs_ingest::{Observations, Params, RolloutParams, list_episodes, read_clip, read_rollout};
use rogs_needs::{needs, shared};
use rogs_schemas::records::clip::CameraMount;
use rogs_schemas::{CameraIndex, FrameIndex};
use serde_json::json;

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

/// The AgiBot samples as an own episode: three moving or fixed cameras with a pose for every frame. They come without
/// joints; the places of both hands stand in for them.
#[needs(shared)]
#[test]
fn the_agibot_samples_become_clips_with_moving_cameras() {
    for sample in 0..2 {
        let root = shared!("data/agibot_gesim").join(format!("sample_{sample}"));
        let scratch = Scratch::new(&format!("agibot-{sample}"));
        const FRAMES: usize = 4;
        let rows = |name: &str, width: usize| -> Vec<f64> {
            let mut array = NpyFile::open(&root.join(name)).unwrap();
            let values = array.all().unwrap();
            values[..FRAMES * width].to_vec()
        };
        let camera = |id: &str, name: &str| {
            let folder = scratch.0.join(id);
            std::fs::create_dir_all(&folder).unwrap();
            for frame in 0..FRAMES {
                let bytes = std::fs::read(root.join(format!("{name}_color/{frame}.png"))).unwrap();
                std::fs::write(folder.join(format!("{frame:06}.png")), bytes).unwrap();
            }
            let poses = rows(&format!("extrinsic_{name}.npy"), 16);
            std::fs::write(scratch.0.join(format!("{id}.npy")), npy_bytes(&[FRAMES, 4, 4], &poses)).unwrap();
            let k = NpyFile::open(&root.join(format!("intrinsic_{name}.npy")))
                .unwrap()
                .all()
                .unwrap();
            json!({
                "id": id, "role": "source", "images": id, "width": 640, "height": 480,
                "intrinsics": {"fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5]}, "pixel_centres": "integer",
                "mount": {"trajectory": {"base_from_camera": format!("{id}.npy")}},
            })
        };
        let cameras =
            [("wrist", "hand_left"), ("wrist2", "hand_right"), ("head", "head")].map(|(id, name)| camera(id, name));
        let actions = rows("actions.npy", 16);
        let mut csv = "left_x,right_x,gripper\n".to_owned();
        for row in actions.chunks_exact(16) {
            // The gripper is in units of the device, some 35 to 120.
            csv += &format!("{},{},{}\n", row[0], row[8], (row[7] / 120.0).clamp(0.0, 1.0));
        }
        std::fs::write(scratch.0.join("states.csv"), csv).unwrap();
        let episode = json!({
            "format": "rogs-episode 1", "episode_id": format!("agibot-{sample}"), "fps": 30.0, "frame_count": FRAMES,
            "robot": {"joint_names": ["left_x", "right_x"], "states": "states.csv"}, "cameras": cameras,
        });
        std::fs::write(scratch.0.join("episode.json"), episode.to_string()).unwrap();
        let params = Params {
            frames: FRAMES as u32,
            source_frames: vec![FrameIndex(0), FrameIndex(3)],
            ..Params::default()
        };
        let (clip, _) = read_clip(&scratch.0, None, &params, "c").unwrap();
        assert_eq!(
            (clip.cameras.len(), clip.frame_count(), clip.height, clip.width),
            (3, FRAMES, 154, 280)
        );
        for (camera, name) in clip.cameras.iter().zip(["hand_left", "hand_right", "head"]) {
            let CameraMount::Trajectory { base_from_camera } = &camera.mount else {
                panic!("a trajectory")
            };
            let stored = rows(&format!("extrinsic_{name}.npy"), 16);
            for (pose, matrix) in base_from_camera.iter().zip(stored.chunks_exact(16)) {
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
        assert!(is_lit(
            &clip.target(CameraIndex(0), FrameIndex(3)).unwrap().rgb()[..3000]
        ));
    }
}

fn is_lit(rgb: &[u8]) -> bool {
    rgb.iter().any(|&value| value > 20)
}

#[needs(shared)]
#[test]
fn a_sample_of_agibot_alone_is_no_episode() {
    let error = list_episodes(Path::new(&shared!("data/agibot_gesim/sample_0"))).unwrap_err();
    assert!(error.message.contains("holds no episode of a known layout"), "{error}");
}
