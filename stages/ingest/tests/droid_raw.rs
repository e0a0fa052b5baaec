//! Raw DROID episodes: a tree of procedural ones with exact truth, and every way of getting it wrong.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Instant;

use rogs_geometry::{Camera, Pose};
use rogs_ingest::{DroidParams, IdleSteps, Params, Quality, QueryChoice, QueryPlanName, list_episodes, read_clip};
use rogs_needs::needs;
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip};
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex, RigidPose};
use rogs_synth::{
    BodyFrame, DROID_CALIBRATION_FOLDER, DROID_FOLDER, DroidEpisode, Mount, Peculiar, droid_config, write_droid,
};
use rogs_worker::StageError;
use serde_json::{Value, json};

const HEIGHT: u32 = 90;
const WIDTH: u32 = 160;
const FRAMES: u32 = 20;

/// The tree, made once.
struct Tree {
    _folder: tempfile::TempDir,
    root: PathBuf,
    calibration: PathBuf,
    episodes: Vec<DroidEpisode>,
}

fn tree() -> &'static Tree {
    static TREE: OnceLock<Tree> = OnceLock::new();
    TREE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let episodes = write_droid(folder.path(), 40, &droid_config(FRAMES, [HEIGHT, WIDTH])).unwrap();
        Tree {
            root: folder.path().join(DROID_FOLDER),
            calibration: folder.path().join(DROID_CALIBRATION_FOLDER),
            _folder: folder,
            episodes,
        }
    })
}

fn episode(peculiar: Peculiar) -> &'static DroidEpisode {
    tree()
        .episodes
        .iter()
        .find(|episode| episode.peculiar == peculiar)
        .unwrap()
}

/// The whole episode at the recorded size.
fn params() -> Params {
    Params {
        start_frame: Some(EpisodeFrame(0)),
        query: QueryChoice::Plan(QueryPlanName::All),
        height: HEIGHT,
        width: WIDTH,
        ..Params::default()
    }
}

fn read(peculiar: Peculiar, calibration: Option<&Path>, params: &Params) -> (Clip, Vec<String>) {
    read_clip(&episode(peculiar).place, calibration, params, "c").unwrap()
}

fn said(warnings: &[String], text: &str) -> bool {
    warnings.iter().any(|warning| warning.contains(text))
}

/// Largest difference of two poses, entry by entry.
fn off<A, B>(pose: &Pose<A, B>, rigid: &RigidPose) -> f64 {
    let [a, b, c] = [pose.rotation.x_axis, pose.rotation.y_axis, pose.rotation.z_axis].map(|axis| axis.to_array());
    let rotation = [a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]];
    let rotated = rotation.iter().zip(&rigid.rotation).map(|(a, b)| (a - b).abs());
    let moved = pose
        .translation
        .to_array()
        .into_iter()
        .zip(rigid.translation)
        .map(|(a, b)| (a - b).abs());
    rotated.chain(moved).fold(0.0, f64::max)
}

/// Every pose, state and lens of a clip against the truth.
fn check_geometry(clip: &Clip, episode: &DroidEpisode) {
    for camera in &clip.cameras {
        let index = rogs_synth::CAMERA_NAMES
            .iter()
            .position(|name| *name == camera.id)
            .unwrap();
        let truth = &episode.truth.cameras[index];
        match (&camera.mount, &truth.mount) {
            (CameraMount::Fixed { base_from_camera }, Mount::Fixed(pose)) => {
                assert!(off(pose, base_from_camera) < 1e-6, "{}", camera.id);
            }
            (CameraMount::HandEye { link, link_from_camera }, Mount::Flange(pose)) => {
                assert_eq!(link, "panda_link8");
                assert!(off::<BodyFrame, Camera>(pose, link_from_camera) < 1e-6, "{}", camera.id);
            }
            (found, expected) => panic!("{}: {found:?}, {expected:?}", camera.id),
        }
        let (found, lens) = (camera.intrinsics, truth.lens.intrinsics);
        let numbers = [
            (found.fx, lens.fx),
            (found.fy, lens.fy),
            (found.cx, lens.cx),
            (found.cy, lens.cy),
        ];
        assert!(
            numbers.iter().all(|(a, b)| (a - b).abs() < 1e-6),
            "{}: {numbers:?}",
            camera.id
        );
    }
    for (row, &frame) in clip.episode_frames.iter().enumerate() {
        let state = &episode.truth.states[frame.0 as usize];
        assert_eq!(clip.robot.positions[7 * row..7 * row + 7], state.joints);
        assert_eq!(clip.robot.gripper[row], state.gripper);
    }
}

