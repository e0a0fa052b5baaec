//! The own episode folder: what arrives in the clip, and what is refused with which words.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::path::Path;

use common::{HEIGHT, Scratch, WIDTH, description, write_description, write_episode};
use rogs_ingest::{CameraChoice, Params, QueryChoice, QueryPlanName, list_episodes, read_clip};
use rogs_needs::needs;
use rogs_schemas::episode::{Episode, EpisodeMount};
use rogs_schemas::protocol::FailureCode;
use rogs_schemas::records::clip::{CameraMount, CameraRole, SourceView};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex, WrittenPose};

/// The clip at the recorded size.
fn params() -> Params {
    Params {
        height: HEIGHT,
        width: WIDTH,
        ..Params::default()
    }
}

#[test]
fn everything_arrives() {
    let scratch = Scratch::new("arrives");
    write_episode(&scratch.0);
    let (clip, warnings) = read_clip(&scratch.0, None, &params(), "clip").unwrap();
    assert_eq!(warnings, Vec::<String>::new());
    // The interval begins at the anchor of the tracks.
    assert_eq!(clip.episode_frames, (2..19).map(EpisodeFrame).collect::<Vec<_>>());
    assert_eq!(
        (clip.anchor_frame, clip.fps, clip.layout.as_str()),
        (FrameIndex(0), 15.0, "rogs-episode")
    );
    assert_eq!(clip.episode_id, "LAB+a+2026-01-31-12h:00m");
    let plan = rogs_random::query_plan(&clip.episode_id, 17, &[0, 4, 8, 12, 16]);
    assert_eq!(
        clip.query_frames,
        plan.distinct.into_iter().map(FrameIndex).collect::<Vec<_>>()
    );
    // States by column name, not by place.
    assert_eq!(clip.robot.joint_names, ["j1", "j2"]);
    assert_eq!(clip.robot.positions[..4], [0.02, -0.04, 0.03, -0.06]);
    assert_eq!(clip.robot.gripper[16], 18.0 / 19.0);
    assert_eq!(
        clip.cameras.iter().map(|camera| camera.id.as_str()).collect::<Vec<_>>(),
        ["wrist", "ext1", "ext1_right"]
    );
    for (number, camera) in clip.cameras.iter().enumerate() {
        let rgb = camera.recorded.as_ref().unwrap();
        for (frame, x, y) in [(0u32, 0u32, 0u32), (5, 39, 21), (16, 7, 3)] {
            let at = ((frame * HEIGHT + y) * WIDTH + x) as usize * 3;
            assert_eq!(rgb[at..at + 3], common::colour(number as u8, frame + 2, x, y));
        }
    }
    let [wrist, ext1, right] = &clip.cameras[..] else {
        panic!("three cameras")
    };
    assert!(matches!(&wrist.mount, CameraMount::HandEye { link, .. } if link == "panda_link8"));
    assert_eq!(
        ext1.mount,
        CameraMount::Fixed {
            base_from_camera: common::pose(1.0)
        }
    );
    let CameraMount::Trajectory { base_from_camera } = &right.mount else {
        panic!("a trajectory")
    };
    assert_eq!((base_from_camera.len(), base_from_camera[0].translation[0]), (17, 0.2));
    assert_eq!(
        (right.role, right.partner, ext1.partner),
        (CameraRole::Evaluation, Some(CameraIndex(1)), None)
    );
    assert_eq!(
        (ext1.intrinsics.cx, right.intrinsics.cx, right.intrinsics.cy),
        (20.0, 20.5, 11.5)
    );
    let depth = ext1.depth.as_ref().unwrap();
    assert_eq!(
        (depth.range_m, depth.depth_m.len(), depth.origin),
        ([0.2, 4.0], 17 * (HEIGHT * WIDTH) as usize, ReferenceOrigin::DepthCamera)
    );
    assert!(depth.depth_m[0].is_nan(), "0 means unknown");
    assert_eq!(
        depth.depth_m[(3 * HEIGHT * WIDTH + 2 * WIDTH + 1) as usize],
        common::depth(5, 1, 2)
    );
    assert_eq!(right.depth.as_ref().unwrap().depth_m[7], 0.7, "millimetres");
    let tracks = clip.tracks.as_ref().unwrap();
    assert_eq!(
        (&tracks.camera[..], &tracks.pixel[..]),
        (&[0, 1, 1].map(CameraIndex)[..], &[10.0, 3.0, 39.0, 21.0, 0.0, 0.0][..])
    );
    assert_eq!(tracks.position_m[..3], [6.0 * 0.001, 7.0 * 0.001, 8.0 * 0.001]);
    assert_eq!(
        (tracks.visible.len(), tracks.origin),
        (3 * 17, ReferenceOrigin::PointTracker)
    );
}

