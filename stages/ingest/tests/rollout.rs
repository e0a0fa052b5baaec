//! Rollouts: generated frames become observations, nothing else of the clip changes, and what is of another clip is refused.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::path::{Path, PathBuf};

use common::{HEIGHT, Scratch, WIDTH, colour, description, write_description, write_episode};
use rogs_ingest::{Observations, Params, RolloutLayout, RolloutParams, compose, read_clip, read_rollout};
use rogs_needs::needs;
use rogs_schemas::protocol::FailureCode;
use rogs_schemas::records::clip::{Clip, SourceView};
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_worker::StageError;

/// Colours of wrist, ext1 and ext2 (`common::colour`) by their place among the source cameras.
const COLOURS: [u8; 3] = [0, 1, 3];
/// The clip begins at the anchor of the tracks.
const START: u32 = 2;

/// The small episode with a third source camera.
fn three_cameras(name: &str) -> Scratch {
    let scratch = Scratch::new(name);
    write_episode(&scratch.0);
    let mut episode = description();
    let mut ext2 = episode.cameras[1].clone();
    ext2.id = "ext2".into();
    ext2.images = Some("ext2".into());
    ext2.depth = None;
    episode.cameras.insert(2, ext2);
    write_description(&scratch.0, &episode);
    std::fs::create_dir_all(scratch.0.join("ext2")).unwrap();
    for frame in 0..common::FRAMES {
        common::write_png(&scratch.0.join(format!("ext2/{frame:06}.png")), COLOURS[2], frame);
    }
    scratch
}

fn recorded() -> Params {
    Params {
        height: HEIGHT,
        width: WIDTH,
        ..Params::default()
    }
}

fn params(rollout: RolloutParams) -> Params {
    Params {
        observations: Observations::Rollout,
        rollout,
        ..recorded()
    }
}

/// What the model makes of a camera at a clip frame: the recording, greener from frame to frame.
fn generated(camera: usize, number: u32) -> Vec<u8> {
    let pixel = |at: u32| {
        let [r, g, b] = colour(COLOURS[camera], START + number, at % WIDTH, at / WIDTH);
        [r, g.saturating_add(number as u8), b]
    };
    (0..WIDTH * HEIGHT).flat_map(pixel).collect()
}

fn save(path: &Path, (width, height): (u32, u32), rgb: Vec<u8>) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::RgbImage::from_raw(width, height, rgb)
        .unwrap()
        .save(path)
        .unwrap();
}

/// A folder of frames a camera, under the names given.
fn write_views(folder: &Path, names: [&str; 3], frames: u32) {
    for (camera, name) in names.into_iter().enumerate() {
        for number in 0..frames {
            save(
                &folder.join(format!("{name}/{number:06}.png")),
                (WIDTH, HEIGHT),
                generated(camera, number),
            );
        }
    }
}

fn write_composite(folder: &Path, frames: u32, pad: Option<(u32, u32)>) {
    for number in 0..frames {
        let views = [0, 1, 2].map(|camera| generated(camera, number));
        let (size, image) = compose([&views[0], &views[1], &views[2]], (WIDTH, HEIGHT));
        let (width, height) = pad.unwrap_or(size);
        // The content at the top left, reflected to the right and below as the model pads.
        let reflect = |at: u32, side: u32| if at < side { at } else { 2 * side - 2 - at };
        let pixel = |at: u32| {
            let (x, y) = (reflect(at % width, size.0), reflect(at / width, size.1));
            let at = (y * size.0 + x) as usize * 3;
            image[at..at + 3].to_vec()
        };
        let padded = (0..width * height).flat_map(pixel).collect();
        save(&folder.join(format!("{number:06}.png")), (width, height), padded);
    }
}

