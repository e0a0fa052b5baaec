//! Caches of PointWorld as references of a small episode: the first byte says which file the others are.
#![no_main]

#[path = "common/place.rs"]
mod place;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;
use rogs_ingest::{Params, PointWorldFiles, read_joined_clip};
use rogs_schemas::FrameIndex;

/// Two frames of one camera: what a cache is joined to.
const EPISODE: &str = r#"{"format": "rogs-episode 1", "episode_id": "E", "fps": 15.0, "frame_count": 2,
    "robot": {"joint_names": ["j"], "states": "joints.csv"},
    "cameras": [{"id": "a", "role": "source", "images": "a", "width": 8, "height": 6,
        "intrinsics": {"fx": 8.0, "fy": 8.0, "cx": 4.0, "cy": 3.0},
        "mount": {"fixed": {"base_from_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}}]}"#;

fn episode() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = place::folder().join("episode");
        std::fs::create_dir_all(folder.join("a")).expect("a folder can be made");
        let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("a file can be written");
        write("episode.json", EPISODE.as_bytes());
        write("joints.csv", b"time,j,gripper\n0.0,0.1,0.0\n0.066,0.1,0.0\n");
        for frame in 0..2 {
            let name = folder.join(format!("a/{frame:06}.png"));
            rogs_arrays::write_png(&name, (8, 6), &[7; 8 * 6 * 3]).expect("an image can be written");
        }
        folder
    })
}

fuzz_target!(|bytes: &[u8]| {
    let Some((&role, rest)) = bytes.split_first() else {
        return;
    };
    // Files of tracks are told apart by their ending.
    let file = place::folder().join(if role % 4 == 3 { "file.tar" } else { "file" });
    std::fs::write(&file, rest).expect("an input can be written");
    let mut files = PointWorldFiles::default();
    let place = match role % 4 {
        0 => &mut files.cameras,
        1 => &mut files.depth,
        _ => &mut files.flows,
    };
    *place = Some(file);
    let params = Params {
        frames: 2,
        source_frames: [0, 1].map(FrameIndex).to_vec(),
        height: 6,
        width: 8,
        ..Params::default()
    };
    let _ = read_joined_clip(episode(), None, &files, &params, "clip");
});