#[test]
fn resizing_and_cutting_move_intrinsics_depth_and_tracks_together() {
    let scratch = Scratch::new("cut");
    write_episode(&scratch.0);
    // 40x22 to 20x10: scaled to 20x11, the half row below is cut.
    let (clip, warnings) = read_clip(
        &scratch.0,
        None,
        &Params {
            height: 10,
            width: 20,
            ..Params::default()
        },
        "c",
    )
    .unwrap();
    let ext1 = &clip.cameras[1];
    assert_eq!((ext1.intrinsics.fx, ext1.intrinsics.fy), (10.0, 10.5));
    assert_eq!((ext1.intrinsics.cx, ext1.intrinsics.cy), (10.0, 5.5));
    let tracks = clip.tracks.unwrap();
    assert_eq!(
        tracks.pixel,
        [4.75, 1.25, -0.25, -0.25],
        "the pixel of the last row is gone"
    );
    assert!(
        warnings.iter().any(|warning| warning.contains("1 of 3 tracks")),
        "{warnings:?}"
    );
    assert_eq!(ext1.depth.as_ref().unwrap().depth_m.len(), 17 * 200);
}

#[test]
fn parameters_choose_frames_queries_and_cameras() {
    let scratch = Scratch::new("choose");
    write_episode(&scratch.0);
    let choice = |id: &str, from: &str| CameraChoice {
        id: id.into(),
        from: from.into(),
        held_out: false,
    };
    let chosen = Params {
        start_frame: Some(EpisodeFrame(1)),
        frames: 5,
        frame_step: 3,
        source_frames: [0, 4].map(FrameIndex).to_vec(),
        query: QueryChoice::Plan(QueryPlanName::All),
        anchor_frame: Some(FrameIndex(4)),
        cameras: vec![choice("wrist", "ext1"), choice("right", "ext1_right")],
        depth_range_m: Some([0.3, 2.0]),
        ..params()
    };
    let (clip, warnings) = read_clip(&scratch.0, None, &chosen, "c").unwrap();
    assert_eq!(clip.episode_frames, [1, 4, 7, 10, 13].map(EpisodeFrame));
    assert_eq!(
        (clip.query_frames, clip.anchor_frame, clip.fps),
        (FrameIndex::first(5).collect(), FrameIndex(4), 5.0)
    );
    assert_eq!(
        (clip.cameras[0].id.as_str(), clip.cameras[1].id.as_str()),
        ("wrist", "right")
    );
    assert_eq!(
        clip.cameras[1].partner,
        Some(CameraIndex(0)),
        "the partner's new name is followed"
    );
    assert_eq!(clip.cameras[0].depth.as_ref().unwrap().range_m, [0.3, 2.0]);
    assert!(
        warnings
            .iter()
            .any(|warning| warning.contains("anchored at episode frame 2")),
        "{warnings:?}"
    );
    assert!(clip.tracks.is_none());
    // A camera may be held out: its images are those that views are compared with, and nobody observes them.
    let mut apart = chosen.clone();
    apart.cameras = vec![choice("wrist", "wrist"), choice("ext1", "ext1")];
    apart.cameras[0].held_out = true;
    let (clip, _) = read_clip(&scratch.0, None, &apart, "c").unwrap();
    let roles: Vec<_> = clip.cameras.iter().map(|own| (own.id.as_str(), own.role)).collect();
    assert_eq!(
        roles,
        [("ext1", CameraRole::Source), ("wrist", CameraRole::Evaluation)],
        "sources come first"
    );
    let (camera, frame) = (CameraIndex(1), FrameIndex(4));
    assert!(clip.target(camera, frame).is_some());
    assert!(clip.observation(SourceView { camera, frame }).is_none());
    apart.cameras[1].held_out = true;
    let error = read_clip(&scratch.0, None, &apart, "c").unwrap_err();
    assert!(error.message.contains("has no source camera"), "{error}");
    let late = Params {
        start_frame: Some(EpisodeFrame(10)),
        ..params()
    };
    let error = read_clip(&scratch.0, None, &late, "c").unwrap_err();
    assert!(
        error.message.contains("has 20 frames") && error.message.contains("needs 27"),
        "{error}"
    );
}