/// Images of the first, a middle and the last frame against the truth.
fn check_images(clip: &Clip, episode: &DroidEpisode) {
    let size = (HEIGHT * WIDTH * 3) as usize;
    for camera in &clip.cameras {
        let index = rogs_synth::CAMERA_NAMES
            .iter()
            .position(|name| *name == camera.id)
            .unwrap();
        let rgb = camera.recorded.as_ref().unwrap();
        for row in [0, 8, 16] {
            let truth = &episode
                .truth
                .render_cameras(clip.episode_frames[row].0 as usize, &[index])[0]
                .rgb;
            let image = &rgb[row * size..(row + 1) * size];
            // Colours are halved in the video, brightness is not: it is off by the quantiser alone.
            let luma = |rgb: &[u8]| 0.299 * f64::from(rgb[0]) + 0.587 * f64::from(rgb[1]) + 0.114 * f64::from(rgb[2]);
            let pairs = image.chunks_exact(3).zip(truth.chunks_exact(3));
            let squares = pairs.map(|(a, b)| (luma(a) - luma(b)).powi(2));
            let error = 3.0 * squares.sum::<f64>() / size as f64;
            assert!(error < 8.0, "{} at {row}: {error}", camera.id);
        }
    }
}

fn ids(clip: &Clip) -> Vec<&str> {
    clip.cameras.iter().map(|camera| camera.id.as_str()).collect()
}

#[needs(libx264)]
#[test]
fn a_whole_episode_is_exact() {
    let (clip, warnings) = read(Peculiar::Whole, None, &params());
    assert_eq!(warnings, Vec::<String>::new());
    let episode = episode(Peculiar::Whole);
    assert_eq!((clip.layout.as_str(), clip.fps), ("droid-raw", 15.0));
    assert_eq!((&clip.episode_id, &clip.task), (&episode.uuid, &episode.truth.task()));
    assert_eq!(ids(&clip), rogs_synth::CAMERA_NAMES);
    for (index, camera) in clip.cameras.iter().enumerate() {
        let expected = if index < 3 {
            (CameraRole::Source, None)
        } else {
            (CameraRole::Evaluation, Some(CameraIndex(index as u32 - 3)))
        };
        assert_eq!((camera.role, camera.partner), expected);
    }
    check_geometry(&clip, episode);
    check_images(&clip, episode);
    let note = &clip.calibration_note;
    for part in [
        "wrist 18026681: intrinsics HDF5, pose step 0 of the metadata",
        "ext1 22008760: intrinsics HDF5, pose metadata",
        "logged flange and joints agree to 0.00000 mm",
        "0 ms from the image",
    ] {
        assert!(note.contains(part), "{note}");
    }
    // The default clip begins as the paper's where it fits, else at the first frame.
    let (clip, _) = read(
        Peculiar::Whole,
        None,
        &Params {
            start_frame: None,
            frames: 13,
            source_frames: vec![FrameIndex(0), FrameIndex(12)],
            ..params()
        },
    );
    assert_eq!(clip.episode_frames[0].0, 7);
    check_geometry(&clip, episode);
    check_images(&clip_of(&clip, 13), episode);
}

/// The clip with its rows repeated up to 17, so that the same check serves.
fn clip_of(clip: &Clip, frames: usize) -> Clip {
    let mut clip = clip.clone();
    let size = (HEIGHT * WIDTH * 3) as usize;
    for row in frames..17 {
        clip.episode_frames.push(clip.episode_frames[row - 1]);
        for camera in &mut clip.cameras {
            let rgb = camera.recorded.as_mut().unwrap();
            rgb.extend_from_within((row - 1) * size..row * size);
        }
    }
    clip
}

