//! The written robot model, read by the kinematics and the mesh rasteriser of the product, is the rendered robot.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use rogs_geometry::{Camera, Link, Pose};
use rogs_robot::{MeshScene, RenderOptions, RobotModel};
use rogs_schemas::records::robot::{NO_LINK, RobotSpec};
use rogs_synth::{
    ARM_JOINT_NAMES, Action, FIRST_OBJECT_ID, ROBOT_SPEC_FILE, ROBOT_URDF_FILE, Robot, SynthConfig, generate_episode,
    write_robot,
};

struct Written {
    /// Removed when dropped; meshes are read from it.
    folder: tempfile::TempDir,
    model: RobotModel,
    spec: RobotSpec,
}

fn written() -> Written {
    let folder = tempfile::tempdir().unwrap();
    write_robot(&Robot::new(), folder.path()).unwrap();
    let spec = std::fs::read_to_string(folder.path().join(ROBOT_SPEC_FILE)).unwrap();
    let spec: RobotSpec = serde_json::from_str(&spec).unwrap();
    let model = RobotModel::load(&folder.path().join(ROBOT_URDF_FILE)).unwrap();
    Written { folder, model, spec }
}

#[test]
fn forward_kinematics_of_the_urdf_is_that_of_the_generator() {
    let Written { model, spec, .. } = written();
    let robot = Robot::new();
    let episode = generate_episode(
        &SynthConfig {
            action: Some(Action::Grasp),
            ..SynthConfig::default()
        },
        17,
    )
    .unwrap();
    assert_eq!(model.link_names().len(), robot.link_names().len());
    let names: Vec<String> = ARM_JOINT_NAMES.map(str::to_owned).to_vec();
    for state in episode.states.iter().step_by(4) {
        let read = model.robot_state(&spec, &names, &state.joints, state.gripper).unwrap();
        assert!(model.limit_excesses(&read).is_empty());
        let poses = model.fk(&read);
        for (link, own) in robot.link_names().iter().zip(robot.fk(state)) {
            let pose = &poses[model.link_id(link).unwrap()];
            assert!((pose.translation - own.translation).length() < 1e-9, "{link}");
            assert!(pose.rotation.abs_diff_eq(own.rotation, 1e-9), "{link}");
        }
    }
}

#[test]
fn mesh_depth_of_the_written_robot_is_the_depth_of_the_picture() {
    let Written { model, spec, folder } = written();
    let scene = MeshScene::of_robot(&model, &spec).unwrap();
    drop(folder);
    let episode = generate_episode(&SynthConfig::default(), 21).unwrap();
    let names: Vec<String> = ARM_JOINT_NAMES.map(str::to_owned).to_vec();
    let own_id: Vec<u8> = {
        let own = Robot::new().link_names();
        let id = |name: &String| own.iter().position(|other| other == name).unwrap() as u8;
        model.link_names().iter().map(id).collect()
    };
    for frame in [0, 16, 32] {
        let state = episode.states[frame];
        let poses = model.fk(&model.robot_state(&spec, &names, &state.joints, state.gripper).unwrap());
        let views = episode.render_frame(frame).views;
        for (camera, view) in views.iter().enumerate() {
            let lens = &episode.cameras[camera].lens;
            let camera_from_base = episode.base_from_camera(camera, frame).inverse();
            let camera_from_link: Vec<Pose<Camera, Link>> = poses.iter().map(|&pose| camera_from_base * pose).collect();
            let mesh = scene
                .render(lens, &camera_from_link, &RenderOptions::default())
                .unwrap();
            let (mut robot, mut off, mut missed) = (0, 0, 0);
            for pixel in 0..view.id.len() {
                if view.id[pixel] >= FIRST_OBJECT_ID {
                    continue;
                }
                robot += 1;
                if mesh.link[pixel] == NO_LINK {
                    missed += 1;
                } else if own_id[mesh.link[pixel] as usize] != view.id[pixel]
                    || (mesh.depth_m[pixel] - view.depth_m[pixel]).abs() > 1e-4
                {
                    off += 1;
                }
            }
            assert!(robot > 300, "camera {camera} frame {frame}: {robot}");
            // Samples on shared edges may go to either side, and equal depths to either link.
            assert!(
                (off + missed) * 500 < robot,
                "camera {camera} frame {frame}: {off} off, {missed} missed of {robot}"
            );
        }
    }
}