/// Damages a fresh episode and returns what ingest says.
fn said(name: &str, damage: impl FnOnce(&Path)) -> String {
    let scratch = Scratch::new(name);
    write_episode(&scratch.0);
    damage(&scratch.0);
    let error = read_clip(&scratch.0, None, &params(), "c").expect_err(name);
    assert_eq!(error.code, FailureCode::BadInput, "{name}: {error}");
    error.message.replace(&*scratch.0.to_string_lossy(), "EP")
}

fn described(name: &str, change: impl FnOnce(&mut Episode)) -> String {
    said(name, |folder| {
        let mut episode = description();
        change(&mut episode);
        write_description(folder, &episode);
    })
}

fn rows(name: &str, change: impl FnOnce(&mut Vec<String>)) -> String {
    said(name, |folder| {
        let path = folder.join("joints.csv");
        let mut lines: Vec<String> = std::fs::read_to_string(&path)
            .unwrap()
            .lines()
            .map(str::to_owned)
            .collect();
        change(&mut lines);
        std::fs::write(path, lines.join("\n")).unwrap();
    })
}

#[test]
fn damaged_states_name_file_and_row() {
    assert_eq!(
        rows("nan", |lines| lines[4] = "0.2,0,nan,0".into()),
        "`EP/joints.csv`: joint `j2` is NaN at row 3"
    );
    assert_eq!(
        rows("inf", |lines| lines[4] = "0.2,0,0,inf".into()),
        "`EP/joints.csv`: joint `j1` is inf at row 3"
    );
    let open = rows("gripper", |lines| lines[1] = "0,1.5,0,0".into());
    assert_eq!(
        open,
        "`EP/joints.csv`: the gripper is 1.5 at row 0, it must be in 0 (open) to 1 (closed)"
    );
    let short = rows("short", |lines| {
        lines.pop();
    });
    assert_eq!(short, "`EP/joints.csv`: there are 19 rows, the episode has 20 frames");
    assert!(rows("long", |lines| lines.push("9,0,0,0".into())).contains("more rows than the 20 frames"));
    assert!(rows("cells", |lines| lines[2] = "0,0,0".into()).contains("row 1 has 3 cells"));
    assert!(rows("word", |lines| lines[2] = "0.1,0,x,0".into()).contains("invalid number `x` in column `j2`, row 1"));
    assert!(rows("time", |lines| lines[3] = "0.01,0,0,0".into()).contains("time 0.01 at row 2 does not ascend"));
    assert!(rows("header", |lines| lines[0] = "time,gripper,j2,other".into()).contains("no column `j1`"));
    assert!(rows("degrees", |lines| lines[2] = "0.1,0,0,90".into()).contains("joint `j1` is 90"));
}

#[test]
fn damaged_descriptions_name_the_camera() {
    let fixed = |episode: &mut Episode, row: usize, column: usize, value: f64| {
        let EpisodeMount::Fixed { base_from_camera } = &mut episode.cameras[1].mount else {
            panic!("fixed")
        };
        let WrittenPose::Matrix(rows) = base_from_camera else {
            panic!("a matrix")
        };
        rows[row][column] = value;
    };
    assert!(described("shear", |e| fixed(e, 0, 0, 0.5)).contains("`base_from_camera` of camera `ext1` is not rigid"));
    assert!(described("mirror", |e| fixed(e, 2, 2, -1.0)).contains("reflection"));
    assert!(described("mm", |e| fixed(e, 0, 3, 1000.0)).contains("1000.0 m"));
    let zeros = described("zeros", |episode| {
        (0..4).for_each(|row| (0..4).for_each(|column| fixed(episode, row, column, 0.0)));
    });
    assert!(zeros.contains("all zeros"));
    assert!(described("focal", |e| e.cameras[0].intrinsics.fx = 0.0).contains("focal lengths of camera `wrist` are 0"));
    assert!(described("centre", |e| e.cameras[0].intrinsics.cx = 900.0).contains("principal point"));
    assert!(described("size", |e| e.cameras[0].width = 41).contains("images are 40x22, the episode says 41x22"));
    assert!(described("twice", |e| e.cameras[1].id = "wrist".into()).contains("two cameras are named `wrist`"));
    assert!(described("up", |e| e.robot.states = "../joints.csv".into()).contains("does not stay inside"));
    assert!(described("format", |e| e.format = "rogs-episode 9".into()).contains("`rogs-episode 9`"));
    assert!(described("id", |e| e.episode_id = "a\nb".into()).contains("episode id"));
    assert!(described("fps", |e| e.fps = 0.0).contains("`fps` 0"));
    assert!(described("frames", |e| e.frame_count = 19).contains("there are more rows than the 19 frames"));
    assert!(
        described("anchor", |e| e.tracks.as_mut().unwrap().anchor_frame = EpisodeFrame(20)).contains("anchor frame 20")
    );
    assert!(described("no-images", |e| e.cameras[0].images = None).contains("source camera `wrist`"));
    assert!(
        said("json", |folder| std::fs::write(folder.join("episode.json"), "{")
            .unwrap())
        .contains("not an episode description")
    );
    let unknown = said("unknown", |folder| {
        let text = std::fs::read_to_string(folder.join("episode.json")).unwrap();
        std::fs::write(
            folder.join("episode.json"),
            text.replacen("\"fps\"", "\"frame_rate\": 1, \"fps\"", 1),
        )
        .unwrap();
    });
    assert!(unknown.contains("frame_rate"), "{unknown}");
}

