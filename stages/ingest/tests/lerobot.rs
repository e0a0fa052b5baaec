//! LeRobot v3.0 data sets that other writers made: start times that drift, tasks in every place, damage.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use common::Scratch;
use common::tables::{self, Values};
use rogs_ingest::{Params, QueryChoice, QueryPlanName, list_episodes, read_clip};
use rogs_needs::needs;
use rogs_schemas::{EpisodeFrame, FrameIndex};

/// Frames of each of the four episodes.
const FRAMES: u64 = 20;
/// Frames per second.
const FPS: f64 = 30.0;
/// What is to be done.
const TASK: &str = "put the red block into the bowl";

/// Where and as which type the tasks are kept.
#[derive(Clone, Copy, Debug)]
enum Tasks {
    /// A list of texts for each episode.
    Lists,
    /// Empty lists, which have no type; the text is in the table of tasks, its number in every frame.
    EmptyLists,
    /// No column; likewise.
    ByFrame,
    /// A text for each episode.
    Texts,
    /// Numbers, which are no task.
    Numbers,
}

fn write(path: &Path, columns: &[(&str, Values)]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    tables::write(path, columns, 1 << 20);
}

fn numbers(values: impl Iterator<Item = u64>) -> Values {
    Values::Integers(values.map(|value| Some(value as i64)).collect())
}

fn tasks(kind: Tasks, count: usize) -> Option<Values> {
    let texts = vec![TASK.to_owned(); count];
    Some(match kind {
        Tasks::Lists => Values::TextLists(texts),
        Tasks::EmptyLists => Values::EmptyLists(count),
        Tasks::ByFrame => return None,
        Tasks::Texts => Values::Texts(texts),
        Tasks::Numbers => Values::Numbers(vec![7.0; count]),
    })
}

/// A data set of four episodes in one video, whose grey level tells the frame. Each episode begins `drift_s` later for every
/// episode before it than it does.
fn dataset(root: &Path, drift_s: f64, kind: Tasks) {
    let key = "observation.images.ext1";
    let info = serde_json::json!({
        "codebase_version": "v3.0", "robot_type": "stick", "fps": FPS,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": {
            "observation.state": {"dtype": "float32", "names": ["turn", "gripper"]},
            key: {"dtype": "video", "names": null},
        },
    });
    std::fs::create_dir_all(root.join("meta")).unwrap();
    std::fs::write(root.join("meta/info.json"), info.to_string()).unwrap();
    let episodes = 4;
    let of = |value: u64| numbers((0..episodes).map(move |_| value));
    let from = (0..episodes).map(|index| index as f64 * (FRAMES as f64 / FPS + drift_s));
    let column = |what: &str| format!("videos/{key}/{what}");
    let (chunk, file, time) = (column("chunk_index"), column("file_index"), column("from_timestamp"));
    let mut columns = vec![
        ("episode_index", numbers(0..episodes)),
        ("length", of(FRAMES)),
        ("data/chunk_index", of(0)),
        ("data/file_index", of(0)),
        (chunk.as_str(), of(0)),
        (file.as_str(), of(0)),
        (time.as_str(), Values::Numbers(from.collect())),
    ];
    columns.extend(tasks(kind, episodes as usize).map(|tasks| ("tasks", tasks)));
    write(&root.join("meta/episodes/chunk-000/file-000.parquet"), &columns);
    // pandas keeps the text as the index of its table.
    let texts = Values::Texts(vec!["something else".into(), TASK.into()]);
    let table = vec![("task_index", numbers(0..2)), ("__index_level_0__", texts)];
    write(&root.join("meta/tasks.parquet"), &table);
    let rows = || (0..episodes).flat_map(|episode| (0..FRAMES).map(move |frame| (episode, frame)));
    let times = rows().map(|(_, frame)| frame as f64 / FPS);
    let state = Values::Lists(2, rows().flat_map(|_| [0.1, 0.5]).collect());
    let data = vec![
        ("episode_index", numbers(rows().map(|(episode, _)| episode))),
        ("frame_index", numbers(rows().map(|(_, frame)| frame))),
        ("timestamp", Values::Numbers(times.collect())),
        ("task_index", numbers(rows().map(|_| 1))),
        ("observation.state", state),
    ];
    write(&root.join("data/chunk-000/file-000.parquet"), &data);
    let video = root.join(format!("videos/{key}/chunk-000/file-000.mp4"));
    std::fs::create_dir_all(video.parent().unwrap()).unwrap();
    let mut encoder = Command::new("ffmpeg")
        .args([
            "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "32x32", "-r", "30", "-i", "-",
        ])
        .args(["-c:v", "png", "-f", "mov"])
        .arg(&video)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = encoder.stdin.take().unwrap();
    for frame in 0..episodes * FRAMES {
        input.write_all(&[grey(frame); 32 * 32 * 3]).unwrap();
    }
    drop(input);
    assert!(encoder.wait().unwrap().success());
}

