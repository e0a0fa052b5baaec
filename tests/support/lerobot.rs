//! A LeRobot v3.0 data set made of a procedural episode: the wrist camera as a film, states as DROID sets have them.

use std::path::Path;
use std::process::Command;

use super::tables::{Values, write};

const KEY: &str = "observation.images.wrist_left";

/// Writes the episode of an episode folder as the only one of a data set.
pub(crate) fn write_set(root: &Path, episode: &Path) {
    let description: serde_json::Value =
        serde_json::from_slice(&std::fs::read(episode.join("episode.json")).unwrap()).unwrap();
    let fps = description["fps"].as_f64().unwrap();
    let joints: Vec<&str> = description["robot"]["joint_names"]
        .as_array()
        .unwrap()
        .iter()
        .map(|name| name.as_str().unwrap())
        .collect();
    let table = std::fs::read_to_string(episode.join("joints.csv")).unwrap();
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = lines.next().unwrap();
    let column = |name: &str| header.iter().position(|own| *own == name).unwrap();
    let order: Vec<usize> = joints.iter().copied().chain(["gripper"]).map(column).collect();
    let rows: Vec<Vec<f64>> = lines
        .map(|row| order.iter().map(|&at| row[at].parse().unwrap()).collect())
        .collect();
    let count = rows.len();

    let camera = &description["cameras"][0];
    let (width, height) = (camera["width"].as_u64().unwrap(), camera["height"].as_u64().unwrap());
    let mut names: Vec<String> = (0..joints.len()).map(|joint| format!("joint_{joint}")).collect();
    names.push("gripper".to_owned());
    let info = serde_json::json!({
        "codebase_version": "v3.0", "robot_type": "franka", "fps": fps,
        "total_episodes": 1, "total_frames": count, "total_tasks": 1,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": {
            "observation.state": {"dtype": "float32", "shape": [names.len()], "names": names},
            KEY: {"dtype": "video", "shape": [height, width, 3], "names": ["height", "width", "channels"]},
        },
    });
    let folder = |path: &str| {
        let path = root.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    };
    std::fs::write(folder("meta/info.json"), info.to_string()).unwrap();
    let whole = |value: i64| Values::Integers(vec![Some(value)]);
    let of = |what: &str| format!("videos/{KEY}/{what}");
    let (chunk, file, time) = (of("chunk_index"), of("file_index"), of("from_timestamp"));
    let episodes = [
        ("episode_index", whole(0)),
        ("length", whole(count as i64)),
        ("data/chunk_index", whole(0)),
        ("data/file_index", whole(0)),
        (chunk.as_str(), whole(0)),
        (file.as_str(), whole(0)),
        (time.as_str(), Values::Numbers(vec![0.0])),
        ("tasks", Values::TextLists(vec!["put it there".into()])),
    ];
    write(&folder("meta/episodes/chunk-000/file-000.parquet"), &episodes, 1);
    let tasks = [
        ("task_index", whole(0)),
        ("__index_level_0__", Values::Texts(vec!["put it there".into()])),
    ];
    write(&folder("meta/tasks.parquet"), &tasks, 1);
    let data = [
        ("episode_index", Values::Integers(vec![Some(0); count])),
        ("frame_index", Values::Integers((0..count as i64).map(Some).collect())),
        (
            "timestamp",
            Values::Numbers((0..count).map(|frame| frame as f64 / fps).collect()),
        ),
        ("task_index", Values::Integers(vec![Some(0); count])),
        ("observation.state", Values::Lists(order.len(), rows.concat())),
    ];
    write(&folder("data/chunk-000/file-000.parquet"), &data, count);
    let images = episode.join(camera["images"].as_str().unwrap());
    let filmed = Command::new("ffmpeg")
        .args(["-v", "error", "-y", "-framerate", &fps.to_string(), "-i"])
        .arg(images.join("%06d.png"))
        .args(["-c:v", "png", "-f", "mov"])
        .arg(folder(&format!("videos/{KEY}/chunk-000/file-000.mp4")))
        .status()
        .unwrap();
    assert!(filmed.success());
}
