//! Scenes of the viewer in the browser.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rogs_export::scene::Scene;

fuzz_target!(|bytes: &[u8]| match Scene::parse(bytes) {
    Ok(scene) => {
        let times = scene.head.times.len();
        let first = scene.gaussians(0).map(|gaussians| gaussians.len());
        assert!(first.is_some() && scene.gaussians(times - 1).map(|gaussians| gaussians.len()) == first);
    }
    Err(error) => assert!(!error.to_string().is_empty()),
});
