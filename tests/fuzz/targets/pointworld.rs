//! Caches of PointWorld as references of a small episode: the first byte says which file the others are.
#![no_main]

#[path = "common/episode.rs"]
mod episode;
#[path = "common/place.rs"]
mod place;

use libfuzzer_sys::fuzz_target;
use rogs_ingest::{Params, PointWorldFiles, read_joined_clip};
use rogs_schemas::FrameIndex;

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
    let _ = read_joined_clip(episode::one_camera(), None, &files, &params, "clip");
});
