//! Seconds to list 11,950 and 95,600 episodes: a tree of raw DROID, and data sets of LeRobot v2.1 and v3.0, all made here with
//! empty files. Eight times as many should take eight times as long.
//!
//! `cargo bench -p rogs-ingest --bench listing`. The trees lie in `ROGS_BENCH_DIR`, where they stay for the next time, or in a
//! folder that goes away. `ROGS_BENCH_COLD` is a command that makes the system forget what it has read, for example the
//! unmounting and mounting of that folder; it runs before every first listing, and without it all times are warm.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of benchmarks may be left half-written")]

#[path = "../../../tests/support/bench.rs"]
mod bench;
#[path = "../tests/common/tables.rs"]
mod tables;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use bench::{peak_memory_mib, processor_seconds};
use rogs_ingest::list_episodes;
use serde_json::json;
use tables::Values;

const COUNTS: [usize; 2] = [11_950, 95_600];
const CAMERAS: [&str; 3] = ["wrist_left", "exterior_1_left", "exterior_2_left"];
/// Episodes of a chunk of LeRobot.
const CHUNK: usize = 1000;

fn file(path: &Path, text: &str) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

/// LAB/success/DATE/TIME with metadata, states and three videos.
fn droid(root: &Path, count: usize) {
    for index in 0..count {
        let (lab, day) = (index % 13, index / 13 % 200);
        let place = root.join(format!(
            "LAB{lab}/success/2023-{:02}-{:02}/Fri_Jul__7_09:{:02}:{:02}_{index}",
            1 + day / 28,
            1 + day % 28,
            index % 60,
            index % 59
        ));
        file(&place.join(format!("metadata_LAB{lab}+0+{index}.json")), "");
        file(&place.join("trajectory.h5"), "");
        for camera in 1..=3 {
            file(&place.join(format!("recordings/MP4/{camera}.mp4")), "");
        }
    }
}

fn info(root: &Path, version: &str, data: &str, video: &str) {
    let videos = CAMERAS.map(|camera| {
        let feature = json!({"dtype": "video", "shape": [180, 320, 3], "names": ["height", "width", "channel"]});
        (format!("observation.images.{camera}"), feature)
    });
    let mut features: serde_json::Map<_, _> = videos.into_iter().collect();
    features.insert(
        "observation.state".into(),
        json!({"dtype": "float32", "shape": [8], "names": null}),
    );
    let info = json!({"codebase_version": version, "robot_type": "panda", "fps": 15, "chunks_size": CHUNK,
        "data_path": data, "video_path": video, "features": features});
    file(&root.join("meta/info.json"), &info.to_string());
}

/// A line and a table an episode.
fn lerobot_v21(root: &Path, count: usize) {
    info(
        root,
        "v2.1",
        "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    );
    let line =
        |index: usize| json!({"episode_index": index, "tasks": ["put it there"], "length": 250}).to_string() + "\n";
    file(
        &root.join("meta/episodes.jsonl"),
        &(0..count).map(line).collect::<String>(),
    );
    for index in 0..count {
        file(
            &root.join(format!("data/chunk-{:03}/episode_{index:06}.parquet", index / CHUNK)),
            "",
        );
    }
}

/// A row an episode, a thousand in every file.
fn lerobot_v30(root: &Path, count: usize) {
    info(
        root,
        "v3.0",
        "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    );
    for (number, start) in (0..count).step_by(CHUNK).enumerate() {
        let rows = start..count.min(start + CHUNK);
        let same = |value: usize| Values::Integers(vec![Some(value as i64); rows.len()]);
        let mut names = vec!["episode_index".to_owned(), "length".into(), "tasks".into()];
        let mut columns = vec![
            Values::Integers(rows.clone().map(|index| Some(index as i64)).collect()),
            same(250),
            Values::TextLists(vec!["put it there".to_owned(); rows.len()]),
        ];
        let places = CAMERAS.map(|camera| format!("videos/observation.images.{camera}"));
        for place in places.iter().map(String::as_str).chain(["data"]) {
            names.extend([format!("{place}/chunk_index"), format!("{place}/file_index")]);
            columns.extend([same(number / 1000), same(number % 1000)]);
        }
        for place in &places {
            names.push(format!("{place}/from_timestamp"));
            columns.push(Values::Numbers((0..rows.len()).map(|row| row as f64 * 16.7).collect()));
        }
        let part = format!("chunk-{:03}/file-{:03}.parquet", number / 1000, number % 1000);
        let path = root.join("meta/episodes").join(&part);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let columns: Vec<_> = names.iter().map(String::as_str).zip(columns).collect();
        tables::write(&path, &columns, CHUNK);
        file(&root.join("data").join(&part), "");
    }
}

fn forget(command: &str) {
    let done = Command::new("sh").args(["-c", command]).status().unwrap();
    assert!(done.success(), "`{command}` failed");
}

fn main() {
    // `cargo test --benches` passes no `--bench`; there is nothing to check then.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let own = tempfile::tempdir().unwrap();
    let folder = std::env::var_os("ROGS_BENCH_DIR").map_or_else(|| own.path().to_owned(), PathBuf::from);
    let cold = std::env::var("ROGS_BENCH_COLD").ok();
    type Make = fn(&Path, usize);
    let kinds: [(&str, Make); 3] = [("droid", droid), ("v21", lerobot_v21), ("v30", lerobot_v30)];
    for (kind, make) in kinds {
        for count in COUNTS {
            let root = folder.join(format!("{kind}-{count}"));
            if !root.exists() {
                make(&root, count);
            }
            if let Some(command) = &cold {
                forget(command);
            }
            for round in 0..4 {
                let (start, cpu) = (Instant::now(), processor_seconds());
                assert_eq!(list_episodes(&root).unwrap().len(), count);
                let state = if round == 0 && cold.is_some() { "cold" } else { "warm" };
                println!(
                    "{kind} {count} {state}: wall {:.2} s, CPU {:.2} s, peak {:.0} MiB",
                    start.elapsed().as_secs_f64(),
                    processor_seconds() - cpu,
                    peak_memory_mib()
                );
            }
        }
    }
}
