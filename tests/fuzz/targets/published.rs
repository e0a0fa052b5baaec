//! Published calibrations of DROID: the first byte says which file of the folder the others are.
#![no_main]

#[path = "common/place.rs"]
mod place;

use libfuzzer_sys::fuzz_target;
use rogs_ingest::look_up_published;

const NAMES: [&str; 9] = [
    "cam2base_extrinsics.json",
    "cam2base_extrinsic_superset.json",
    "cam2cam_extrinsics.json",
    "intrinsics.json",
    "camera_serials.json",
    "episode_id_to_path.json",
    "gripper2wrist_transforms.json",
    "keep_ranges_1_0_1.json",
    "SN24400334.conf",
];

fuzz_target!(|bytes: &[u8]| {
    let Some((&role, rest)) = bytes.split_first() else {
        return;
    };
    let folder = place::folder();
    let file = folder.join(NAMES[usize::from(role) % NAMES.len()]);
    std::fs::write(&file, rest).expect("an input can be written");
    if let Err(error) = look_up_published(&folder, "A+0+1", "24400334") {
        assert!(!error.message.is_empty());
    }
    std::fs::remove_file(&file).expect("an input can be removed");
});