/// The frames of a Ctrl-World replay: ext1, ext2, wrist from left to right, recorded above generated.
fn write_replay(folder: &Path, frames: u32) {
    for number in 0..frames {
        let mut image = image::RgbImage::new(3 * WIDTH, 2 * HEIGHT);
        for (column, camera) in [1, 2, 0].into_iter().enumerate() {
            let below = image::RgbImage::from_raw(WIDTH, HEIGHT, generated(camera, number)).unwrap();
            image::imageops::replace(&mut image, &below, i64::from(column as u32 * WIDTH), i64::from(HEIGHT));
        }
        std::fs::create_dir_all(folder).unwrap();
        image.save(folder.join(format!("{number:06}.png"))).unwrap();
    }
}

fn read(scratch: &Scratch, rollout: &Path, options: RolloutParams) -> Result<Clip, StageError> {
    read_rollout(&scratch.0, None, rollout, &params(options), "clip").map(|(clip, _)| clip)
}

fn refused(scratch: &Scratch, rollout: &Path, options: RolloutParams) -> StageError {
    read(scratch, rollout, options).unwrap_err()
}

/// The rest of a clip is that of the recording.
fn assert_only_observations_differ(scratch: &Scratch, clip: &Clip) {
    let (recorded, _) = read_clip(&scratch.0, None, &recorded(), "clip").unwrap();
    let mut rest = clip.clone();
    rest.rollout = None;
    rest.cameras.iter_mut().for_each(|camera| camera.generated = None);
    // NaN depth is not equal to itself.
    assert_eq!(format!("{rest:?}"), format!("{recorded:?}"));
}

#[test]
fn a_folder_of_views_becomes_observations_and_nothing_else_changes() {
    let scratch = three_cameras("views");
    let folder = scratch.0.join("rollout");
    write_views(&folder, ["wrist", "ext1", "exterior_image_2_left"], 17);
    let options = RolloutParams {
        model: "a model".into(),
        ..RolloutParams::default()
    };
    let clip = read(&scratch, &folder, options).unwrap();
    assert_only_observations_differ(&scratch, &clip);
    let rollout = clip.rollout.as_ref().unwrap();
    assert_eq!(
        (rollout.model.as_str(), rollout.layout.as_str(), rollout.frames),
        ("a model", "views", [0, 1])
    );
    // The first frames are the recorded ones; the held-out camera has none.
    assert_eq!(
        rollout.first_frame_psnr_db,
        [Some(f64::INFINITY), Some(f64::INFINITY), Some(f64::INFINITY), None]
    );
    for camera in 0..3 {
        for frame in [0, 5, 16] {
            let view = SourceView {
                camera: CameraIndex(camera as u32),
                frame: FrameIndex(frame),
            };
            assert_eq!(clip.observation(view).unwrap().rgb(), generated(camera, frame));
            assert_eq!(
                clip.target(CameraIndex(camera as u32), FrameIndex(frame))
                    .unwrap()
                    .rgb()[..3],
                colour(COLOURS[camera], START + frame, 0, 0)
            );
        }
    }
}

#[test]
fn views_of_ctrl_world_are_known_by_their_numbers() {
    let scratch = three_cameras("numbers");
    let folder = scratch.0.join("rollout");
    write_views(&folder, ["2", "0", "1"], 17);
    let clip = read(&scratch, &folder, RolloutParams::default()).unwrap();
    assert_eq!(clip.cameras[0].generated.as_deref().unwrap()[..3], generated(0, 0)[..3]);
}

#[test]
fn a_composite_is_split_with_and_without_padding() {
    let scratch = three_cameras("composite");
    let size = (WIDTH, HEIGHT / 2 * 3);
    for (name, pad, image_size) in [
        ("plain", None, None),
        (
            "padded",
            Some((WIDTH + 6, HEIGHT / 2 * 3 + 5)),
            Some([38, 46, size.1, size.0]),
        ),
    ] {
        let folder = scratch.0.join(name);
        write_composite(&folder, 17, pad);
        let options = RolloutParams {
            image_size,
            ..RolloutParams::default()
        };
        let clip = read(&scratch, &folder, options).unwrap();
        assert_only_observations_differ(&scratch, &clip);
        assert_eq!(clip.rollout.as_ref().unwrap().layout, "composite");
        let wrist = clip.cameras[0].generated.as_ref().unwrap();
        let area = (WIDTH * HEIGHT * 3) as usize;
        assert!(
            wrist[5 * area..6 * area] == generated(0, 5),
            "{name}: the wrist has its full size"
        );
        // The external views came at half their size: smooth images survive that.
        for camera in [1, 2] {
            let own = clip.cameras[camera].generated.as_ref().unwrap();
            let far = own[..area]
                .iter()
                .zip(generated(camera, 0))
                .filter(|(a, b)| a.abs_diff(*b) > 4)
                .count();
            assert!(far < area / 50, "{name}: {far} of {area} values of camera {camera}");
            assert!(clip.rollout.as_ref().unwrap().first_frame_psnr_db[camera].unwrap() > 35.0);
        }
    }
}