#[test]
fn damaged_images_and_arrays_name_the_file() {
    let missing = said("missing", |folder| {
        std::fs::remove_file(folder.join("ext1/000004.png")).unwrap()
    });
    assert_eq!(
        missing,
        "`EP/ext1`: it has 19 PNG files, the episode 20 frames; `000004.png` is missing"
    );
    let renamed = said("renamed", |folder| {
        std::fs::rename(folder.join("ext1/000004.png"), folder.join("ext1/4.png")).unwrap()
    });
    assert_eq!(
        renamed,
        "`EP/ext1`: it has 20 PNG files, the episode 20 frames; `000004.png` is missing"
    );
    let cut = said("cut-png", |folder| {
        let path = folder.join("wrist/000009.png");
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    });
    assert!(
        cut.starts_with("`EP/wrist/000009.png`: not a readable PNG image"),
        "{cut}"
    );
    let deep = said("deep", |folder| {
        let image = image::ImageBuffer::<image::Rgb<u16>, _>::new(WIDTH, HEIGHT);
        image.save(folder.join("wrist/000009.png")).unwrap();
    });
    assert!(deep.contains("expected 8-bit RGB or grey"), "{deep}");
    let glass = said("glass", |folder| {
        image::RgbaImage::new(WIDTH, HEIGHT)
            .save(folder.join("wrist/000009.png"))
            .unwrap();
    });
    assert!(glass.contains("transparent"), "{glass}");
    let other = said("other-size", |folder| {
        image::RgbImage::new(8, 8)
            .save(folder.join("wrist/000009.png"))
            .unwrap()
    });
    assert!(other.contains("images are 8x8"), "{other}");
    // A header that declares 60,000 x 60,000 pixels is refused before anything is allocated.
    let huge = said("huge", |folder| {
        let path = folder.join("wrist/000009.png");
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
        std::fs::write(&path, bytes).unwrap();
    });
    assert!(huge.contains("000009.png"), "{huge}");
    let depth = said("depth", |folder| {
        std::fs::remove_file(folder.join("ext1_depth.npy")).unwrap()
    });
    assert!(depth.contains("the depth file or folder is missing"), "{depth}");
    let shape = said("shape", |folder| {
        common::npy(
            &folder.join("ext1_depth.npy"),
            "<f4",
            &[1, 2],
            &common::f32_bytes([0.0, 1.0]),
        );
    });
    assert!(shape.contains("the shape is [1, 2], expected [20, 22, 40]"), "{shape}");
    let depth_of = |value: f32| {
        move |folder: &Path| {
            let values = common::f32_bytes(std::iter::repeat_n(value, 20 * 22 * 40));
            common::npy(&folder.join("ext1_depth.npy"), "<f4", &[20, 22, 40], &values);
        }
    };
    let millimetres = said("depth-mm", depth_of(1200.0));
    assert!(
        millimetres.contains("no depth of camera `ext1` lies within ")
            && millimetres.ends_with("; taken as millimetres, it does"),
        "{millimetres}"
    );
    let metres = said("depth-m", depth_of(0.0012));
    assert!(metres.ends_with("taken as metres, it does"), "{metres}");
    // Another unit does not explain this one: told, and not scored.
    let scratch = Scratch::new("depth-far");
    write_episode(&scratch.0);
    depth_of(30.0)(&scratch.0);
    let (_, warnings) = read_clip(&scratch.0, None, &params(), "c").unwrap();
    let told =
        |warning: &String| warning.contains("`ext1` lies within ") && warning.ends_with("m: none of it is scored");
    assert!(warnings.iter().any(told), "{warnings:?}");
    let cut = said("cut-npy", |folder| {
        let path = folder.join("right.npy");
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 8]).unwrap();
    });
    assert!(cut.contains("does not fit its shape"), "{cut}");
    let pose = said("pose", |folder| {
        common::npy(&folder.join("right.npy"), "<f8", &[20, 4, 4], &vec![0; 20 * 16 * 8]);
    });
    assert!(pose.contains("the pose at frame 0 is all zeros"), "{pose}");
    let track = said("track", |folder| {
        common::npy(
            &folder.join("tracks/camera.npy"),
            "<u4",
            &[3],
            &[0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0],
        );
    });
    assert!(track.contains("track 1 lies in camera 9 of 3"), "{track}");
}

