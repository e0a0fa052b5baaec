//! A clip made here: a textured plate ("the robot") that slides past a wall, seen by two cameras that stand still, with its
//! maps and exact sidecars.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::disallowed_methods, dead_code)]

use std::path::Path;

use rogs_arrays::{NamedArray, npy_bytes, write_npz};
use rogs_schemas::pose::{Intrinsics, RigidPose};
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, DepthReference, RobotStates};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps};
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex};

pub(crate) const FRAMES: usize = 6;
pub(crate) const HEIGHT: usize = 26;
pub(crate) const WIDTH: usize = 40;
/// Focal length and principal point, pixels.
const FOCAL: f64 = 30.0;
const CENTRE: [f64; 2] = [20.0, 13.0];
/// Depth of the plate and of the wall, metres; the wall recedes to the right, so that its disparities differ.
const PLATE_M: f64 = 1.0;
const WALL_M: f64 = 2.0;
const WALL_SLOPE: f64 = 0.4;
/// Half the sides of the plate, metres.
const HALF_M: [f64; 2] = [0.28, 0.32];
/// The plate's step from frame to frame along x, metres.
pub(crate) const STEP_M: f64 = 0.04;
/// Metric depth of the sidecars is too small by this.
pub(crate) const FACTOR: f64 = 1.25;
/// Cameras by id and place along x, metres.
const CAMERAS: [(&str, f64); 2] = [("ext1", 0.0), ("ext2", 0.1)];

/// What a ray of a pixel hits: whether the plate, depth, and place on it.
fn hit(camera: usize, frame: usize, row: usize, column: usize) -> (bool, f64, [f64; 2]) {
    let ray = [
        (column as f64 + 0.5 - CENTRE[0]) / FOCAL,
        (row as f64 + 0.5 - CENTRE[1]) / FOCAL,
    ];
    let at = |depth: f64| [ray[0] * depth + CAMERAS[camera].1, ray[1] * depth];
    let [x, y] = at(PLATE_M);
    let own = [x - plate(frame), y];
    if own[0].abs() < HALF_M[0] && own[1].abs() < HALF_M[1] {
        (true, PLATE_M, own)
    } else {
        let depth = (WALL_M + WALL_SLOPE * CAMERAS[camera].1) / (1.0 - WALL_SLOPE * ray[0]);
        (false, depth, at(depth))
    }
}

/// Where the plate's middle is along x.
fn plate(frame: usize) -> f64 {
    STEP_M * (frame as f64 - 2.5)
}

fn colour(on_plate: bool, [x, y]: [f64; 2]) -> [u8; 3] {
    let wave = |value: f64| 0.5 + 0.4 * value.sin();
    let shown = if on_plate {
        [wave(9.0 * x), 0.25, wave(7.0 * y + 1.0)]
    } else {
        [0.3, wave(3.0 * x), wave(2.0 * y)]
    };
    shown.map(|value: f64| (255.0 * value).round() as u8)
}

fn pixels() -> impl Iterator<Item = (usize, usize)> {
    (0..HEIGHT).flat_map(|row| (0..WIDTH).map(move |column| (row, column)))
}

/// Exact depth of a camera at a frame.
fn depth(camera: usize, frame: usize) -> Vec<f32> {
    pixels()
        .map(|(row, column)| hit(camera, frame, row, column).1 as f32)
        .collect()
}