#[test]
fn a_ctrl_world_replay_is_told_by_its_name_and_must_be_of_this_clip() {
    let scratch = three_cameras("replay");
    let named = |episode: &str, start: u32| -> PathBuf {
        let folder = scratch
            .0
            .join(format!("time_20260131_120000_traj_{episode}_{start}_5_turn"));
        write_replay(&folder, 17);
        folder
    };
    let id = description().episode_id;
    let clip = read(&scratch, &named(&id, START), RolloutParams::default()).unwrap();
    assert_only_observations_differ(&scratch, &clip);
    assert_eq!(clip.rollout.as_ref().unwrap().layout, "ctrl-world");
    let area = (WIDTH * HEIGHT * 3) as usize;
    for camera in 0..3 {
        let own = clip.cameras[camera].generated.as_ref().unwrap();
        assert_eq!(own[3 * area..4 * area], generated(camera, 3));
    }
    let other = refused(&scratch, &named("someone", START), RolloutParams::default());
    assert!(
        other
            .message
            .contains("its name says episode `someone`, the clip is of `LAB+a"),
        "{other}"
    );
    let late = refused(&scratch, &named(&id, 9), RolloutParams::default());
    assert!(
        late.message.contains("it starts at frame 9, the clip starts at 2"),
        "{late}"
    );
    assert!(late.hint.unwrap().contains("start_frame = 9"));
}

#[test]
fn a_rollout_of_another_length_rate_or_scene_is_refused() {
    let scratch = three_cameras("refused");
    let folder = |name: &str, names: [&str; 3], frames: u32| {
        let folder = scratch.0.join(name);
        write_views(&folder, names, frames);
        folder
    };
    let all = ["wrist", "ext1", "ext2"];
    let none = RolloutParams::default;

    let short = refused(&scratch, &folder("short", all, 16), none());
    assert!(
        short
            .message
            .contains("it has 16 frames, the 17 frames of the clip need 17"),
        "{short}"
    );
    let long = folder("long", all, 33);
    let error = refused(&scratch, &long, none());
    assert!(error.message.contains("it has 33 frames") && error.hint.unwrap().contains("`frames`"));
    let told = RolloutParams {
        frames: Some(33),
        ..none()
    };
    assert_eq!(read(&scratch, &long, told).unwrap().rollout.unwrap().frames, [0, 1]);
    let beyond = RolloutParams {
        frames: Some(33),
        first_frame: 17,
        ..none()
    };
    assert!(
        refused(&scratch, &long, beyond)
            .message
            .contains("need 34 and `frames` says 33")
    );

    // Frames that are twice as many a second: every second one. Another rate has no frame at the clip's times.
    let double = |fps: f64| RolloutParams {
        fps: Some(fps),
        ..none()
    };
    assert_eq!(
        read(&scratch, &long, double(30.0)).unwrap().rollout.unwrap().frames,
        [0, 2]
    );
    for fps in [10.0, 20.0] {
        let error = refused(&scratch, &long, double(fps));
        assert!(
            error
                .message
                .contains(&format!("runs at {fps} frames per second, the clip at 15")),
            "{error}"
        );
    }

    let swapped = refused(&scratch, &folder("swapped", ["wrist", "ext2", "ext1"], 17), none());
    assert!(
        swapped.message.contains(
            "its first frame is not the first recorded one of camera `ext1` (14.8 dB) but that of camera `ext2`"
        ),
        "{swapped}"
    );
    let shifted = RolloutParams {
        first_frame: 16,
        frames: Some(33),
        min_first_frame_psnr_db: 40.0,
        ..none()
    };
    assert!(
        refused(&scratch, &long, shifted)
            .message
            .contains("is not the first recorded one")
    );

    let missing = refused(&scratch, &folder("missing", ["wrist", "ext1", "ext9"], 17), none());
    assert!(
        missing
            .message
            .contains("no view of camera `ext2`; it has ext1, ext9, wrist"),
        "{missing}"
    );
    let twice = folder("twice", all, 17);
    write_views(&twice, ["wrist", "exterior_1_left", "ext2"], 17);
    assert!(
        refused(&scratch, &twice, none())
            .message
            .contains("2 views of camera `ext1`")
    );
    let gone = refused(&scratch, &scratch.0.join("nowhere"), none());
    assert!(
        gone.message.contains("nowhere") && gone.code == FailureCode::BadInput,
        "{gone}"
    );
}

