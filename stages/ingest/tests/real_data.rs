//! Real recordings of the reference data: DROID in the Ctrl-World form and LeRobot, and damaged copies.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::path::{Path, PathBuf};

use common::Scratch;
use rogs_ingest::{CameraChoice, Params, StateColumns, list_episodes, read_clip};
use rogs_needs::{needs, shared};
use rogs_schemas::records::clip::{CameraMount, Clip};
use rogs_schemas::{EpisodeFrame, FrameIndex};

fn params(episode: &str) -> Params {
    Params {
        episode: episode.into(),
        ..Params::default()
    }
}

/// Mean colour of one image of a camera.
fn mean(clip: &Clip, camera: usize, frame: usize) -> [f64; 3] {
    let area = (clip.height * clip.width) as usize;
    let image = &clip.cameras[camera].recorded.as_ref().unwrap()[frame * area * 3..(frame + 1) * area * 3];
    [0, 1, 2].map(|channel| {
        image
            .iter()
            .skip(channel)
            .step_by(3)
            .map(|&value| f64::from(value))
            .sum::<f64>()
            / area as f64
    })
}

#[needs(shared, ffmpeg)]
#[test]
fn the_calibrated_droid_episode_becomes_a_clip() {
    let root = shared!("data/droid_ctrlworld/new_setup");
    let (clip, warnings) = read_clip(&root, None, &params("0007"), "droid-0007").unwrap();
    assert_eq!(warnings, Vec::<String>::new());
    assert_eq!(
        (clip.episode_id.as_str(), clip.fps, clip.layout.as_str()),
        ("0007", 4.0, "droid-ctrlworld")
    );
    assert_eq!(clip.episode_frames, (7..24).map(EpisodeFrame).collect::<Vec<_>>());
    assert_eq!((clip.cameras.len(), clip.robot.joint_names.len()), (3, 7));
    let [wrist, ext1, _] = &clip.cameras[..] else {
        panic!("three cameras")
    };
    assert!(matches!(&wrist.mount, CameraMount::HandEye { link, .. } if link == "panda_link8"));
    let CameraMount::Fixed { base_from_camera } = &ext1.mount else {
        panic!("a fixed camera")
    };
    assert_eq!(base_from_camera.translation, [0.226436, 0.432648, 0.382584]);
    // 320x192 scaled by 0.875 and cut by 7 rows above; integer pixel centres in the file.
    let expected = [
        133.0 * 0.875,
        141.866_666_666_666_67 * 0.875,
        160.5 * 0.875,
        96.5 * 0.875 - 7.0,
    ];
    let intrinsics = ext1.intrinsics;
    for (found, expected) in [intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy]
        .into_iter()
        .zip(expected)
    {
        assert!((found - expected).abs() < 1e-12, "{found} instead of {expected}");
    }
    // The green towel fills the wrist image at the end: green above red above blue.
    let [red, green, blue] = mean(&clip, 0, 16);
    assert!(
        green > red + 5.0 && red > blue + 15.0,
        "mean colour {red:.0} {green:.0} {blue:.0}"
    );
}

#[needs(shared, ffmpeg)]
#[test]
fn frames_are_those_of_their_number() {
    let root = shared!("data/droid_ctrlworld/new_setup");
    let late = Params {
        start_frame: Some(EpisodeFrame(12)),
        frames: 3,
        source_frames: [0].map(FrameIndex).to_vec(),
        ..params("0007")
    };
    let (late, _) = read_clip(&root, None, &late, "c").unwrap();
    let (all, _) = read_clip(&root, None, &params("0007"), "c").unwrap();
    let step = Params {
        start_frame: Some(EpisodeFrame(7)),
        frames: 3,
        frame_step: 5,
        source_frames: [0].map(FrameIndex).to_vec(),
        ..params("0007")
    };
    let (step, _) = read_clip(&root, None, &step, "c").unwrap();
    let image = |clip: &Clip, camera: usize, frame: usize| {
        let size = (clip.height * clip.width * 3) as usize;
        clip.cameras[camera].recorded.as_ref().unwrap()[frame * size..(frame + 1) * size].to_vec()
    };
    for camera in 0..3 {
        assert_eq!(image(&late, camera, 0), image(&all, camera, 5));
        assert_eq!(image(&step, camera, 1), image(&all, camera, 5));
        assert_ne!(image(&all, camera, 4), image(&all, camera, 5), "neighbours differ");
    }
}