pub(crate) fn clip() -> (Clip, RobotMaps) {
    let pose = |camera: usize| RigidPose {
        translation: [CAMERAS[camera].1, 0.0, 0.0],
        ..RigidPose::IDENTITY
    };
    let frames = || 0..FRAMES;
    let camera = |camera: usize| ClipCamera {
        id: CAMERAS[camera].0.into(),
        role: CameraRole::Source,
        partner: None,
        intrinsics: Intrinsics {
            fx: FOCAL,
            fy: FOCAL,
            cx: CENTRE[0],
            cy: CENTRE[1],
        },
        mount: CameraMount::Fixed {
            base_from_camera: pose(camera),
        },
        recorded: Some(
            frames()
                .flat_map(|frame| pixels().map(move |(row, column)| (frame, row, column)))
                .flat_map(|(frame, row, column)| {
                    let (on_plate, _, place) = hit(camera, frame, row, column);
                    colour(on_plate, place)
                })
                .collect(),
        ),
        generated: None,
        depth: Some(DepthReference {
            depth_m: frames().flat_map(|frame| depth(camera, frame)).collect(),
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
        fps: 15.0,
        episode_frames: (0..FRAMES as u32).map(EpisodeFrame).collect(),
        source_frames: [0, 2, 4].map(FrameIndex).to_vec(),
        query_frames: vec![FrameIndex(3)],
        anchor_frame: FrameIndex(0),
        height: HEIGHT as u32,
        width: WIDTH as u32,
        cameras: (0..CAMERAS.len()).map(camera).collect(),
        robot: RobotStates {
            joint_names: vec![],
            positions: vec![],
            gripper: vec![0.0; FRAMES],
        },
        tracks: None,
        rollout: None,
    };
    let map = |camera: usize, frame: usize| {
        let hits: Vec<bool> = pixels()
            .map(|(row, column)| hit(camera, frame, row, column).0)
            .collect();
        RobotMap {
            camera: CameraIndex(camera as u32),
            frame: FrameIndex(frame as u32),
            depth_m: hits.iter().map(|&hit| if hit { PLATE_M as f32 } else { 0.0 }).collect(),
            link: hits.iter().map(|&hit| if hit { 0 } else { NO_LINK }).collect(),
            support: hits.iter().map(|&hit| u8::from(hit)).collect(),
        }
    };
    let robot = RobotMaps {
        clip_id: "clip".parse().unwrap(),
        link_names: vec!["base".into()],
        base_from_link: vec![RigidPose::IDENTITY; FRAMES],
        base_from_camera: (0..CAMERAS.len())
            .flat_map(|camera| vec![pose(camera); FRAMES])
            .collect(),
        recon_from_base: RigidPose::IDENTITY,
        tool_m: vec![0.0; 3 * FRAMES],
        height: HEIGHT as u32,
        width: WIDTH as u32,
        maps: (0..CAMERAS.len())
            .flat_map(|camera| frames().map(move |frame| map(camera, frame)))
            .collect(),
    };
    (clip, robot)
}

/// Writes the sidecars of the clip.
pub(crate) fn sidecars(folder: &Path) {
    for (camera, (id, place)) in CAMERAS.iter().enumerate() {
        let folder = folder.join(id);
        std::fs::create_dir_all(&folder).unwrap();
        let shape = [FRAMES, HEIGHT, WIDTH];
        let metric: Vec<f32> = (0..FRAMES)
            .flat_map(|frame| depth(camera, frame))
            .map(|depth| depth / FACTOR as f32)
            .collect();
        std::fs::write(folder.join("unidepth.npy"), npy_bytes(&shape, &metric)).unwrap();
        let relative: Vec<u16> = (0..FRAMES)
            .flat_map(|frame| depth(camera, frame))
            .map(|depth| ((1.0 / depth - 0.3) / 0.8 * 65_535.0).round() as u16)
            .collect();
        std::fs::write(folder.join("depth-anything.npy"), npy_bytes(&shape, &relative)).unwrap();
        let tracks = |query: usize| {
            let mut values = Vec::new();
            let grid = pixels().filter(|(row, column)| row % 4 == 0 && column % 4 == 0);
            for (row, column) in grid.filter(|&(row, column)| hit(camera, query, row, column).0) {
                for target in 0..FRAMES {
                    let x = column as f64 + FOCAL * (plate(target) - plate(query)) / PLATE_M;
                    let inside = x > -0.5 && x < WIDTH as f64 - 0.5;
                    let hidden = if inside { -8.0 } else { 8.0 };
                    values.extend([x as f32, row as f32, hidden, -8.0]);
                }
            }
            let shape = [values.len() / (4 * FRAMES), FRAMES, 4];
            NamedArray::new(&query.to_string(), &shape, &values)
        };
        let arrays: Vec<NamedArray> = (0..FRAMES).map(tracks).collect();
        write_npz(&folder.join("tracks.npz"), &arrays).unwrap();
        assert!(place.is_finite());
    }
}