#[test]
fn a_rollout_that_begins_a_frame_early_or_late_is_told_from_the_right_one() {
    let scratch = three_cameras("early");
    let all = ["wrist", "ext1", "ext2"];
    let folder = scratch.0.join("late");
    write_views(&folder, all, 18);
    let at = |first_frame: u32, least: f64| RolloutParams {
        frames: Some(18),
        first_frame,
        min_first_frame_psnr_db: least,
        ..RolloutParams::default()
    };
    assert!(read(&scratch, &folder, at(0, 20.0)).is_ok());
    // Some 40 dB from the right frame: what the least PSNR lets through.
    let late = refused(&scratch, &folder, at(1, 20.0));
    assert!(
        late.message.contains("of camera `wrist` (")
            && late
                .message
                .contains("but that of episode frame 3, where the clip begins at 2"),
        "{late}"
    );
    assert!(late.hint.unwrap().contains("`start_frame = 3` under [ingest]"));
    // Asked not to look, it is taken.
    assert!(read(&scratch, &folder, at(1, 0.0)).is_ok());

    let early = scratch.0.join("early");
    for (camera, name) in all.into_iter().enumerate() {
        for number in 0..17 {
            let pixel = |at: u32| colour(COLOURS[camera], START + number - 1, at % WIDTH, at / WIDTH);
            let image = (0..WIDTH * HEIGHT).flat_map(pixel).collect();
            save(&early.join(format!("{name}/{number:06}.png")), (WIDTH, HEIGHT), image);
        }
    }
    let early = refused(&scratch, &early, RolloutParams::default());
    assert!(
        early
            .message
            .contains("but that of episode frame 1, where the clip begins at 2"),
        "{early}"
    );
    assert!(
        early
            .hint
            .unwrap()
            .contains("`first-frame` under [rollouts] to the frame that shows episode frame 2")
    );
}

#[test]
fn a_view_of_another_scale_or_mirrored_is_named() {
    let scratch = three_cameras("scale");
    let write = |name: &str, place: &dyn Fn(u32) -> u32| {
        let folder = scratch.0.join(name);
        write_views(&folder, ["wrist", "ext1", "ext2"], 17);
        for number in 0..17 {
            let pixel = |at: u32| colour(COLOURS[1], START + number, place(at % WIDTH), at / WIDTH);
            let image = (0..WIDTH * HEIGHT).flat_map(pixel).collect();
            save(&folder.join(format!("ext1/{number:06}.png")), (WIDTH, HEIGHT), image);
        }
        refused(&scratch, &folder, RolloutParams::default())
    };
    // A 4:3 cut out of the middle, stretched to the whole width.
    let cut = write("cut", &|x| (WIDTH / 8) + x * 3 / 4);
    assert!(
        cut.message.contains("camera `ext1`") && cut.message.contains("a part of it, 75 % of its width and 100 %"),
        "{cut}"
    );
    let mirrored = write("mirrored", &|x| WIDTH - 1 - x);
    assert!(
        mirrored.message.contains("its mirror image, left for right"),
        "{mirrored}"
    );
}

