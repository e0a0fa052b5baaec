use rogs_schemas::RigidPose;
use rogs_schemas::records::clip::{CameraMount, ClipCamera, DepthReference, RobotStates};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::robot::RobotMap;
use rogs_schemas::{EpisodeFrame, Intrinsics};

use super::*;

const WIDTH: u32 = 6;
const HEIGHT: u32 = 4;
const AREA: usize = 24;

fn pose(x: f64) -> RigidPose {
    let pose: Pose<Base, Camera> = Pose::from_xyz_euler([x, 0.2, 0.5], [2.0, 0.1, -0.4]);
    pose.to_rigid()
}

/// Two source cameras and one that is held out, three frames, of which 0 and 2 are sources.
pub(crate) fn clip() -> (Clip, RobotMaps) {
    let camera = |id: &str, role, depth: bool| ClipCamera {
        id: id.into(),
        role,
        partner: (role == CameraRole::Evaluation).then_some(CameraIndex(0)),
        intrinsics: Intrinsics {
            fx: 5.0,
            fy: 5.5,
            cx: 3.1,
            cy: 1.9,
        },
        mount: CameraMount::Fixed {
            base_from_camera: pose(0.1),
        },
        recorded: Some((0..3 * 3 * AREA).map(|value| (value * 7) as u8).collect()),
        generated: None,
        depth: depth.then(|| DepthReference {
            depth_m: (0..3 * AREA)
                .map(|pixel| {
                    if pixel % 5 == 0 {
                        f32::NAN
                    } else {
                        0.5 + 0.01 * pixel as f32
                    }
                })
                .collect(),
            range_m: [0.1, 5.0],
            origin: ReferenceOrigin::Exact,
        }),
    };
    let clip = Clip {
        clip_id: "clip".parse().unwrap(),
        episode_id: "episode".into(),
        layout: "rogs-episode".into(),
        task: String::new(),
        calibration_note: String::new(),
        fps: 10.0,
        episode_frames: (0..3).map(EpisodeFrame).collect(),
        source_frames: vec![FrameIndex(0), FrameIndex(2)],
        query_frames: vec![FrameIndex(1)],
        anchor_frame: FrameIndex(0),
        height: HEIGHT,
        width: WIDTH,
        cameras: vec![
            camera("wrist", CameraRole::Source, true),
            camera("ext1", CameraRole::Source, false),
            camera("ext1_right", CameraRole::Evaluation, false),
        ],
        robot: RobotStates {
            joint_names: Vec::new(),
            positions: Vec::new(),
            gripper: vec![0.0; 3],
        },
        tracks: None,
        rollout: None,
    };
    clip.check().unwrap();
    let map = |camera: u32, frame: u32| RobotMap {
        camera: CameraIndex(camera),
        frame: FrameIndex(frame),
        depth_m: (0..AREA).map(|pixel| if pixel < 3 { 0.7 } else { 0.0 }).collect(),
        link: (0..AREA).map(|pixel| if pixel < 3 { 0 } else { NO_LINK }).collect(),
        support: vec![0; AREA],
    };
    let robot = RobotMaps {
        clip_id: "clip".parse().unwrap(),
        link_names: vec!["base".into(), "hand".into()],
        base_from_link: (0..6).map(|k| pose(0.05 * f64::from(k))).collect(),
        base_from_camera: (0..9).map(|k| pose(0.01 * f64::from(k))).collect(),
        recon_from_base: {
            let pose: Pose<Base, Camera> = Pose::from_rigid(&pose(0.0)).unwrap();
            pose.inverse().to_rigid()
        },
        tool_m: vec![0.0; 9],
        height: HEIGHT,
        width: WIDTH,
        maps: (0..2)
            .flat_map(|camera| (0..3).map(move |frame| map(camera, frame)))
            .collect(),
    };
    robot.check().unwrap();
    (clip, robot)
}

fn all(axes: Axes, masks: Masks) -> Selection {
    Selection {
        axes,
        cameras: CameraIndex::first(3).collect(),
        frames: FrameIndex::first(3).collect(),
        masks,
    }
}

#[test]
fn what_the_field_is_made_from_is_for_training_and_the_rest_is_held_out() {
    let (clip, robot) = clip();
    let data = Dataset::new(&clip, &robot, &all(Axes::Base, Masks::Background)).unwrap();
    assert_eq!(data.views.len(), 9);
    let training: Vec<&str> = (data.views.iter().filter(|view| !view.held_out))
        .map(|view| view.name.as_str())
        .collect();
    assert_eq!(training, ["wrist_000000", "wrist_000002", "ext1_000000", "ext1_000002"]);
    let mask = data.views[0].mask.as_ref().unwrap();
    assert_eq!(mask[..4], [0, 0, 0, 255]);
    assert!(data.views[8].mask.is_none(), "no robot maps of held-out cameras");
    let robot_alone = Dataset::new(&clip, &robot, &all(Axes::Base, Masks::Robot)).unwrap();
    assert_eq!(robot_alone.views[0].mask.as_ref().unwrap()[..4], [255, 255, 255, 0]);
}

