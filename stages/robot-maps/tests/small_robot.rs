//! Robot maps of a two-box robot that the test writes itself.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::Path;

use rogs_robot_maps::{Params, Robot, build};
use rogs_schemas::key::{KeyMaterial, Provenance};
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, DepthReference, RobotStates};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::robot::{NO_LINK, RobotMaps, RobotSpec};
use rogs_schemas::{EpisodeFrame, FrameIndex, Intrinsics, RigidPose};
use rogs_worker::{Observer, Unobserved};

const URDF: &str = r#"<robot name="boxes">
<link name="base"><visual><geometry><box size="0.2 0.2 0.2"/></geometry></visual></link>
<link name="arm"><visual><origin xyz="0 0 0.2"/><geometry><box size="0.1 0.1 0.4"/></geometry></visual></link>
<link name="finger"><visual><geometry><sphere radius="0.05"/></geometry></visual></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="arm"/><child link="finger"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.1" effort="1" velocity="1"/></joint></robot>"#;

const FRAMES: usize = 5;
const W: u32 = 64;
const H: u32 = 48;

/// Two metres in front of the robot, looking along -x of the base, image rows downwards.
const FRONT: RigidPose = RigidPose {
    rotation: [0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0],
    translation: [2.0, 0.0, 0.2],
};

fn params() -> Params {
    let robot = RobotSpec {
        base_link: "base".into(),
        gripper_joint: "slide".into(),
        gripper_closed: 0.1,
        gripper_open: 0.0,
        tool_link: "finger".into(),
        tool_offset_m: [0.0, 0.0, 0.05],
        exclude_links: Vec::new(),
        collision_links: Vec::new(),
        ..RobotSpec::default()
    };
    Params {
        robot,
        ..Params::default()
    }
}

fn robot(folder: &Path) -> Robot {
    let path = folder.join("boxes.urdf");
    std::fs::write(&path, URDF).unwrap();
    Robot::load(&path, &params()).unwrap()
}

fn clip() -> Clip {
    let camera = |id: &str, role, mount| ClipCamera {
        id: id.into(),
        role,
        partner: None,
        intrinsics: Intrinsics {
            fx: 60.0,
            fy: 60.0,
            cx: 32.0,
            cy: 24.0,
        },
        mount,
        recorded: None,
        generated: None,
        depth: None,
    };
    let on_arm = RigidPose {
        translation: [0.3, 0.0, 0.0],
        ..RigidPose::IDENTITY
    };
    Clip {
        clip_id: "boxes".parse().unwrap(),
        episode_id: "boxes".into(),
        layout: "test".into(),
        task: String::new(),
        calibration_note: String::new(),
        fps: 5.0,
        episode_frames: (0..FRAMES as u32).map(EpisodeFrame).collect(),
        source_frames: [1, 3].map(FrameIndex).to_vec(),
        query_frames: [0, 2, 4].map(FrameIndex).to_vec(),
        anchor_frame: FrameIndex(0),
        height: H,
        width: W,
        cameras: vec![
            camera(
                "wrist",
                CameraRole::Source,
                CameraMount::HandEye {
                    link: "arm".into(),
                    link_from_camera: on_arm,
                },
            ),
            camera(
                "front",
                CameraRole::Source,
                CameraMount::Fixed {
                    base_from_camera: FRONT,
                },
            ),
            camera(
                "moving",
                CameraRole::Evaluation,
                CameraMount::Trajectory {
                    base_from_camera: vec![FRONT; FRAMES],
                },
            ),
        ],
        robot: RobotStates {
            joint_names: vec!["turn".into()],
            positions: (0..FRAMES).map(|frame| frame as f64 * 0.2).collect(),
            gripper: vec![0.5; FRAMES],
        },
        tracks: None,
        rollout: None,
    }
}

fn build_it(clip: &Clip) -> Result<(RobotMaps, Vec<String>), String> {
    let folder = tempfile::tempdir().unwrap();
    let mut warnings = Warnings::default();
    let maps = build(clip, &robot(folder.path()), &params(), &mut warnings);
    maps.map(|maps| (maps, warnings.0)).map_err(|error| error.message)
}