#[needs(libx264)]
#[test]
fn both_eyes_come_out_of_the_stereo_video() {
    let (clip, warnings) = read(Peculiar::StereoOnly, None, &params());
    assert_eq!(warnings, Vec::<String>::new());
    assert_eq!(ids(&clip), rogs_synth::CAMERA_NAMES);
    check_geometry(&clip, episode(Peculiar::StereoOnly));
    check_images(&clip, episode(Peculiar::StereoOnly));
    let left_only = Params {
        droid: DroidParams {
            right_eyes: false,
            ..DroidParams::default()
        },
        ..params()
    };
    assert_eq!(
        ids(&read(Peculiar::StereoOnly, None, &left_only).0),
        ["wrist", "ext1", "ext2"]
    );
    let (clip, _) = read(Peculiar::MonoOnly, None, &params());
    assert_eq!(ids(&clip), ["wrist", "ext1", "ext2"]);
    check_geometry(&clip, episode(Peculiar::MonoOnly));
    check_images(&clip, episode(Peculiar::MonoOnly));
    // The metadata of this one has zeros.
    assert!(
        clip.calibration_note.contains("pose step 0 of the HDF5"),
        "{}",
        clip.calibration_note
    );
}

#[needs(libx264)]
#[test]
fn a_missing_camera_is_left_out_and_told() {
    let (clip, warnings) = read(Peculiar::MissingCamera, None, &params());
    assert_eq!(ids(&clip), ["wrist", "ext1", "wrist_right", "ext1_right"]);
    assert!(said(
        &warnings,
        "camera `ext2` (23404442) is left out: there is no `recordings/MP4/23404442.mp4`"
    ));
    assert!(said(&warnings, "gs://gresearch/robotics/droid_raw"), "{warnings:?}");
    check_geometry(&clip, episode(Peculiar::MissingCamera));
}

#[needs(libx264)]
#[test]
fn intrinsics_come_from_what_there_is() {
    let zeros = episode(Peculiar::ZeroIntrinsics);
    // Nothing else: usual values of the model, with a warning each.
    let (clip, warnings) = read(Peculiar::ZeroIntrinsics, None, &params());
    assert!(
        said(
            &warnings,
            "the HDF5 has zeros as intrinsics of camera `wrist` (13062452)"
        ),
        "{warnings:?}"
    );
    assert!(said(&warnings, "usual values of a ZED Mini are taken"), "{warnings:?}");
    assert!(
        clip.calibration_note
            .contains("ext1 20521388: intrinsics usual values of a ZED 2")
    );
    assert!((clip.cameras[1].intrinsics.fx - 533.55 * f64::from(WIDTH) / 1280.0).abs() < 1e-9);
    // Published intrinsics, in both forms.
    let (clip, warnings) = read(Peculiar::ZeroIntrinsics, Some(&tree().calibration), &params());
    assert!(!said(&warnings, "usual values"), "{warnings:?}");
    assert!(
        clip.calibration_note
            .contains("intrinsics published (intrinsics.json), pose published (cam2base_extrinsic_superset.json)")
    );
    check_geometry(&clip, zeros);
    // Factory calibrations: 1 % longer in this tree, and said to be unrectified.
    let folder = tempfile::tempdir().unwrap();
    for serial in zeros.serials {
        let name = format!("SN{serial}.conf");
        std::fs::copy(tree().calibration.join(&name), folder.path().join(&name)).unwrap();
    }
    let (clip, warnings) = read(Peculiar::ZeroIntrinsics, Some(folder.path()), &params());
    assert!(said(&warnings, "before rectification"), "{warnings:?}");
    let (found, truth) = (clip.cameras[1].intrinsics.fx, zeros.truth.cameras[1].lens.intrinsics.fx);
    assert!((found / truth - 1.01).abs() < 1e-9);
    assert!(clip.calibration_note.contains("factory (SN20521388.conf)"));
}

