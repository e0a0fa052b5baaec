//! Camera paths of nerfstudio's viewer.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use rogs_export::nerfstudio::viewer_path;

fuzz_target!(|bytes: &[u8]| {
    let Ok(value) = serde_json::from_slice(bytes) else {
        return;
    };
    match viewer_path(Path::new("camera_path.json"), value) {
        Ok(found) => {
            let last = found.path.at(1.0);
            assert!(last.lens.is_valid() && last.world_from_camera.check_rigid().is_ok());
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
