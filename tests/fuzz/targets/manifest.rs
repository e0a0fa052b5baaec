//! Run manifests.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use rogs_orchestrator::manifest::Manifest;

fuzz_target!(|bytes: &[u8]| {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return;
    };
    match Manifest::parse(text, Path::new("m.toml"), Path::new("/nowhere")) {
        Ok((manifest, _)) => {
            let _ = manifest.robot_spec();
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
