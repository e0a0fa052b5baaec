//! LeRobot data sets up to their videos: `info.json`, the episodes (lines of JSON for v2.1, parquet for v3.0), the tasks and
//! the rows of one episode, separated by a line of `====`.
#![no_main]

#[path = "common/place.rs"]
mod place;

use libfuzzer_sys::fuzz_target;
use rogs_ingest::{Params, list_episodes, outline, read_clip};

/// Names in either version; the first byte says which.
const NAMES: [[&str; 4]; 2] = [
    [
        "meta/info.json",
        "meta/episodes.jsonl",
        "meta/tasks.jsonl",
        "data/rows.parquet",
    ],
    [
        "meta/info.json",
        "meta/episodes/chunk-000/file-000.parquet",
        "meta/tasks.parquet",
        "data/rows.parquet",
    ],
];

fuzz_target!(|bytes: &[u8]| {
    let Some((&version, mut rest)) = bytes.split_first() else {
        return;
    };
    let folder = place::folder().join(if version & 1 == 0 { "v2.1" } else { "v3.0" });
    let mark = b"\n====\n";
    for (index, name) in NAMES[usize::from(version & 1)].iter().enumerate() {
        // The last one may hold anything.
        let end = rest
            .windows(mark.len())
            .position(|window| window == mark)
            .filter(|_| index < 3);
        let (piece, after) = end.map_or((rest, &[][..]), |end| (&rest[..end], &rest[end + mark.len()..]));
        let file = folder.join(name);
        std::fs::create_dir_all(file.parent().expect("it has a folder")).expect("a folder can be made");
        std::fs::write(file, piece).expect("an input can be written");
        rest = after;
    }
    let listed = list_episodes(&folder);
    if let Some(first) = listed.as_ref().ok().and_then(|episodes| episodes.first()) {
        let _ = outline(&folder, first);
    }
    let params = Params {
        episode: "0".to_owned(),
        ..Params::default()
    };
    let _ = read_clip(&folder, None, &params, "clip");
});
