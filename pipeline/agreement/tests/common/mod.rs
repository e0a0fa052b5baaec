//! Procedural episodes with the robot drawn by the product's own rasteriser.

#![allow(dead_code, reason = "each test uses a part")]

use rogs_geometry::{Base, Camera, Link, Pinhole, Pose, PosedCamera};
use rogs_robot::{MeshImage, MeshScene, RenderOptions, RobotModel};
use rogs_schemas::records::robot::RobotSpec;
use rogs_synth::{
    ARM_JOINT_NAMES, Episode, ROBOT_SPEC_FILE, ROBOT_URDF_FILE, Robot, RobotState, SynthConfig, generate_episode,
    write_robot,
};

/// The robot of the generator as the product reads it.
pub(crate) struct Machine {
    pub(crate) model: RobotModel,
    pub(crate) spec: RobotSpec,
    pub(crate) scene: MeshScene,
}

impl Machine {
    pub(crate) fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_robot(&Robot::new(), folder.path()).unwrap();
        let spec = std::fs::read_to_string(folder.path().join(ROBOT_SPEC_FILE)).unwrap();
        let spec: RobotSpec = serde_json::from_str(&spec).unwrap();
        let model = RobotModel::load(&folder.path().join(ROBOT_URDF_FILE)).unwrap();
        let scene = MeshScene::of_robot(&model, &spec).unwrap();
        Self { model, spec, scene }
    }

    pub(crate) fn links(&self, state: &RobotState) -> Vec<Pose<Base, Link>> {
        let names: Vec<String> = ARM_JOINT_NAMES.map(str::to_owned).to_vec();
        let state = self
            .model
            .robot_state(&self.spec, &names, &state.joints, state.gripper)
            .unwrap();
        self.model.fk(&state)
    }

    pub(crate) fn draw(
        &self,
        lens: &Pinhole,
        base_from_camera: &Pose<Base, Camera>,
        links: &[Pose<Base, Link>],
    ) -> MeshImage {
        let camera_from_base = base_from_camera.inverse();
        let camera_from_link: Vec<_> = links.iter().map(|&link| camera_from_base * link).collect();
        self.scene
            .render(lens, &camera_from_link, &RenderOptions::default())
            .unwrap()
    }
}

pub(crate) fn episode(seed: u64) -> Episode {
    generate_episode(&SynthConfig::default(), seed).unwrap()
}

/// The camera of an episode at a frame.
pub(crate) fn camera(episode: &Episode, camera: usize, frame: usize) -> PosedCamera<Base> {
    PosedCamera::new(episode.cameras[camera].lens, episode.base_from_camera(camera, frame))
}
