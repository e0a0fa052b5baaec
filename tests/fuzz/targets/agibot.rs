//! AgiBot samples with one camera: actions, intrinsics, poses and an image, separated by a line of `====`.
#![no_main]

#[path = "common/place.rs"]
mod place;

use libfuzzer_sys::fuzz_target;
use rogs_ingest::{Params, list_episodes, read_clip};
use rogs_schemas::FrameIndex;

const NAMES: [&str; 4] = [
    "actions.npy",
    "intrinsic_hand_left.npy",
    "extrinsic_hand_left.npy",
    "hand_left_color/0.png",
];

fuzz_target!(|bytes: &[u8]| {
    let folder = place::folder();
    std::fs::create_dir_all(folder.join("hand_left_color")).expect("a folder can be made");
    let mark = b"\n====\n";
    let mut rest = bytes;
    for (index, name) in NAMES.iter().enumerate() {
        // The last one may hold anything.
        let end = rest
            .windows(mark.len())
            .position(|window| window == mark)
            .filter(|_| index + 1 < NAMES.len());
        let (piece, after) = end.map_or((rest, &[][..]), |end| (&rest[..end], &rest[end + mark.len()..]));
        std::fs::write(folder.join(name), piece).expect("an input can be written");
        rest = after;
    }
    let _ = list_episodes(&folder);
    let params = Params {
        frames: 1,
        source_frames: vec![FrameIndex(0)],
        height: 6,
        width: 8,
        ..Params::default()
    };
    let _ = read_clip(&folder, None, &params, "clip");
});