#[derive(Default)]
struct Warnings(Vec<String>);

impl Observer for Warnings {
    fn warn(&mut self, warning: String) {
        self.0.push(warning);
    }
}

#[test]
fn maps_cover_every_source_camera_and_frame() {
    let (maps, warnings) = build_it(&clip()).unwrap();
    assert!(warnings.is_empty());
    let order: Vec<(u32, u32)> = maps.maps.iter().map(|map| (map.camera.0, map.frame.0)).collect();
    let expected: Vec<(u32, u32)> = (0..2)
        .flat_map(|camera| (0..FRAMES as u32).map(move |frame| (camera, frame)))
        .collect();
    assert_eq!(order, expected);
    assert_eq!(maps.base_from_camera.len(), 3 * FRAMES);
    assert_eq!(maps.link_names, ["base", "arm", "finger"]);
    // The front camera sees the near face of the upright arm, 5 cm in front of the axis, at the principal point.
    let upright = &maps.maps[FRAMES];
    let pixel = (23 * W + 32) as usize;
    assert_eq!(upright.link[pixel], 1);
    assert!((upright.depth_m[pixel] - 1.95).abs() < 1e-6);
    assert_eq!(upright.support[pixel], 1);
    assert_eq!(
        (upright.link[0], upright.depth_m[0], upright.support[0]),
        (NO_LINK, 0.0, 0)
    );
}

#[test]
fn the_tool_and_the_reconstruction_frame_follow_forward_kinematics() {
    let (maps, _) = build_it(&clip()).unwrap();
    // Joint at 0.1 m height; the finger slides out by half of 0.1 m; the tool lies 0.05 m beyond it.
    let angle = 2.0f64 * 0.2;
    let length = 0.4 + 0.05 + 0.05;
    let expected = [length * angle.sin(), 0.0, 0.1 + length * angle.cos()];
    assert!(
        maps.tool_m[6..9]
            .iter()
            .zip(expected)
            .all(|(a, b)| (a - b).abs() < 1e-12),
        "{:?}",
        &maps.tool_m[6..9]
    );
    // The first source camera at the first source frame (1): turned by 0.2 about y, 0.3 m along the turned x.
    let turn = 0.2f64;
    let centre = maps.base_from_camera[1].translation;
    assert!((centre[0] - 0.3 * turn.cos()).abs() < 1e-12 && (centre[2] - (0.1 - 0.3 * turn.sin())).abs() < 1e-12);
    let inverse = &maps.recon_from_base;
    let origin: Vec<f64> = (0..3)
        .map(|row| (0..3).map(|k| inverse.rotation[row * 3 + k] * centre[k]).sum::<f64>() + inverse.translation[row])
        .collect();
    assert!(origin.iter().all(|value| value.abs() < 1e-12));
}

#[test]
fn joints_beyond_their_limits_are_counted() {
    let mut clip = clip();
    clip.robot.positions = vec![0.0, 0.5, 1.1, 1.2, 0.9];
    let (_, warnings) = build_it(&clip).unwrap();
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].contains("`turn`") && warnings[0].contains("2 of 5 frames") && warnings[0].contains("1.2000"));
}

