//! Every released schema version stays readable, and today's writer still makes the same bytes.
//!
//! `UPDATE_EXPECT=1 cargo test -p rogs-r4c --test golden` writes missing files; an existing one is never replaced,
//! because a changed layout needs a new version.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use std::fmt::Debug;
use std::path::PathBuf;
use std::process::Command;

use common::Scratch;
use rogs_needs::needs;
use rogs_r4c::{Reader, Record, read_record, write_record};
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::scores::Scores;

fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(name)
}

fn stays<T: Record + Debug>(name: &str, record: &T) {
    let path = golden(&format!("{name}-{}.{}.r4c", T::SCHEMA.major, T::SCHEMA.minor));
    if !path.exists() && std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_record(&path, record, &common::provenance(name)).unwrap();
    }
    let (read, info) = read_record::<T>(&path).unwrap();
    assert_eq!(format!("{read:?}"), format!("{record:?}"), "{name}");
    let scratch = Scratch::new(&format!("golden-{name}"));
    let again = scratch.file("again.r4c");
    let rewritten = write_record(&again, record, &common::provenance(name)).unwrap();
    assert_eq!(
        rewritten.content, info.content,
        "{name}: the content hash does not depend on the compression"
    );
    assert_eq!(
        std::fs::read(&again).unwrap(),
        std::fs::read(&path).unwrap(),
        "{name}: same bytes with the pinned zstd"
    );
}

#[test]
fn every_schema_version_stays_readable() {
    stays("clip", &common::rollout_clip());
    let (read, _) = read_record::<Clip>(&golden("clip-1.1.r4c")).unwrap();
    assert_eq!(
        format!("{read:?}"),
        format!("{:?}", common::clip()),
        "a clip from before rollouts"
    );
    stays("robot", &common::robot());
    stays("conditioning", &common::conditioning());
    stays("references", &common::references());
    stays("agreement", &common::agreement());
    stays("field", &common::field());
    stays("polynomial-field", &common::polynomial());
    stays("motion-basis-field", &common::motion_bases());
    stays("progress", &common::progress());
    stays("refinement", &common::refinement());
    stays("scores", &common::scores());
}

/// Before 1.1 no record said where references come from: files of that version are read, and say that they do not.
#[test]
fn older_files_do_not_state_where_references_come_from() {
    let mut clip = common::clip();
    for camera in &mut clip.cameras {
        camera
            .depth
            .iter_mut()
            .for_each(|depth| depth.origin = ReferenceOrigin::NotStated);
    }
    clip.tracks
        .iter_mut()
        .for_each(|tracks| tracks.origin = ReferenceOrigin::NotStated);
    let (read, _) = read_record::<Clip>(&golden("clip-1.0.r4c")).unwrap();
    assert_eq!(format!("{read:?}"), format!("{clip:?}"));
    let mut scores = common::scores();
    scores.summary.cross_view.clear();
    let (read, _) = read_record::<Scores>(&golden("scores-1.1.r4c")).unwrap();
    assert_eq!(
        format!("{read:?}"),
        format!("{scores:?}"),
        "scores without a comparison across views"
    );
    scores.summary.references.clear();
    let (read, _) = read_record::<Scores>(&golden("scores-1.0.r4c")).unwrap();
    assert_eq!(format!("{read:?}"), format!("{scores:?}"));
}

/// The Python reader of `docs/spec/r4c.md` finds the same bytes, and takes the heads apart to their last byte.
#[needs(zstandard)]
#[test]
fn python_reads_the_same_bytes() {
    let script = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../docs/python/r4c.py");
    let python = std::env::var("ROGS_PEER_PYTHON").unwrap_or_else(|_| "python3".into());
    let names = [
        "clip-1.0",
        "clip-1.1",
        "clip-1.2",
        "robot-1.0",
        "conditioning-1.0",
        "references-1.0",
        "agreement-1.0",
        "field-1.0",
        "refinement-1.0",
        "scores-1.0",
        "scores-1.1",
        "scores-1.2",
    ];
    for name in names {
        let path = golden(&format!("{name}.r4c"));
        let output = Command::new(&python)
            .args([&script, &path])
            .arg("--hex")
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{name}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let reader = Reader::open(&path).unwrap();
        assert_eq!(report["content"], reader.content_hash().to_string());
        assert!(report["head"]["clip_id"].is_string(), "{name}: {}", report["head"]);
        for (stream, seen) in reader.streams().iter().zip(report["streams"].as_array().unwrap()) {
            assert_eq!(seen["name"], stream.name);
            let chunks: Vec<&serde_json::Value> = seen["chunks"].as_array().unwrap().iter().collect();
            assert_eq!(chunks.len(), reader.chunks(&stream.name).unwrap().len());
            for (number, chunk) in chunks.iter().enumerate() {
                let bytes = reader.chunk_bytes(&stream.name, number).unwrap();
                let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
                assert_eq!(chunk[1], hex, "{name}: chunk {number} of `{}`", stream.name);
            }
        }
    }
}
