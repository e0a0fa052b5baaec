//! The conditioning maps against `project_fk_conditioning` of the Stage-1 reference vectors.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "../../../tests/support/tensors.rs"]
mod tensors;

use std::path::Path;

use rogs_conditioning::{Params, build};
use rogs_geometry::{Base, Camera, Link, Pose, Recon};
use rogs_robot_maps::{SupportRule, valid_support};
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, RobotStates, SourceView};
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps};
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex, Intrinsics, RigidPose};
use tensors::Tensors;

const H: usize = 28;
const W: usize = 42;
const AREA: usize = H * W;

fn golden() -> Tensors {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/golden/project_fk_conditioning.safetensors"
    );
    Tensors::read(Path::new(path))
}

/// The row-major 4x4 matrix at `index` of a stack, its translation divided by `scale`.
fn pose<A: rogs_geometry::Frame, B: rogs_geometry::Frame>(stack: &[f32], index: usize, scale: f64) -> Pose<A, B> {
    let m: [f64; 16] = std::array::from_fn(|entry| {
        f64::from(stack[index * 16 + entry]) / if entry % 4 == 3 && entry != 15 { scale } else { 1.0 }
    });
    Pose::<A, B>::from_matrix4(&m).unwrap().orthonormalized()
}

/// The golden scene as records: two cameras at two source times (frames 0 and 1), the query time is frame 2.
fn records(file: &Tensors) -> (Clip, RobotMaps) {
    let times = file.values("time_of_frame");
    let base = file.values("C_base_m");
    let cameras: Vec<Pose<Base, Camera>> = (0..4).map(|index| pose(base, index, 1.0)).collect();
    let recon_from_base: Pose<Recon, Base> = cameras[0].inverse().relabelled();
    let source = file.values("T_source_internal");
    let query = file.values("T_query_internal");
    let recon_from_link = |frame: usize, link: usize| -> Pose<Recon, Link> {
        if frame < 2 {
            pose(source, frame * 3 + link, 3.5)
        } else {
            pose(query, link, 3.5)
        }
    };
    let base_from_link = (0..3).flat_map(|frame| (0..3).map(move |link| (frame, link)));
    let base_from_link: Vec<RigidPose> = base_from_link
        .map(|(frame, link)| (recon_from_base.inverse() * recon_from_link(frame, link)).to_rigid())
        .collect();
    // Every golden frame is a camera of its own here, so that any order of frames fits the record.
    let fxfycxcy = file.values("fxfycxcy");
    let clip_camera = |index: usize| {
        let k: Vec<f64> = fxfycxcy[index * 4..index * 4 + 4]
            .iter()
            .map(|&value| f64::from(value))
            .collect();
        ClipCamera {
            id: format!("frame{index}"),
            role: CameraRole::Source,
            partner: None,
            intrinsics: Intrinsics {
                fx: k[0] * W as f64,
                fy: k[1] * H as f64,
                cx: k[2] * W as f64,
                cy: k[3] * H as f64,
            },
            mount: CameraMount::Fixed {
                base_from_camera: cameras[index].to_rigid(),
            },
            recorded: None,
            generated: None,
            depth: None,
        }
    };
    let clip = Clip {
        clip_id: "golden".parse().unwrap(),
        episode_id: "golden".into(),
        layout: "test".into(),
        task: String::new(),
        calibration_note: String::new(),
        fps: 1.0,
        episode_frames: [0, 1, 2].map(EpisodeFrame).to_vec(),
        source_frames: [0, 1].map(FrameIndex).to_vec(),
        query_frames: [2].map(FrameIndex).to_vec(),
        anchor_frame: FrameIndex(0),
        height: H as u32,
        width: W as u32,
        cameras: (0..4).map(clip_camera).collect(),
        robot: RobotStates {
            joint_names: vec![],
            positions: vec![],
            gripper: vec![0.0; 3],
        },
        tracks: None,
        rollout: None,
    };
    let (depth, link, support) = (
        file.values("mesh_depth_m"),
        file.values("link_id"),
        file.values("support"),
    );
    let map = |index: usize, frame: usize| {
        let range = index * AREA..(index + 1) * AREA;
        let link = link[range.clone()]
            .iter()
            .map(|&id| if (0.0..3.0).contains(&id) { id as u8 } else { NO_LINK });
        RobotMap {
            camera: CameraIndex(index as u32),
            frame: FrameIndex(frame as u32),
            depth_m: depth[range.clone()].to_vec(),
            link: link.collect(),
            support: support[range].iter().map(|&value| value as u8).collect(),
        }
    };
    // The file has the tool in the reconstruction frame, the record in the base frame.
    let tool = file.values("tool_centre_m");
    let tool_of = |frame: usize| {
        let in_recon = glam::Vec3::from_slice(&tool[frame.min(1) * 3..]).as_dvec3();
        recon_from_base.inverse().point(in_recon).to_array()
    };
    let robot = RobotMaps {
        clip_id: "golden".parse().unwrap(),
        link_names: ["a", "b", "c"].map(String::from).to_vec(),
        base_from_link,
        base_from_camera: (0..4).flat_map(|index| [cameras[index].to_rigid(); 3]).collect(),
        recon_from_base: recon_from_base.to_rigid(),
        tool_m: (0..3).flat_map(tool_of).collect(),
        height: H as u32,
        width: W as u32,
        maps: (0..4)
            .flat_map(|index| (0..2).map(move |frame| (index, frame)))
            .map(|(index, frame)| map(index, frame))
            .collect(),
    };
    assert_eq!(times.len(), 4);
    (clip, robot)
}