#[needs(shared)]
#[test]
fn data_sets_are_listed() {
    let root = shared!("data/droid_ctrlworld");
    let listed = list_episodes(&root).unwrap();
    let selectors: Vec<String> = listed
        .iter()
        .map(|episode| format!("{}/{}", episode.folder, episode.selector))
        .collect();
    assert_eq!(
        selectors,
        [
            "./train/6",
            "./val/1799",
            "./val/18599",
            "./val/199",
            "new_setup/0006",
            "new_setup/0007"
        ]
    );
    assert!(listed[5].files.contains(&"calibration_0007.json".to_owned()));
    let root = shared!("data/lerobot_v30_droid");
    let listed = list_episodes(&root).unwrap();
    assert_eq!(
        (listed.len(), listed[1].selector.as_str(), listed[1].layout.as_str()),
        (2, "episode_000001", "lerobot-v3.0")
    );
    assert!(
        listed[1]
            .files
            .contains(&"videos/observation.images.wrist_left/chunk-000/file-000.mp4".to_owned())
    );
}

#[needs(shared, ffmpeg)]
#[test]
fn an_episode_without_calibration_says_how_to_give_one() {
    let droid = shared!("data/droid_ctrlworld");
    let lerobot = shared!("data/lerobot_v30_droid");
    for (root, episode) in [(&droid, "199"), (&lerobot, "0")] {
        let error = read_clip(root, None, &params(episode), "c").unwrap_err();
        assert!(
            error.hint.clone().unwrap().contains("calibration"),
            "{error} {:?}",
            error.hint
        );
    }
    let error = read_clip(&droid, None, &params("nobody"), "c").unwrap_err();
    assert!(error.message.contains("no episode `nobody`"), "{error}");
    assert!(
        read_clip(&droid, None, &params(""), "c")
            .unwrap_err()
            .message
            .contains("say which")
    );
}

#[needs(shared, ffmpeg)]
#[test]
fn a_shared_video_of_lerobot_v30_begins_where_the_episode_does() {
    let lerobot = shared!("data/lerobot_v30_droid");
    let droid = shared!("data/droid_ctrlworld");
    let calibration = droid.join("new_setup/calibration_0007.json");
    let (two, _) = read_clip(&lerobot, Some(&calibration), &params("episode_000001"), "c").unwrap();
    assert_eq!(
        (two.layout.as_str(), two.fps, two.robot.joint_names[6].as_str()),
        ("lerobot-v3.0", 5.0, "panda_joint7")
    );
    assert_eq!(
        two.cameras.iter().map(|camera| camera.id.as_str()).collect::<Vec<_>>(),
        ["wrist", "ext1", "ext2"]
    );
    // Both layouts hold the same recording: DROID 1799 is the second episode. Images were encoded again.
    let (same, _) = read_clip(&droid, Some(&calibration), &params("1799"), "c").unwrap();
    for (a, b) in two.robot.positions.iter().zip(&same.robot.positions) {
        assert!((a - b).abs() < 1e-6);
    }
    for camera in 0..3 {
        for frame in [0, 16] {
            let (a, b) = (mean(&two, camera, frame), mean(&same, camera, frame));
            assert!(
                a.iter().zip(b).all(|(a, b)| (a - b).abs() < 3.0),
                "camera {camera} frame {frame}: {a:?} {b:?}"
            );
        }
    }
    // A wrong offset would show another episode: the first one looks different.
    let (one, _) = read_clip(&lerobot, Some(&calibration), &params("episode_000000"), "c").unwrap();
    let (a, b) = (mean(&one, 0, 0), mean(&two, 0, 0));
    assert!(a.iter().zip(b).any(|(a, b)| (a - b).abs() > 10.0));
}

