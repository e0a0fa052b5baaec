//! A small clip with its robot and its conditioning, made here.
#![allow(dead_code, reason = "each test file uses some of it")]

use rogs_lift::ClipInputs;
use rogs_schemas::pose::{Intrinsics, RigidPose};
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, RobotStates};
use rogs_schemas::records::conditioning::{Conditioning, GripperPrior, ViewConditioning};
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps};
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex};

pub(crate) const FRAMES: usize = 5;
/// Depth of the robot's pixels, which lie on link 1.
pub(crate) const MESH_DEPTH_M: f32 = 0.8;

pub(crate) struct Inputs {
    pub(crate) clip: Clip,
    pub(crate) robot: RobotMaps,
    pub(crate) conditioning: Conditioning,
}

impl Inputs {
    pub(crate) fn all(&self) -> ClipInputs<'_> {
        ClipInputs::new(&self.clip, &self.robot, &self.conditioning)
    }
}

/// Source frames 0 and 4 of some cameras in a row, with the robot at the same pixels of all images; link 1 moves 2 cm along
/// base x and turns per frame.
pub(crate) fn small_clip([rows, columns]: [usize; 2], cameras: &[&str], queries: &[u32], robot: &[u32]) -> Inputs {
    let area = rows * columns;
    let (height, width) = (rows as u32, columns as u32);
    let intrinsics = Intrinsics {
        fx: 30.0,
        fy: 30.0,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
    };
    let camera_pose = |camera: usize| RigidPose {
        translation: [0.3 * camera as f64, 0.0, 0.0],
        ..RigidPose::IDENTITY
    };
    let rgb = |camera: usize| {
        (0..FRAMES * area * 3)
            .map(|k| ((k * 31 + camera * 97) % 251) as u8)
            .collect()
    };
    let count = cameras.len();
    let cameras = cameras.iter().enumerate().map(|(index, &id)| ClipCamera {
        id: id.into(),
        role: CameraRole::Source,
        partner: None,
        intrinsics,
        mount: CameraMount::Fixed {
            base_from_camera: camera_pose(index),
        },
        recorded: Some(rgb(index)),
        generated: None,
        depth: None,
    });
    let clip = Clip {
        clip_id: "clip".parse().unwrap(),
        episode_id: "episode".into(),
        layout: "rogs-episode".into(),
        task: String::new(),
        calibration_note: String::new(),
        fps: 15.0,
        episode_frames: (0..FRAMES as u32).map(EpisodeFrame).collect(),
        source_frames: [0, 4].map(FrameIndex).to_vec(),
        query_frames: queries.iter().copied().map(FrameIndex).collect(),
        anchor_frame: FrameIndex(0),
        height,
        width,
        cameras: cameras.collect(),
        robot: RobotStates {
            joint_names: vec![],
            positions: vec![],
            gripper: vec![0.0; FRAMES],
        },
        tracks: None,
        rollout: None,
    };
    let link_pose = |frame: usize| {
        let (s, c) = (0.1 * frame as f64).sin_cos();
        RigidPose {
            rotation: [c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0],
            translation: [0.02 * frame as f64, 0.0, 0.0],
        }
    };
    let map = |camera: u32, frame: u32| {
        let mut map = RobotMap {
            camera: CameraIndex(camera),
            frame: FrameIndex(frame),
            depth_m: vec![0.0; area],
            link: vec![NO_LINK; area],
            support: vec![0; area],
        };
        for pixel in robot.iter().map(|&pixel| pixel as usize) {
            map.depth_m[pixel] = MESH_DEPTH_M;
            map.link[pixel] = 1;
            map.support[pixel] = 1;
        }
        map
    };
    let robot_maps = RobotMaps {
        clip_id: "clip".parse().unwrap(),
        link_names: vec!["base".into(), "arm".into()],
        base_from_link: (0..FRAMES)
            .flat_map(|frame| [RigidPose::IDENTITY, link_pose(frame)])
            .collect(),
        base_from_camera: (0..count)
            .flat_map(|camera| (0..FRAMES).map(move |_| camera_pose(camera)))
            .collect(),
        recon_from_base: RigidPose::IDENTITY,
        tool_m: vec![0.0; 3 * FRAMES],
        height,
        width,
        maps: (0..count as u32)
            .flat_map(|camera| (0..FRAMES as u32).map(move |frame| map(camera, frame)))
            .collect(),
    };
    let views = clip.source_views();
    let query_frames = clip.field_frames();
    let points = robot.len();
    let view_maps = views.iter().map(|view| ViewConditioning {
        pixels: robot.to_vec(),
        link: vec![1; points],
        depth_m: vec![MESH_DEPTH_M; points],
        displacement_iu: query_frames
            .iter()
            .flat_map(|&frame| {
                (0..points).flat_map(move |_| [0.07 * (frame.0 as f32 - view.frame.0 as f32), 0.01, 0.0])
            })
            .collect(),
        available: vec![1; query_frames.len()],
        prior: GripperPrior {
            centre_px: [f64::from(width) / 2.0 - 1.0, 14.0],
            depth_m: 0.8,
            focal_px: [30.0, 30.0],
            sigma_m: 0.1,
        },
    });
    let conditioning = Conditioning {
        clip_id: "clip".parse().unwrap(),
        height,
        width,
        view_maps: view_maps.collect(),
        views,
        query_frames,
    };
    Inputs {
        clip,
        robot: robot_maps,
        conditioning,
    }
}