fn grey(frame: u64) -> u8 {
    (3 * frame) as u8
}

const CALIBRATION: &str = r#"{"image_size": [32, 32], "cameras": {"ext1": {
    "intrinsic": [[30, 0, 16], [0, 30, 16], [0, 0, 1]],
    "camera_to_base": [[0, 0, 1, -1.2], [-1, 0, 0, 0], [0, -1, 0, 0.3], [0, 0, 0, 1]]}}}"#;

/// Grey levels of the first two frames of an episode, its task, and what was said.
fn read(root: &Path, episode: u64) -> (Vec<u8>, String, Vec<String>) {
    let calibration = root.join("calibration.json");
    std::fs::write(&calibration, CALIBRATION).unwrap();
    let params = Params {
        episode: format!("episode_{episode:06}"),
        start_frame: Some(EpisodeFrame(0)),
        frames: 2,
        source_frames: vec![FrameIndex(0), FrameIndex(1)],
        query: QueryChoice::Plan(QueryPlanName::All),
        height: 28,
        width: 28,
        ..Params::default()
    };
    let (clip, warnings) = read_clip(root, Some(&calibration), &params, "c").unwrap();
    let images = clip.cameras[0].recorded.as_ref().unwrap();
    let levels = images
        .chunks_exact(28 * 28 * 3)
        .map(|image| image[28 * 14 * 3])
        .collect();
    (levels, clip.task, warnings)
}

#[needs(ffmpeg)]
#[test]
fn start_times_that_drift_are_mended_by_the_lengths_and_said() {
    let scratch = Scratch::new("drift");
    // Nothing, a part of a frame, more than a frame: also where the sum happens to be whole again.
    for drift_s in [0.0, 1e-6, 0.0095, -0.004, 0.0333333] {
        dataset(&scratch.0, drift_s, Tasks::Lists);
        for episode in 0..4 {
            let first = episode * FRAMES;
            let (levels, _, warnings) = read(&scratch.0, episode);
            assert_eq!(levels, [grey(first), grey(first + 1)], "{drift_s} {episode}");
            let off = (episode as f64 * drift_s * FPS).abs();
            let said = warnings.iter().any(|text| text.contains("timestamp"));
            assert_eq!(said, off >= 0.1, "{drift_s} {episode}: {warnings:?}");
        }
    }
}

#[needs(ffmpeg)]
#[test]
fn tasks_are_read_wherever_they_are_kept_and_never_stop_a_data_set() {
    let scratch = Scratch::new("tasks");
    for kind in [
        Tasks::Lists,
        Tasks::EmptyLists,
        Tasks::ByFrame,
        Tasks::Texts,
        Tasks::Numbers,
    ] {
        dataset(&scratch.0, 0.0, kind);
        assert_eq!(list_episodes(&scratch.0).unwrap().len(), 4, "{kind:?}");
        let (_, task, warnings) = read(&scratch.0, 1);
        assert_eq!((task.as_str(), warnings.len()), (TASK, 0), "{kind:?}: {warnings:?}");
    }
    // Without the table there is no text, and that is all.
    std::fs::remove_file(scratch.0.join("meta/tasks.parquet")).unwrap();
    assert_eq!(read(&scratch.0, 1).1, "");
}

#[needs(ffmpeg)]
#[test]
fn damaged_tables_are_bad_input_and_no_bug() {
    let scratch = Scratch::new("damage");
    dataset(&scratch.0, 0.0, Tasks::Lists);
    let tables = [
        "meta/episodes/chunk-000/file-000.parquet",
        "data/chunk-000/file-000.parquet",
    ];
    for name in tables {
        let path = scratch.0.join(name);
        let whole = std::fs::read(&path).unwrap();
        let mut state = 1_u64;
        for _ in 0..300 {
            let mut bytes = whole.clone();
            for _ in 0..4 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let at = (state >> 33) as usize % bytes.len();
                bytes[at] ^= 1 << (state >> 20 & 7);
            }
            std::fs::write(&path, bytes).unwrap();
            // Whatever comes of it, it comes in words.
            if let Err(error) = list_episodes(&scratch.0) {
                assert!(!error.message.is_empty());
            }
            let params = Params {
                episode: "episode_000001".into(),
                ..Params::default()
            };
            if let Err(error) = read_clip(&scratch.0, None, &params, "c") {
                assert_ne!(error.code, rogs_schemas::protocol::FailureCode::Internal, "{error}");
            }
        }
        std::fs::write(&path, whole).unwrap();
    }
}