#[cfg(unix)]
#[test]
fn links_are_followed_wherever_they_lead() {
    let outside = Scratch::new("outside");
    std::fs::write(outside.0.join("joints.csv"), "other,columns").unwrap();
    let said = said("link", |folder| {
        std::fs::remove_file(folder.join("joints.csv")).unwrap();
        std::os::unix::fs::symlink(outside.0.join("joints.csv"), folder.join("joints.csv")).unwrap();
    });
    assert!(
        said.contains("there is no column") && said.contains("other,columns"),
        "{said}"
    );
}

#[test]
fn a_calibration_file_replaces_that_of_the_episode() {
    let scratch = Scratch::new("calibration");
    write_episode(&scratch.0);
    let path = scratch.0.join("other.json");
    let text = r#"{"status": "better", "image_size": [80, 44], "pixel_centres": "integer", "cameras": {"ext1": {
        "intrinsic": [[50, 0, 39.5], [0, 52, 21.5], [0, 0, 1]],
        "camera_to_base": [[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}}"#;
    std::fs::write(&path, text).unwrap();
    let (clip, _) = read_clip(&scratch.0, Some(&path), &params(), "c").unwrap();
    let ext1 = &clip.cameras[1];
    assert_eq!(
        (ext1.intrinsics.fx, ext1.intrinsics.cx, ext1.intrinsics.cy),
        (25.0, 20.0, 11.0)
    );
    assert!(
        matches!(&ext1.mount, CameraMount::Fixed { base_from_camera } if base_from_camera.translation == [2.0, 0.0, 0.0])
    );
    assert_eq!(
        clip.cameras[0].intrinsics.fx, 20.0,
        "cameras it does not name keep theirs"
    );
    assert_eq!(clip.calibration_note, "other.json: better");
    std::fs::write(&path, text.replace("50, 0,", "0, 0,")).unwrap();
    let error = read_clip(&scratch.0, Some(&path), &params(), "c").unwrap_err();
    assert!(error.message.contains("focal lengths"), "{error}");
}

#[test]
fn folders_of_episodes_are_listed() {
    let scratch = Scratch::new("list");
    for name in ["b", "a"] {
        std::fs::create_dir(scratch.0.join(name)).unwrap();
        write_episode(&scratch.0.join(name));
    }
    std::fs::create_dir(scratch.0.join("notes")).unwrap();
    std::fs::write(scratch.0.join("b/episode.json"), "{").unwrap();
    let listed = list_episodes(&scratch.0).unwrap();
    let folders: Vec<_> = listed
        .iter()
        .map(|episode| (episode.folder.as_str(), episode.name.as_str()))
        .collect();
    assert_eq!(
        folders,
        [("a", "LAB+a+2026-01-31-12h_00m"), ("b", "b")],
        "a damaged one is listed by its folder"
    );
    assert!(listed[0].files.contains(&"tracks/pixel.npy".to_owned()) && listed[0].files.is_sorted());
    assert!(
        list_episodes(&scratch.0.join("notes"))
            .unwrap_err()
            .message
            .contains("no episode of a known layout")
    );
}

#[needs(numpy, pillow)]
#[test]
fn the_script_of_the_documentation_writes_an_episode() {
    let text =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/episode-format.md")).unwrap();
    let script = text
        .split("```python\n")
        .nth(1)
        .and_then(|rest| rest.split("```").next())
        .expect("a Python script");
    let python = std::env::var("ROGS_PEER_PYTHON").unwrap_or_else(|_| "python3".into());
    let scratch = Scratch::new("python");
    let output = std::process::Command::new(&python)
        .arg("-c")
        .arg(script)
        .current_dir(&scratch.0)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let listed = list_episodes(&scratch.0).unwrap();
    let (clip, _) = read_clip(&scratch.0.join(&listed[0].folder), None, &Params::default(), "c").unwrap();
    assert_eq!((clip.frame_count(), clip.cameras.len(), clip.height), (17, 2, 154));
}