#[test]
fn wrong_states_and_names_say_where() {
    let mut wrong = clip();
    wrong.robot.positions[2] = f64::NAN;
    assert!(build_it(&wrong).unwrap_err().contains("frame 2"));
    wrong = clip();
    wrong.robot.gripper[4] = 1.5;
    assert!(
        build_it(&wrong)
            .unwrap_err()
            .contains("frame 4: joint `slide`: the gripper state is 1.5")
    );
    wrong = clip();
    wrong.robot.joint_names = vec!["turm".into()];
    assert!(build_it(&wrong).unwrap_err().contains("did you mean `turn`?"));
    wrong = clip();
    wrong.cameras[2].mount = CameraMount::Trajectory {
        base_from_camera: vec![FRONT; 3],
    };
    assert!(
        build_it(&wrong)
            .unwrap_err()
            .contains("camera `moving` has 3 poses for 5 frames")
    );
    wrong = clip();
    wrong.cameras[1].mount = CameraMount::Fixed {
        base_from_camera: RigidPose {
            rotation: [1.1; 9],
            ..FRONT
        },
    };
    assert!(
        build_it(&wrong)
            .unwrap_err()
            .contains("camera `front`: not a rigid transform")
    );
    let folder = tempfile::tempdir().unwrap();
    robot(folder.path());
    let mut misspelt = params();
    misspelt.robot.tool_link = "fingers".into();
    let error = Robot::load(&folder.path().join("boxes.urdf"), &misspelt).unwrap_err();
    assert!(error.message.contains("did you mean `finger`?"), "{}", error.message);
    // The table of the manifest from which `rogs` fills in the parameter `robot`.
    let hint = error.hint.unwrap();
    assert!(hint.contains("under [robot.spec] of the manifest"), "{hint}");
    // Of another robot several names are missing, and all are told.
    let another = Params::default();
    let error = Robot::load(&folder.path().join("boxes.urdf"), &another).unwrap_err();
    for key in ["`base_link`", "`tool_link`", "`gripper_joint`"] {
        assert!(error.message.contains(key), "{}", error.message);
    }
}

#[test]
fn the_record_survives_its_file() {
    let (maps, _) = build_it(&clip()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let material = KeyMaterial {
        stage: "robot-maps".into(),
        stage_version: 1,
        schema: "rogs.robot 1.0".into(),
        params: "{}".into(),
        inputs: Default::default(),
    };
    let provenance = Provenance {
        material,
        input_content: Default::default(),
    };
    let path = folder.path().join("robot.r4c");
    rogs_r4c::write_record(&path, &maps, &provenance).unwrap();
    let (read, _) = rogs_r4c::read_record::<RobotMaps>(&path).unwrap();
    assert_eq!(read, maps);
}

#[test]
fn one_thread_and_many_give_the_same_maps() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, clip) = (robot(folder.path()), clip());
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| build(&clip, &robot, &params(), &mut Unobserved).unwrap())
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn reference_depth_in_another_unit_is_told_by_its_factor() {
    let (maps, _) = build_it(&clip()).unwrap();
    let pixels = (W * H) as usize;
    for (factor, words) in [
        (1.0, None),
        (1.02, None),
        (1000.0, Some("millimetres instead of metres")),
        (0.001, Some("divided by 1000 once too often")),
        (5.0, Some("5000 steps a metre")),
        (10.0, Some("10000 steps a metre")),
        (100.0, Some("centimetres")),
        (0.5, None),
        (3.5, Some("is their unit another")),
    ] {
        let mut clip = clip();
        // The front camera's maps, each pixel as many times too far; nothing is known beside the robot.
        let depth_m = maps.maps[FRAMES..].iter().flat_map(|map| &map.depth_m);
        let depth_m = depth_m.map(|&depth| if depth > 0.0 { depth * factor } else { f32::NAN });
        clip.cameras[1].depth = Some(DepthReference {
            depth_m: depth_m.collect(),
            range_m: [0.1, 5.0],
            origin: ReferenceOrigin::DepthCamera,
        });
        assert_eq!(
            maps.maps[FRAMES..].len() * pixels,
            clip.cameras[1].depth.as_ref().unwrap().depth_m.len()
        );
        let (_, warnings) = build_it(&clip).unwrap();
        match words {
            None => assert!(warnings.is_empty(), "{warnings:?}"),
            Some(words) => assert!(
                warnings.len() == 1 && warnings[0].contains("`front`") && warnings[0].contains(words),
                "{factor}: {warnings:?}"
            ),
        }
    }
}

#[test]
fn what_a_robot_leaves_open_is_told_for_every_clip() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("boxes.urdf");
    std::fs::write(&path, URDF.replacen("<link", "<unheard_of/><link", 1)).unwrap();
    let robot = Robot::load(&path, &params()).unwrap();
    for _ in 0..2 {
        let mut warnings = Warnings::default();
        build(&clip(), &robot, &params(), &mut warnings).unwrap();
        assert!(
            warnings.0.len() == 1 && warnings.0[0].contains("`unheard_of`"),
            "{:?}",
            warnings.0
        );
    }
}