#[needs(libx264)]
#[test]
fn late_states_missing_images_and_idle_steps_are_handled() {
    let late = episode(Peculiar::Late);
    let (clip, warnings) = read(Peculiar::Late, Some(&tree().calibration), &params());
    check_geometry(&clip, late);
    check_images(&clip, late);
    assert!(
        said(&warnings, "the robot's state nearest in time is that of +2 steps"),
        "{warnings:?}"
    );
    assert!(said(&warnings, "has 19 images for 20 steps"), "{warnings:?}");
    assert!(
        clip.calibration_note.contains("2 of 19 steps are idle and kept"),
        "{}",
        clip.calibration_note
    );
    let drop = Params {
        droid: DroidParams {
            idle: IdleSteps::Drop,
            ..DroidParams::default()
        },
        ..params()
    };
    let (clip, warnings) = read(Peculiar::Late, Some(&tree().calibration), &drop);
    assert!(said(&warnings, "2 of 19 steps are idle and left out"), "{warnings:?}");
    assert!(said(&warnings, "frames are missing at 1 place"), "{warnings:?}");
    // Frames 3 and 4 are gone: frame 3 of the episode is image 5 with its state.
    assert_eq!(clip.robot.positions[7 * 3..7 * 4], late.truth.states[5].joints);
    let size = (HEIGHT * WIDTH * 3) as usize;
    let image = &clip.cameras[0].recorded.as_ref().unwrap()[3 * size..4 * size];
    let error = |frame: usize| {
        let truth = &late.truth.render_cameras(frame, &[0])[0].rgb;
        image
            .iter()
            .zip(truth)
            .map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2))
            .sum::<f64>()
    };
    assert!(error(5) < error(3) && error(5) < error(4));
}

#[needs(libx264)]
#[test]
fn trees_are_listed_by_names_alone() {
    let listed = list_episodes(&tree().root).unwrap();
    assert_eq!(listed.len(), 6);
    for episode in &tree().episodes {
        let entry = listed.iter().find(|entry| entry.episode_id == episode.uuid).unwrap();
        assert_eq!((entry.layout.as_str(), entry.selector.as_str()), ("droid-raw", ""));
        assert_eq!(tree().root.join(&entry.folder), episode.place);
        assert_eq!(entry.name, episode.uuid);
        assert!(
            entry.files.iter().all(|file| episode.place.join(file).is_file()),
            "{:?}",
            entry.files
        );
        let videos = match episode.peculiar {
            Peculiar::StereoOnly | Peculiar::MonoOnly => 3,
            Peculiar::MissingCamera => 4,
            _ => 6,
        };
        assert_eq!(entry.files.len(), 2 + videos);
    }
    // From every level on: laboratory, outcome, day, episode, and a folder above.
    for (below, count) in [
        ("AUTOLab", 2),
        ("IRIS/success", 2),
        ("TRI/failure/2023-11-21", 1),
        ("..", 6),
    ] {
        assert_eq!(list_episodes(&tree().root.join(below)).unwrap().len(), count, "{below}");
    }
    let one = list_episodes(&episode(Peculiar::Late).place).unwrap();
    assert_eq!((one.len(), one[0].folder.as_str()), (1, "."));
}

/// A copy of an episode with its trajectory and metadata to change.
struct Changed {
    folder: tempfile::TempDir,
    metadata: Value,
    name: String,
}

