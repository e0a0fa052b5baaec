//! Raw DROID episodes up to their videos: metadata, published serials, and the trajectory (HDF5), separated by a line of
//! `====`.
#![no_main]

#[path = "common/place.rs"]
mod place;

use libfuzzer_sys::fuzz_target;
use rogs_ingest::{Params, list_episodes, read_clip};

const NAMES: [&str; 3] = ["metadata_A+0+1.json", "published/camera_serials.json", "trajectory.h5"];

fuzz_target!(|bytes: &[u8]| {
    let folder = place::folder();
    std::fs::create_dir_all(folder.join("published")).expect("a folder can be made");
    let mark = b"\n====\n";
    let mut rest = bytes;
    for (index, name) in NAMES.iter().enumerate() {
        // The last one may hold anything.
        let end = rest
            .windows(mark.len())
            .position(|window| window == mark)
            .filter(|_| index < 2);
        let (piece, after) = end.map_or((rest, &[][..]), |end| (&rest[..end], &rest[end + mark.len()..]));
        std::fs::write(folder.join(name), piece).expect("an input can be written");
        rest = after;
    }
    let _ = list_episodes(&folder);
    let _ = read_clip(&folder, Some(&folder.join("published")), &Params::default(), "clip");
});
