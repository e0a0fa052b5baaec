//! Calibration files beside a small episode of one camera.
#![no_main]

#[path = "common/episode.rs"]
mod episode;
#[path = "common/place.rs"]
mod place;

use libfuzzer_sys::fuzz_target;
use rogs_ingest::{Params, read_clip};
use rogs_schemas::FrameIndex;

fuzz_target!(|bytes: &[u8]| {
    let file = place::file("json", bytes);
    let params = Params {
        frames: 2,
        source_frames: [0, 1].map(FrameIndex).to_vec(),
        height: 6,
        width: 8,
        ..Params::default()
    };
    let _ = read_clip(episode::one_camera(), Some(&file), &params, "clip");
});
