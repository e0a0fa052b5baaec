//! Episode folders: `episode.json`, the table of states, a trajectory, a depth array and an EXR image, separated by a
//! line of `====`.
#![no_main]

#[path = "common/place.rs"]
mod place;

use libfuzzer_sys::fuzz_target;
use rogs_ingest::{Params, list_episodes, read_clip};

const NAMES: [&str; 5] = [
    "episode.json",
    "joints.csv",
    "poses.npy",
    "depth.npy",
    "depth/000000.exr",
];

fuzz_target!(|bytes: &[u8]| {
    let folder = place::folder();
    std::fs::create_dir_all(folder.join("depth")).expect("a folder can be made");
    let mut rest = bytes;
    for name in NAMES {
        let mark = b"\n====\n";
        let end = rest.windows(mark.len()).position(|window| window == mark);
        let (piece, after) = end.map_or((rest, &[][..]), |end| (&rest[..end], &rest[end + mark.len()..]));
        std::fs::write(folder.join(name), piece).expect("an input can be written");
        rest = after;
    }
    let _ = list_episodes(&folder);
    let params = Params {
        height: 8,
        width: 8,
        ..Params::default()
    };
    let _ = read_clip(&folder, None, &params, "clip");
});
