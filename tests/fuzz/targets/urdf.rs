//! Robots: a URDF that loads must give finite link poses.
#![no_main]

#[path = "common/place.rs"]
mod place;

use libfuzzer_sys::fuzz_target;
use rogs_robot::{MeshScene, RobotModel};
use rogs_schemas::records::robot::RobotSpec;

fuzz_target!(|bytes: &[u8]| {
    let path = place::file("urdf", bytes);
    let model = match RobotModel::load(&path) {
        Ok(model) => model,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return;
        }
    };
    let names = model.link_names();
    assert!(model.root_link() < names.len() && model.base_link() < names.len());
    if let Ok(state) = model.joint_state(std::iter::empty::<(&str, f64)>()) {
        assert_eq!(model.fk(&state).len(), names.len());
    }
    let _ = MeshScene::of_robot(&model, &RobotSpec::default());
});