#[test]
fn composites_are_of_three_cameras_and_of_their_stated_size() {
    let scratch = three_cameras("sizes");
    let folder = scratch.0.join("composite");
    write_composite(&folder, 17, None);
    let wrong = RolloutParams {
        image_size: Some([528, 640, 528, 640]),
        ..RolloutParams::default()
    };
    let error = refused(&scratch, &folder, wrong);
    assert!(
        error
            .message
            .contains("its frames are 33x40, `image-size` says 528x640"),
        "{error}"
    );
    let replay = RolloutParams {
        layout: RolloutLayout::CtrlWorld,
        ..RolloutParams::default()
    };
    assert!(
        refused(&scratch, &folder, replay)
            .message
            .contains("two rows of three views")
    );

    // The episode without its third camera.
    write_description(&scratch.0, &description());
    let error = refused(&scratch, &folder, RolloutParams::default());
    assert!(
        error
            .message
            .contains("shows wrist, ext1, ext2; the clip's source cameras are wrist, ext1"),
        "{error}"
    );
}

#[test]
fn a_recorded_clip_takes_no_rollout_and_a_rollout_needs_one() {
    let scratch = three_cameras("settings");
    let folder = scratch.0.join("rollout");
    write_views(&folder, ["wrist", "ext1", "ext2"], 17);
    let given = read_rollout(&scratch.0, None, &folder, &recorded(), "c").unwrap_err();
    assert!(given.message.contains("but `observations` are recorded"), "{given}");
    assert_eq!(given.code, FailureCode::BadParams);
    let missing = read_clip(&scratch.0, None, &params(RolloutParams::default()), "c").unwrap_err();
    assert!(
        missing.message.contains("there is no rollout of episode `LAB+a"),
        "{missing}"
    );
    assert!(missing.hint.unwrap().contains("[rollouts]"));
    for (options, what) in [
        (
            RolloutParams {
                fps: Some(0.0),
                ..RolloutParams::default()
            },
            "rollout.fps",
        ),
        (
            RolloutParams {
                min_first_frame_psnr_db: f64::NAN,
                ..RolloutParams::default()
            },
            "rollout.min_first_frame_psnr_db",
        ),
    ] {
        assert!(refused(&scratch, &folder, options).message.contains(what));
    }
}

/// Frames of a folder as a video at a rate.
fn encode(folder: &Path, video: &Path, fps: u32) {
    let status = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-y", "-framerate", &fps.to_string(), "-i"])
        .arg(folder.join("%06d.png"))
        .args([
            "-vf",
            "pad=ceil(iw/2)*2:ceil(ih/2)*2",
            "-c:v",
            "libx264",
            "-qp",
            "4",
            "-pix_fmt",
            "yuv444p",
        ])
        .arg(video)
        .status()
        .unwrap();
    assert!(status.success());
}

#[needs(ffmpeg, libx264)]
#[test]
fn videos_are_read_at_their_rate() {
    let scratch = three_cameras("video");
    let frames = scratch.0.join("frames");
    write_composite(&frames, 33, None);
    let size = Some([34, 40, 33, 40]);
    for (fps, expected) in [
        (30, Ok([0, 2])),
        (15, Err("it has 33 frames")),
        (25, Err("runs at 25 frames per second")),
    ] {
        let video = scratch.0.join(format!("{fps}.mp4"));
        encode(&frames, &video, fps);
        let options = RolloutParams {
            image_size: size,
            ..RolloutParams::default()
        };
        match (read(&scratch, &video, options), expected) {
            (Ok(clip), Ok(frames)) => {
                let rollout = clip.rollout.as_ref().unwrap();
                assert_eq!(rollout.frames, frames);
                assert!(rollout.first_frame_psnr_db[0].unwrap() > 30.0, "{rollout:?}");
            }
            (Err(error), Err(text)) => assert!(error.message.contains(text), "{error}"),
            (found, _) => panic!("{fps}: {:?}", found.map(|clip| clip.rollout)),
        }
    }
}