#[test]
fn points_lie_where_the_view_sees_them_and_frames_differ_by_the_pose_of_the_base() {
    let (clip, robot) = clip();
    let base = Dataset::new(&clip, &robot, &all(Axes::Base, Masks::None)).unwrap();
    let recon = Dataset::new(&clip, &robot, &all(Axes::Recon, Masks::None)).unwrap();
    // Four in five pixels of two training views of the camera with depth.
    assert_eq!(base.points.len(), 38);
    let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&robot.recon_from_base).unwrap();
    for (ours, theirs) in base.points.iter().zip(&recon.points) {
        let view = &base.views[ours.view];
        let seen = view.world_from_camera.inverse().point(ours.position_m.into());
        let (pixel, _) = view.lens.project(seen).unwrap();
        assert!((pixel - glam::DVec2::from_array(ours.pixel)).length() < 1e-9);
        let moved = recon_from_base.point(ours.position_m.into());
        assert!((moved - glam::DVec3::from_array(theirs.position_m)).length() < 1e-12);
    }
    // Without references the robot's mesh gives points.
    let mut bare = clip.clone();
    bare.cameras[0].depth = None;
    let meshed = Dataset::new(&bare, &robot, &all(Axes::Base, Masks::None)).unwrap();
    assert_eq!(meshed.points.len(), 4 * 3);
}

#[test]
fn a_nerfstudio_folder_says_what_the_views_are() {
    let (clip, robot) = clip();
    let data = Dataset::new(&clip, &robot, &all(Axes::Base, Masks::Background)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    write_nerfstudio(&data, &out).unwrap();
    let text = std::fs::read_to_string(out.join("transforms.json")).unwrap();
    let file: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(file["frames"].as_array().unwrap().len(), 9);
    assert_eq!(file["train_filenames"].as_array().unwrap().len(), 4);
    let frame = &file["frames"][1];
    // The camera looks along -z of the written pose.
    let flat: Vec<f64> = (frame["transform_matrix"].as_array().unwrap().iter())
        .flat_map(|row| row.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()))
        .collect();
    let forward = data.views[1].world_from_camera.direction(glam::DVec3::Z);
    for (row, value) in [flat[2], flat[6], flat[10]].into_iter().zip(forward.to_array()) {
        assert!((row + value).abs() < 1e-15);
    }
    let depth = image::open(out.join(frame["depth_file_path"].as_str().unwrap()))
        .unwrap()
        .into_luma16();
    assert_eq!(depth.as_raw()[2], ((0.5 + 0.26) * 1000.0_f64).round() as u16);
    assert_eq!(depth.as_raw()[1], 0, "NaN is 0");
    let mask = image::open(out.join(frame["mask_path"].as_str().unwrap()))
        .unwrap()
        .into_luma8();
    assert_eq!(mask.as_raw()[..4], [0, 0, 0, 255]);
    let rgb = image::open(out.join(frame["file_path"].as_str().unwrap()))
        .unwrap()
        .into_rgb8();
    assert_eq!(rgb.as_raw(), data.views[1].rgb);
    let cloud = std::fs::read(out.join("points3D.ply")).unwrap();
    let header = cloud.windows(11).position(|part| part == b"end_header\n").unwrap() + 11;
    assert_eq!(cloud.len() - header, 15 * data.points.len());
    assert!(write_nerfstudio(&data, &out).is_err(), "nothing is overwritten");
}

#[test]
fn a_colmap_model_has_the_numbers_of_the_views() {
    let (clip, robot) = clip();
    let data = Dataset::new(&clip, &robot, &all(Axes::Recon, Masks::None)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    write_colmap(&data, &out).unwrap();
    let read = |name: &str| std::fs::read(out.join(name)).unwrap();
    let cameras = read("sparse/0/cameras.bin");
    assert_eq!(cameras.len(), 8 + 3 * (4 + 4 + 8 + 8 + 32));
    let images = read("sparse/0/images.bin");
    assert_eq!(images[..12], [9, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]);
    let number = |at: usize| f64::from_le_bytes(images[at..at + 8].try_into().unwrap());
    let turn = glam::DQuat::from_xyzw(number(20), number(28), number(36), number(12));
    let shift = glam::DVec3::new(number(44), number(52), number(60));
    let world = glam::DVec3::new(0.3, -0.2, 0.9);
    let expected = data.views[0].world_from_camera.inverse().point(world);
    assert!((turn * world + shift - expected).length() < 1e-12);
    let points = read("sparse/0/points3D.bin");
    assert_eq!(points.len(), 8 + 38 * (8 + 24 + 3 + 8 + 8 + 8));
    let depth = read("depth_maps/wrist_000001.png.geometric.bin");
    assert_eq!((&depth[..6], depth.len()), (&b"6&4&1&"[..], 6 + 4 * AREA));
}

#[test]
fn nothing_selected_and_strange_maps_are_refused() {
    let (clip, mut robot) = clip();
    let mut none = all(Axes::Base, Masks::None);
    none.frames.clear();
    assert!(
        Dataset::new(&clip, &robot, &none)
            .unwrap_err()
            .to_string()
            .contains("no image")
    );
    robot.clip_id = "other".parse().unwrap();
    let error = Dataset::new(&clip, &robot, &all(Axes::Base, Masks::None)).unwrap_err();
    assert!(error.to_string().contains("`other`"), "{error}");
}