#[needs(shared, ffmpeg)]
#[test]
fn lerobot_v21_with_av1_goes_as_far_as_its_data() {
    let root = shared!("data/lerobot_v21_sample");
    let missing = read_clip(&root, None, &params("11"), "c").unwrap_err();
    assert!(
        missing.message.contains("episode_000011.parquet") && missing.message.contains("missing"),
        "{missing}"
    );
    let no_gripper = read_clip(&root, None, &params("10"), "c").unwrap_err();
    assert!(no_gripper.message.contains("names no gripper"), "{no_gripper}");
    assert!(no_gripper.hint.unwrap().contains("[ingest.states]"));
    let scratch = Scratch::new("v21");
    let calibration = scratch.0.join("calibration.json");
    let text = r#"{"image_size": [640, 480], "cameras": {"wrist": {"intrinsic": [[600, 0, 320], [0, 600, 240], [0, 0, 1]],
        "camera_to_base": [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}}"#;
    std::fs::write(&calibration, text).unwrap();
    let joints = [
        "kRightShoulderPitch",
        "kRightShoulderRoll",
        "kRightShoulderYaw",
        "kRightElbow",
    ]
    .map(String::from)
    .to_vec();
    let states = StateColumns {
        joints: joints.clone(),
        gripper: Some("kRightHandIndex".into()),
        ..StateColumns::default()
    };
    let cameras = vec![CameraChoice {
        id: "wrist".into(),
        from: "cam_high".into(),
        held_out: false,
    }];
    let (clip, _) = read_clip(
        &root,
        Some(&calibration),
        &Params {
            states,
            cameras,
            ..params("10")
        },
        "c",
    )
    .unwrap();
    assert_eq!(
        (clip.robot.joint_names.clone(), clip.fps, clip.episode_frames[0]),
        (joints, 30.0, EpisodeFrame(7))
    );
    let [red, green, blue] = mean(&clip, 0, 0);
    assert!(
        [red, green, blue].iter().all(|value| (10.0..245.0).contains(value)),
        "{red:.0} {green:.0} {blue:.0}"
    );
}

/// A copy of the calibrated episode that may be damaged.
fn copy(name: &str) -> Scratch {
    let root = shared!("data/droid_ctrlworld/new_setup");
    let scratch = Scratch::new(name);
    let file = |path: &str| {
        let target = scratch.0.join(path);
        std::fs::create_dir_all(target.parent().unwrap()).unwrap();
        // Not `copy`: the originals may be read-only.
        std::fs::write(&target, std::fs::read(root.join(path)).unwrap()).unwrap();
    };
    for path in [
        "annotation/0007.json",
        "calibration_0007.json",
        "videos/0007/0.mp4",
        "videos/0007/1.mp4",
        "videos/0007/2.mp4",
    ] {
        file(path);
    }
    scratch
}

fn said(folder: &Path) -> String {
    read_clip(folder, None, &params("0007"), "c").unwrap_err().message
}

fn edit(path: PathBuf, change: impl FnOnce(&mut serde_json::Value)) {
    let mut value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    change(&mut value);
    std::fs::write(path, value.to_string()).unwrap();
}

#[needs(shared, ffmpeg)]
#[test]
fn cameras_that_nobody_chose_need_no_calibration() {
    let folder = copy("part-calibrated");
    edit(folder.0.join("calibration_0007.json"), |value| {
        value["cameras"].as_object_mut().unwrap().remove("exterior_1").unwrap();
    });
    let error = read_clip(&folder.0, None, &params("0007"), "c").unwrap_err();
    assert!(
        error.message.contains("the calibration has no camera `ext1`"),
        "{error}"
    );
    assert!(error.hint.unwrap().contains("`cameras` under [ingest]"));
    let chosen = |from: &[&str]| Params {
        cameras: (from.iter())
            .map(|&name| CameraChoice {
                id: name.into(),
                from: name.into(),
                held_out: false,
            })
            .collect(),
        ..params("0007")
    };
    let (clip, _) = read_clip(&folder.0, None, &chosen(&["wrist", "ext2"]), "c").unwrap();
    let ids: Vec<&str> = clip.cameras.iter().map(|camera| camera.id.as_str()).collect();
    assert_eq!(ids, ["wrist", "ext2"]);
    let error = read_clip(&folder.0, None, &chosen(&["ext1"]), "c").unwrap_err();
    assert!(
        error.message.contains("the calibration has no camera `ext1`"),
        "{error}"
    );
}