#[test]
fn kappa_agrees_channel_by_channel() {
    let file = golden();
    let (clip, robot) = records(&file);
    let conditioning = build(&clip, &robot, &Params::default()).unwrap();
    let times = file.values("time_of_frame");
    let kappa = file.values("kappa");
    let query = conditioning
        .query_frames
        .iter()
        .position(|&frame| frame == FrameIndex(2))
        .unwrap();
    for index in 0..4usize {
        let wanted = SourceView {
            camera: CameraIndex(index as u32),
            frame: FrameIndex(times[index] as u32),
        };
        let view = conditioning.views.iter().position(|view| *view == wanted).unwrap();
        let dense = conditioning.dense(view, query);
        let golden = &kappa[index * 7 * AREA..(index + 1) * 7 * AREA];
        for channel in 0..7 {
            let range = channel * AREA..(channel + 1) * AREA;
            let worst = dense[range.clone()]
                .iter()
                .zip(&golden[range])
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max);
            assert!(worst < 1e-5, "frame {index}, channel {channel}: {worst}");
        }
        let supported = golden[..AREA].iter().filter(|&&value| value == 1.0).count();
        assert!(supported > 50 && golden[2 * AREA..].iter().any(|value| value.abs() > 1e-3));
    }
}

#[test]
fn the_frame_convention_is_that_of_the_golden_poses() {
    let file = golden();
    let (_, robot) = records(&file);
    let golden = file.values("C_internal");
    let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&robot.recon_from_base).unwrap();
    for index in 0..4 {
        let base_from_camera: Pose<Base, Camera> = Pose::from_rigid(&robot.base_from_camera[index * 3]).unwrap();
        let matrix = (recon_from_base * base_from_camera).to_matrix4();
        for entry in 0..16 {
            let ours = matrix[entry] * if entry % 4 == 3 && entry != 15 { 3.5 } else { 1.0 };
            assert!((ours - f64::from(golden[index * 16 + entry])).abs() < 1e-5);
        }
    }
}

#[test]
fn support_is_the_eroded_coverage() {
    let file = golden();
    let (raw, support, depth) = (
        file.values("raw_support"),
        file.values("support"),
        file.values("mesh_depth_m"),
    );
    let rule = SupportRule {
        link_boundary_m: f32::INFINITY,
        ..SupportRule::default()
    };
    for index in 0..4 {
        let range = index * AREA..(index + 1) * AREA;
        let link: Vec<u8> = raw[range.clone()]
            .iter()
            .map(|&value| if value == 1.0 { 0 } else { NO_LINK })
            .collect();
        let ours = valid_support(&depth[range.clone()], &link, W as u32, H as u32, &rule);
        let golden: Vec<u8> = support[range].iter().map(|&value| value as u8).collect();
        assert_eq!(ours, golden);
    }
}

#[test]
fn a_link_that_stays_gives_zero_displacement() {
    let file = golden();
    let (clip, mut robot) = records(&file);
    let still: Vec<RigidPose> = robot.base_from_link[..3].to_vec();
    robot.base_from_link = still.repeat(3);
    let conditioning = build(&clip, &robot, &Params::default()).unwrap();
    assert!(
        conditioning
            .view_maps
            .iter()
            .flat_map(|maps| &maps.displacement_iu)
            .all(|&value| value == 0.0)
    );
}

#[test]
fn records_of_different_clips_are_refused() {
    let file = golden();
    let (clip, mut robot) = records(&file);
    robot.maps.remove(0);
    assert!(
        build(&clip, &robot, &Params::default())
            .unwrap_err()
            .message
            .contains("camera 0 at frame 0")
    );
    robot.clip_id = "other".parse().unwrap();
    assert!(
        build(&clip, &robot, &Params::default())
            .unwrap_err()
            .message
            .contains("`other`")
    );
}
