//! The stage on small clips made here: what a field contains, what is refused, same bytes for any number of threads.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use rogs_lift_4dgt::{Configuration, InputFrames, Lift4dgtParams, Model, OnlySeeded, lift_clip, load_model};
use rogs_schemas::pose::{Intrinsics, RigidPose};
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, RobotStates, SourceView};
use rogs_schemas::records::polynomial::PolynomialField;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex};
use rogs_worker::Unobserved;

const FRAMES: usize = 5;
const SIZE: [usize; 2] = [24, 40];

/// Two fixed cameras that look along base z from different places.
fn clip() -> (Clip, RobotMaps) {
    let pose = |camera: usize| RigidPose {
        translation: [0.4 * camera as f64 - 0.1, 0.2, -1.0],
        ..RigidPose::IDENTITY
    };
    let camera = |(index, id): (usize, &str)| ClipCamera {
        id: id.into(),
        role: CameraRole::Source,
        partner: None,
        intrinsics: Intrinsics {
            fx: 30.0,
            fy: 30.0,
            cx: 20.0,
            cy: 12.0,
        },
        mount: CameraMount::Fixed {
            base_from_camera: pose(index),
        },
        recorded: Some(
            (0..FRAMES * SIZE[0] * SIZE[1] * 3)
                .map(|k| ((k * 31 + index * 97) % 251) as u8)
                .collect(),
        ),
        generated: None,
        depth: None,
    };
    let clip = Clip {
        clip_id: "clip".parse().unwrap(),
        episode_id: "episode".into(),
        layout: "rogs-episode".into(),
        task: String::new(),
        calibration_note: String::new(),
        fps: 10.0,
        episode_frames: (0..FRAMES as u32).map(EpisodeFrame).collect(),
        source_frames: [1, 4].map(FrameIndex).to_vec(),
        query_frames: vec![FrameIndex(2)],
        anchor_frame: FrameIndex(1),
        height: SIZE[0] as u32,
        width: SIZE[1] as u32,
        cameras: ["ext1", "ext2"].into_iter().enumerate().map(camera).collect(),
        robot: RobotStates {
            joint_names: vec![],
            positions: vec![],
            gripper: vec![0.0; FRAMES],
        },
        tracks: None,
        rollout: None,
    };
    let robot = RobotMaps {
        clip_id: "clip".parse().unwrap(),
        link_names: vec!["base".into()],
        base_from_link: vec![RigidPose::IDENTITY; FRAMES],
        base_from_camera: (0..2).flat_map(|camera| vec![pose(camera); FRAMES]).collect(),
        recon_from_base: RigidPose::IDENTITY,
        tool_m: vec![0.0; 3 * FRAMES],
        height: SIZE[0] as u32,
        width: SIZE[1] as u32,
        maps: Vec::new(),
    };
    (clip, robot)
}

fn params() -> Lift4dgtParams {
    Lift4dgtParams {
        frames: InputFrames::Source,
        height: 28,
        width: 42,
        configuration: Configuration::Compact,
        weights: Some(OnlySeeded),
        encoder: Some(OnlySeeded),
        ..Lift4dgtParams::default()
    }
}

fn model() -> Model {
    load_model(&params(), None, None).unwrap()
}

fn lift(model: &Model, params: &Lift4dgtParams, clip: &(Clip, RobotMaps)) -> PolynomialField {
    lift_clip(model, params, &clip.0, &clip.1, &mut Unobserved).unwrap()
}

#[test]
fn every_pixel_of_every_frame_is_a_gaussian_in_front_of_its_camera() {
    let (model, clip) = (model(), clip());
    let field = lift(&model, &params(), &clip);
    field.check().unwrap();
    let view = |camera, frame| SourceView {
        camera: CameraIndex(camera),
        frame: FrameIndex(frame),
    };
    assert_eq!(field.views, [view(0, 1), view(0, 4), view(1, 1), view(1, 4)]);
    assert_eq!(field.gaussians.len(), 4 * 28 * 42);
    assert!(field.weights.len() == 2 && field.weights.iter().all(|info| !info.trained));
    let area = 28 * 42;
    for (index, view) in field.views.iter().enumerate() {
        let x = 0.4 * view.camera.0 as f32 - 0.1;
        let seconds = view.frame.0 as f32 / 10.0;
        for row in index * area..(index + 1) * area {
            let centre = &field.gaussians.centre_m[row * 3..row * 3 + 3];
            // Seeded heads say about 0: 0.9 m along the axis, and offsets of less than half a metre and half a second.
            assert!(
                (centre[2] + 0.1).abs() < 1.0 && (centre[0] - x).abs() < 1.6,
                "{centre:?}"
            );
            assert!((field.gaussians.time_s[row] - seconds).abs() <= 0.5);
            let q = &field.gaussians.rotation[row * 4..row * 4 + 4];
            assert!((q.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-3);
        }
    }
}

#[test]
fn where_the_base_stands_moves_the_field_with_it_but_for_the_mean_frame() {
    // A camera at the base's origin has no point of attention: it is recentred to itself, wherever the base is turned.
    let (model, (mut clip, mut robot)) = (model(), clip());
    clip.cameras.truncate(1);
    let turned = RigidPose {
        rotation: [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
    };
    let mut fields = Vec::new();
    for pose in [RigidPose::IDENTITY, turned] {
        robot.base_from_camera = vec![pose; FRAMES];
        fields.push(
            lift_clip(&model, &params(), &clip, &robot, &mut Unobserved)
                .unwrap()
                .gaussians,
        );
    }
    for (a, b) in fields[0]
        .centre_m
        .chunks_exact(3)
        .zip(fields[1].centre_m.chunks_exact(3))
    {
        let expected = [-a[1], a[0], a[2]];
        assert!(
            b.iter().zip(expected).all(|(b, a)| (b - a).abs() < 1e-5),
            "{b:?} {expected:?}"
        );
    }
}

#[test]
fn what_is_missing_is_named() {
    let (model, (mut clip, robot)) = (model(), clip());
    clip.cameras[1].recorded = None;
    let error = lift_clip(&model, &params(), &clip, &robot, &mut Unobserved).unwrap_err();
    assert!(
        error.message.contains("no image of camera `ext2` at clip frame 1"),
        "{}",
        error.message
    );
    let error = load_model(&Lift4dgtParams::default(), None, None).err().unwrap();
    assert!(
        error.message.contains("4DGT has no weights in this program"),
        "{}",
        error.message
    );
    assert!(error.hint.unwrap().contains("4dgt = \"FILE\""));
}

#[test]
fn a_field_does_not_depend_on_the_number_of_threads() {
    let (model, clip) = (model(), clip());
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| lift(&model, &params(), &clip))
    };
    assert_eq!(with(1), with(4));
}