#[needs(shared, ffmpeg)]
#[test]
fn damaged_videos_are_noticed() {
    let copy = copy("video");
    let path = copy.0.join("videos/0007/1.mp4");
    let whole = std::fs::read(&path).unwrap();
    // Cut at every tenth: the header or the frames are missing.
    for tenth in 0..10 {
        std::fs::write(&path, &whole[..whole.len() * tenth / 10]).unwrap();
        assert!(said(&copy.0).contains("1.mp4"), "cut to {tenth} tenths");
    }
    std::fs::write(&path, b"not a video").unwrap();
    assert!(said(&copy.0).contains("ffprobe cannot read the video"));
    std::fs::remove_file(&path).unwrap();
    assert!(said(&copy.0).contains("video 1 is missing"));
    // A playlist that names other files is not a video.
    std::fs::write(&path, "#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n").unwrap();
    assert!(said(&copy.0).contains("ffprobe cannot read the video"));
    std::fs::write(&path, &whole).unwrap();
    edit(copy.0.join("annotation/0007.json"), |value| {
        value["video_length"] = 80.into()
    });
    assert!(said(&copy.0).contains("85 rows of `joints` for 80 video frames"));
    edit(copy.0.join("annotation/0007.json"), |value| {
        value["joints"].as_array_mut().unwrap().truncate(80);
    });
    assert!(said(&copy.0).contains("it has 85 frames, the annotation 80"));
    // One frame more than states is known of this rig and only noted.
    edit(copy.0.join("annotation/0007.json"), |value| {
        value["video_length"] = 84.into();
        let row = value["joints"][0].clone();
        value["joints"].as_array_mut().unwrap().resize(84, row);
    });
    let (_, warnings) = read_clip(&copy.0, None, &params("0007"), "c").unwrap();
    assert_eq!(
        warnings
            .iter()
            .filter(|warning| warning.contains("one frame more"))
            .count(),
        3
    );
}

#[needs(shared, ffmpeg)]
#[test]
fn damaged_annotations_and_calibrations_are_noticed() {
    let copy = copy("annotation");
    let annotation = copy.0.join("annotation/0007.json");
    let whole = std::fs::read(&annotation).unwrap();
    let change = |pointer: &str, value: serde_json::Value| {
        std::fs::write(&annotation, &whole).unwrap();
        edit(annotation.clone(), |json| *json.pointer_mut(pointer).unwrap() = value);
        said(&copy.0)
    };
    assert!(change("/joints/12/7", 1.5.into()).contains("gripper is 1.5 at row 12"));
    assert!(change("/joints/12/3", (-130.0).into()).contains("joint `panda_joint4` is -130 at row 12"));
    assert!(change("/joints/12", serde_json::json!([0, 0])).contains("row 12 has 1 joints"));
    assert!(change("/videos/0/video_path", "../../secret.mp4".into()).contains("does not stay inside"));
    let text = String::from_utf8(whole.clone()).unwrap();
    std::fs::write(&annotation, text.replacen("\"joints\": [", "\"joints\": [NaN, ", 1)).unwrap();
    let error = read_clip(&copy.0, None, &params("0007"), "c").unwrap_err();
    assert!(error.message.contains("not a Ctrl-World annotation"), "{error}");
    std::fs::write(&annotation, &whole).unwrap();
    let calibration = copy.0.join("calibration_0007.json");
    let good = std::fs::read(&calibration).unwrap();
    let change = |pointer: &str, value: serde_json::Value| {
        std::fs::write(&calibration, &good).unwrap();
        edit(calibration.clone(), |json| *json.pointer_mut(pointer).unwrap() = value);
        said(&copy.0)
    };
    assert!(change("/cameras/exterior_1/intrinsic/0/0", 0.into()).contains("focal lengths"));
    assert!(change("/cameras/exterior_2/camera_to_base/0/0", 0.5.into()).contains("not rigid"));
    assert!(change("/cameras/exterior_2/camera_to_base/0/3", 450.0.into()).contains("450.0 m"));
    assert!(change("/cameras/wrist/intrinsic/0/1", 3.into()).contains("more than fx, fy, cx, cy"));
    assert!(change("/cameras/wrist", serde_json::Value::Null).contains("not a calibration file"));
}