impl Changed {
    fn of(episode: &DroidEpisode) -> Self {
        let folder = tempfile::tempdir().unwrap();
        copy(&episode.place, folder.path());
        let name = format!("metadata_{}.json", episode.uuid);
        let text = std::fs::read_to_string(folder.path().join(&name)).unwrap();
        Self {
            folder,
            metadata: serde_json::from_str(&text).unwrap(),
            name,
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn set(&mut self, key: &str, value: Value) {
        self.metadata[key] = value;
    }

    fn read(&self) -> Result<(Clip, Vec<String>), StageError> {
        std::fs::write(self.path(&self.name), self.metadata.to_string()).unwrap();
        read_clip(self.folder.path(), None, &params(), "c")
    }

    fn refused(&self) -> String {
        let Err(error) = self.read() else {
            panic!("it was taken")
        };
        format!("{} / {}", error.message, error.hint.unwrap_or_default())
    }
}

fn copy(from: &Path, to: &Path) {
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            std::fs::create_dir_all(&target).unwrap();
            copy(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

fn six<A, B>(pose: &Pose<A, B>) -> Value {
    let [x, y, z] = pose.translation.to_array();
    let [a, b, c] = rogs_geometry::euler_xyz_from_rotation(&pose.rotation);
    json!([x, y, z, a, b, c])
}

#[needs(libx264)]
#[test]
fn inverted_extrinsics_are_recognised() {
    let whole = episode(Peculiar::Whole);
    for (index, key) in [(1, "ext1_cam_extrinsics"), (0, "wrist_cam_extrinsics")] {
        let mut wrong = Changed::of(whole);
        wrong.set(key, six(&whole.truth.base_from_camera(index, 0).inverse()));
        let text = wrong.refused();
        assert!(
            text.contains("read as base to camera; DROID's are camera to base"),
            "{key}: {text}"
        );
    }
}

#[needs(libx264)]
#[test]
fn another_euler_order_is_recognised() {
    let whole = episode(Peculiar::Whole);
    for (index, key) in [(1, "ext1_cam_extrinsics"), (0, "wrist_cam_extrinsics")] {
        let pose = whole.truth.base_from_camera(index, 0);
        // Angles about moving axes: R = Rx(a) Ry(b) Rz(c), so that the transposed rotation has the negated angles.
        let [a, b, c] = rogs_geometry::euler_xyz_from_rotation(&pose.rotation.transpose()).map(|angle| -angle);
        let [x, y, z] = pose.translation.to_array();
        let mut wrong = Changed::of(whole);
        wrong.set(key, json!([x, y, z, a, b, c]));
        let text = wrong.refused();
        assert!(text.contains("R = Rz(c) Ry(b) Rx(a)"), "{key}: {text}");
    }
}

#[needs(libx264)]
#[test]
fn swapped_serials_are_recognised() {
    let whole = episode(Peculiar::Whole);
    let [wrist, ext1, ext2] = whole.serials;
    let mut wrong = Changed::of(whole);
    wrong.set("ext1_cam_serial", json!(ext2));
    wrong.set("ext2_cam_serial", json!(ext1));
    let text = wrong.refused();
    assert!(
        text.contains("gives camera `ext1` (24400334) the pose that the HDF5 has for `ext2`"),
        "{text}"
    );
    let mut wrong = Changed::of(whole);
    wrong.set("wrist_cam_serial", json!(ext1));
    wrong.set("ext1_cam_serial", json!(wrist));
    let text = wrong.refused();
    assert!(
        text.contains("camera `wrist` has the serial 22008760, which is an external camera"),
        "{text}"
    );
}

#[needs(libx264)]
#[test]
fn the_right_eye_in_the_place_of_the_left_is_recognised() {
    let whole = episode(Peculiar::Whole);
    let wrong = Changed::of(whole);
    let videos = wrong.path("recordings/MP4");
    let serial = whole.serials[1];
    let (stereo, mono) = (
        videos.join(format!("{serial}-stereo.mp4")),
        videos.join(format!("{serial}.mp4")),
    );
    std::fs::remove_file(&mono).unwrap();
    let status = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(&stereo)
        .args(["-vf", "crop=iw/2:ih:iw/2:0", "-c:v", "libx264", "-qp", "6"])
        .arg(&mono)
        .status()
        .unwrap();
    assert!(status.success());
    let text = wrong.refused();
    assert!(
        text.contains("it shows the right eye of") && text.contains("exchange the videos"),
        "{text}"
    );
}

#[needs(libx264)]
#[test]
fn rates_counts_and_sizes_that_disagree_are_told() {
    let whole = episode(Peculiar::Whole);
    let remake = |options: &[&str]| {
        let wrong = Changed::of(whole);
        let videos = wrong.path("recordings/MP4");
        let (from, to) = (videos.join("18026681.mp4"), videos.join("other.mp4"));
        let mut command = std::process::Command::new("ffmpeg");
        command
            .args(["-v", "error", "-i"])
            .arg(&from)
            .args(options)
            .args(["-c:v", "libx264", "-qp", "6"]);
        assert!(command.arg(&to).status().unwrap().success());
        std::fs::rename(to, from).unwrap();
        wrong
    };
    let fast = remake(&["-vf", "setpts=PTS/4", "-r", "60"]);
    let (clip, warnings) = fast.read().unwrap();
    assert_eq!(clip.fps, 15.0);
    assert!(
        said(
            &warnings,
            "the video of `wrist` says 60.0000 frames per second, its times 15.0000"
        ),
        "{warnings:?}"
    );
    let short = remake(&["-frames:v", "12"]);
    let text = short.refused();
    assert!(text.contains("it has 12 frames, the trajectory 20 steps"), "{text}");
    let small = remake(&["-vf", "scale=80:46"]);
    assert!(
        small
            .refused()
            .contains("are no two images of a camera side by side (80x46 each)")
    );
}

#[needs(libx264)]
#[test]
fn what_is_missing_is_said_with_the_way_to_get_it() {
    let whole = episode(Peculiar::Whole);
    let wrong = Changed::of(whole);
    std::fs::remove_file(wrong.path("trajectory.h5")).unwrap();
    let text = wrong.refused();
    assert!(text.contains("no joint states") && text.contains("gsutil"), "{text}");
    let bytes = std::fs::read(whole.place.join("trajectory.h5")).unwrap();
    std::fs::write(wrong.path("trajectory.h5"), &bytes[..bytes.len() / 2]).unwrap();
    let text = wrong.refused();
    assert!(
        text.contains("trajectory.h5") && text.contains("it is cut off") && text.contains("fetch the file again"),
        "{text}"
    );
    let wrong = Changed::of(whole);
    std::fs::remove_dir_all(wrong.path("recordings")).unwrap();
    assert!(wrong.refused().contains("no video of any camera"));
    // Only the maker's own form is there.
    std::fs::create_dir_all(wrong.path("recordings/SVO")).unwrap();
    std::fs::write(wrong.path(&format!("recordings/SVO/{}.svo", whole.serials[0])), "").unwrap();
    let text = wrong.refused();
    assert!(
        text.contains("only SVO files") && text.contains("ZED SDK") && text.contains("-stereo.mp4"),
        "{text}"
    );
    // Without metadata: refused, but for an episode of the published tables.
    let wrong = Changed::of(whole);
    std::fs::remove_file(wrong.path(&wrong.name)).unwrap();
    let error = read_clip(wrong.folder.path(), None, &params(), "c").unwrap_err();
    assert!(error.message.contains("no `metadata_*.json`"), "{error}");
    assert!(error.hint.unwrap().contains("episode_id_to_path.json"));
    let place = wrong.path("x/AUTOLab/success/2023-07-07/Fri_Jul_7_09_42_23_2023");
    std::fs::create_dir_all(&place).unwrap();
    copy(&whole.place, &place);
    std::fs::remove_file(place.join(&wrong.name)).unwrap();
    let (clip, warnings) = read_clip(&place, Some(&tree().calibration), &params(), "c").unwrap();
    assert_eq!(clip.episode_id, whole.uuid);
    assert_eq!(warnings, Vec::<String>::new());
    check_geometry(&clip, whole);
}

#[needs(libx264)]
#[test]
fn metadata_that_does_not_fit_is_told() {
    let whole = episode(Peculiar::Whole);
    let mut wrong = Changed::of(whole);
    wrong.set("trajectory_length", json!(25));
    assert!(said(&wrong.read().unwrap().1, "the metadata announces 25 steps"));
    wrong.set("uuid", json!("OTHER+1+2023-01-01-00h-00m-00s"));
    assert!(
        wrong
            .refused()
            .contains("its `uuid` is `OTHER+1+2023-01-01-00h-00m-00s`, its name says")
    );
    let mut wrong = Changed::of(whole);
    wrong.set("ext1_cam_extrinsics", json!([1.0, 2.0]));
    assert!(
        wrong
            .refused()
            .contains("`ext1_cam_extrinsics` of the metadata has 2 numbers")
    );
    let millimetres: Vec<f64> = whole
        .truth
        .base_from_camera(1, 0)
        .translation
        .to_array()
        .map(|x| 1000.0 * x)
        .to_vec();
    wrong.set(
        "ext1_cam_extrinsics",
        json!([millimetres[0], millimetres[1], millimetres[2], 0.1, 0.2, 0.3]),
    );
    assert!(wrong.refused().contains("were these millimetres?"));
    // A wrist camera where none can be.
    let mut wrong = Changed::of(whole);
    wrong.set("wrist_cam_extrinsics", json!([0.0, 2.0, 0.5, -1.0, 0.0, 0.0]));
    assert!(wrong.refused().contains("from the flange at step 0: not on the wrist"));
}

#[test]
fn record_files_are_refused_with_the_way_on() {
    let folder = tempfile::tempdir().unwrap();
    let version = folder.path().join("droid_100/1.0.0");
    std::fs::create_dir_all(&version).unwrap();
    for name in [
        "dataset_info.json",
        "features.json",
        "r2d2_faceblur-train.tfrecord-00000-of-00031",
    ] {
        std::fs::write(version.join(name), "{}").unwrap();
    }
    for root in [version.clone(), folder.path().join("droid_100")] {
        let error = list_episodes(&root).unwrap_err();
        assert!(
            error.message.contains("TFRecord") && error.message.contains("neither intrinsics nor poses"),
            "{error}"
        );
        assert!(error.hint.as_deref().unwrap().contains("raw episodes"));
        assert!(
            read_clip(&root, None, &params(), "c")
                .unwrap_err()
                .message
                .contains("TFRecord")
        );
    }
    let error = read_clip(folder.path(), None, &params(), "c").unwrap_err();
    assert!(error.hint.unwrap().contains("raw DROID"));
}

/// Ranges that loaders keep are joined by the episode's place; its quality gates a published pose.
#[needs(libx264)]
#[test]
fn kept_ranges_and_the_quality_of_published_poses_are_honoured() {
    let whole = episode(Peculiar::Whole);
    let folder = tempfile::tempdir().unwrap();
    let place = whole.place.strip_prefix(&tree().root).unwrap().display().to_string();
    let key = format!("gs://bucket/droid/{place}/recordings/MP4--gs://bucket/droid/{place}/trajectory.h5");
    let ranges = json!({key: [[0, 18]]});
    std::fs::write(folder.path().join("keep_ranges_1_0_1.json"), ranges.to_string()).unwrap();
    let (clip, _) = read(Peculiar::Whole, Some(folder.path()), &params());
    assert!(
        clip.calibration_note.contains("2 of 20 steps are idle and kept"),
        "{}",
        clip.calibration_note
    );
    let drop = Params {
        droid: DroidParams {
            idle: IdleSteps::Drop,
            ..DroidParams::default()
        },
        ..params()
    };
    let (_, warnings) = read(Peculiar::Whole, Some(folder.path()), &drop);
    assert!(said(&warnings, "2 of 20 steps are idle and left out"), "{warnings:?}");

    // A published pose a metre off with an overlap of 0.4.
    let [_, ext1, _] = whole.serials;
    let mut pose = six(&whole.truth.base_from_camera(1, 0));
    pose[2] = json!(pose[2].as_f64().unwrap() + 1.0);
    let table = json!({whole.uuid.clone(): {ext1: pose, format!("{ext1}_iou"): 0.4}});
    std::fs::write(folder.path().join("cam2base_extrinsics.json"), table.to_string()).unwrap();
    let (clip, _) = read(Peculiar::Whole, Some(folder.path()), &params());
    assert!(
        clip.calibration_note
            .contains("published (cam2base_extrinsics.json, iou 0.4)"),
        "{}",
        clip.calibration_note
    );
    let gate = Quality {
        min: Some(0.5),
        max: None,
    };
    let gated = Params {
        droid: DroidParams {
            quality: [("iou".to_owned(), gate)].into(),
            ..DroidParams::default()
        },
        ..params()
    };
    let (clip, warnings) = read(Peculiar::Whole, Some(folder.path()), &gated);
    assert!(said(&warnings, "is not taken: iou 0.4 is below 0.5"), "{warnings:?}");
    check_geometry(&clip, whole);
}

/// The names of 9,560 episodes, a tenth of DROID: a second or two on a quiet machine, in proportion to the number.
#[test]
fn large_trees_are_listed_in_linear_time() {
    let folder = tempfile::tempdir().unwrap();
    let time = |root: &Path, count: usize| {
        let before = Instant::now();
        assert_eq!(list_episodes(root).unwrap().len(), count);
        before.elapsed().as_secs_f64()
    };
    let mut grown = 0;
    let mut times = Vec::new();
    for count in [1195, 9560] {
        for index in grown..count {
            let (lab, day) = (index % 13, index / 13 % 200);
            let place = format!(
                "LAB{lab}/success/2023-{:02}-{:02}/Fri_Jul__7_09:{:02}:{:02}_{index}",
                1 + day / 28,
                1 + day % 28,
                index % 60,
                index % 59
            );
            let place = folder.path().join(place);
            std::fs::create_dir_all(place.join("recordings/MP4")).unwrap();
            for name in [
                format!("metadata_LAB{lab}+0+{index}.json"),
                "trajectory.h5".into(),
                "recordings/MP4/1.mp4".into(),
            ] {
                std::fs::write(place.join(name), "").unwrap();
            }
        }
        grown = count;
        times.push(time(folder.path(), count));
    }
    // Eight times as many; twice that is far from a square.
    assert!(times[1] < 16.0 * times[0].max(0.1), "{times:?}");
}
