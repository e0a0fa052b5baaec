//! References of a procedural clip beside its exact ones, and what is said of clips that cannot have any.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::sync::OnceLock;

use glam::DVec3;
use rogs_geometry::PosedCamera;
use rogs_references::{Params, TrackParams, When, build};
use rogs_robot_maps::Robot;
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip};
use rogs_schemas::records::origin::{ReferenceKind, ReferenceOrigin};
use rogs_schemas::records::references::References;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex};
use rogs_synth::{ROBOT_SPEC_FILE, SynthConfig, write_dataset};
use rogs_worker::{Observer, Unobserved};

const FRAMES: u32 = 9;

/// A clip of a procedural episode with exact references, and its robot maps.
fn scene() -> &'static (Clip, RobotMaps) {
    static SCENE: OnceLock<(Clip, RobotMaps)> = OnceLock::new();
    SCENE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let config = SynthConfig {
            frames: FRAMES,
            ..SynthConfig::default()
        };
        let made = write_dataset(folder.path(), 1, 501, &config).unwrap();
        let params = rogs_ingest::Params {
            frames: FRAMES,
            start_frame: Some(EpisodeFrame(0)),
            source_frames: vec![FrameIndex(0), FrameIndex(8)],
            query: rogs_ingest::QueryChoice::Frames(vec![FrameIndex(4), FrameIndex(8)]),
            ..rogs_ingest::Params::default()
        };
        let (clip, _) = rogs_ingest::read_clip(&made.episodes[0], None, &params, "procedural").unwrap();
        let spec = made.robot.with_file_name(ROBOT_SPEC_FILE);
        let params = rogs_robot_maps::Params {
            robot: serde_json::from_slice(&std::fs::read(spec).unwrap()).unwrap(),
            ..rogs_robot_maps::Params::default()
        };
        let robot = Robot::load(&made.robot, &params).unwrap();
        let maps = rogs_robot_maps::build(&clip, &robot, &params, &mut Unobserved).unwrap();
        (clip, maps)
    })
}

fn always() -> Params {
    Params {
        depth: When::Always,
        tracks: When::Always,
        ..Params::default()
    }
}

fn made(clip: &Clip, params: &Params) -> References {
    let references = build(clip, &scene().1, params, &mut Unobserved).unwrap();
    references.check().unwrap();
    references
}

#[test]
fn exact_references_win_unless_the_parameters_say_otherwise() {
    let (clip, _) = scene();
    for params in [
        Params::default(),
        Params {
            depth: When::Never,
            tracks: When::Never,
            ..Params::default()
        },
    ] {
        let references = made(clip, &params);
        assert!(references.depth.is_empty() && references.tracks.is_none() && references.notes.is_empty());
        let mut completed = clip.clone();
        references.complete(&mut completed).unwrap();
        assert!(
            completed
                .references()
                .iter()
                .all(|used| used.origin == ReferenceOrigin::Exact)
        );
    }
}

/// Only the camera that lacks depth gets some; the other eye keeps its own.
#[test]
fn what_is_missing_is_made_and_says_so() {
    let mut clip = scene().0.clone();
    clip.cameras[1].depth = None;
    clip.tracks = None;
    let references = made(&clip, &Params::default());
    assert_eq!(
        references.depth.iter().map(|made| made.camera).collect::<Vec<_>>(),
        [CameraIndex(1)]
    );
    references.complete(&mut clip).unwrap();
    for used in clip.references() {
        let expected = match (used.kind, used.camera.as_str()) {
            (ReferenceKind::Tracks, _) => ReferenceOrigin::Kinematics,
            (ReferenceKind::Depth, "ext1") => ReferenceOrigin::ClassicalStereo,
            (ReferenceKind::Depth, _) => ReferenceOrigin::Exact,
        };
        assert_eq!(used.origin, expected, "{used:?}");
    }
    clip.check().unwrap();
}

#[test]
fn stereo_depth_of_both_eyes_comes_near_the_exact_one() {
    let (clip, _) = scene();
    let references = made(clip, &always());
    assert_eq!(references.frames, [0, 4, 8].map(FrameIndex));
    assert_eq!(references.depth.len(), 6, "three left and three right eyes");
    let area = (clip.height * clip.width) as usize;
    for depth in &references.depth {
        assert_eq!(depth.origin, ReferenceOrigin::ClassicalStereo);
        let camera = &clip.cameras[depth.camera.at()];
        let exact = &camera.depth.as_ref().unwrap().depth_m;
        let (mut errors, mut known) = (vec![], 0);
        for (number, &frame) in references.frames.iter().enumerate() {
            for at in 0..area {
                let truth = exact[frame.at() * area + at];
                let found = depth.depth_m[number * area + at];
                if truth > 0.1 && truth < 5.0 {
                    known += 1;
                    if found.is_finite() {
                        errors.push((found - truth).abs() / truth);
                    }
                }
            }
        }
        errors.sort_unstable_by(f32::total_cmp);
        let coverage = errors.len() as f64 / f64::from(known);
        let median = errors[errors.len() / 2];
        println!("{}: coverage {coverage:.3}, median AbsRel {median:.4}", camera.id);
        assert!(coverage > 0.35 && median < 0.04, "{}: {coverage}, {median}", camera.id);
    }
}

/// Points of the mesh lie on the exact surface when they are anchored, and still do wherever they count as visible: another
/// renderer with a kinematics of its own says so.
#[test]
fn tracks_follow_the_robot() {
    let (clip, robot) = scene();
    let tracks = made(clip, &always()).tracks.unwrap();
    let (frames, area) = (clip.frame_count(), (clip.height * clip.width) as usize);
    assert_eq!(
        (tracks.origin, tracks.anchor_frame),
        (ReferenceOrigin::Kinematics, clip.anchor_frame)
    );
    assert!(tracks.camera.len() > 100, "{} tracks", tracks.camera.len());
    let (mut moved, mut checked, mut off, mut hidden) = (0.0f32, 0, 0, 0);
    for track in 0..tracks.camera.len() {
        let camera = tracks.camera[track];
        let exact = &clip.cameras[camera.at()].depth.as_ref().unwrap().depth_m;
        let position = |frame: usize| {
            let at = 3 * (track * frames + frame);
            DVec3::from_array([0, 1, 2].map(|axis| f64::from(tracks.position_m[at + axis])))
        };
        moved = moved.max((position(frames - 1) - position(0)).length() as f32);
        for frame in 0..frames {
            if tracks.visible[track * frames + frame] == 0 {
                hidden += 1;
                continue;
            }
            let view = PosedCamera::of_clip(clip, robot, camera, FrameIndex(frame as u32)).unwrap();
            let (place, depth) = view
                .lens
                .project(view.world_from_camera.inverse().point(position(frame)))
                .unwrap();
            let pixel = place.y as usize * clip.width as usize + place.x as usize;
            let truth = f64::from(exact[frame * area + pixel]);
            checked += 1;
            off += usize::from((truth - depth).abs() > 0.01);
        }
    }
    assert!(moved > 0.02, "the robot moves by {moved} m");
    assert!(hidden < checked / 4, "{hidden} hidden, {checked} visible");
    // What an object hides, and edges, where the nearest pixel is another surface's.
    assert!(
        off * 20 < checked,
        "{off} of {checked} points lie off the exact surface"
    );
}

#[test]
fn tracks_are_as_many_as_asked_for_at_most() {
    let (clip, _) = scene();
    let few = Params {
        robot: TrackParams {
            spacing_px: 1,
            most_per_camera: 40,
            ..TrackParams::default()
        },
        ..always()
    };
    let tracks = made(clip, &few).tracks.unwrap();
    for camera in clip.source_cameras() {
        let count = tracks.camera.iter().filter(|&&own| own == camera).count();
        assert!((1..=40).contains(&count), "{count} tracks in camera {camera}");
    }
}

/// A pair that cannot be matched costs its cameras their depth, never the clip; the note names pair and reason.
#[test]
fn pairs_that_cannot_be_matched_are_named() {
    let notes = |change: fn(&mut Clip, &mut RobotMaps)| {
        let (mut clip, mut robot) = scene().clone();
        change(&mut clip, &mut robot);
        struct Heard(Vec<String>);
        impl Observer for Heard {
            fn warn(&mut self, warning: String) {
                self.0.push(warning);
            }
        }
        let mut heard = Heard(vec![]);
        let references = build(&clip, &robot, &always(), &mut heard).unwrap();
        assert_eq!(heard.0, references.notes, "what is kept is told");
        (references.depth.len(), references.notes.join("\n"))
    };
    let (made, said) = notes(|_, robot| offset_right(robot, [120.0, 0.0, 0.0]));
    assert_eq!(made, 4);
    assert!(
        said.contains("stereo pair `ext1`, `ext1_right`") && said.contains("millimetres"),
        "{said}"
    );

    let (made, said) = notes(|_, robot| offset_right(robot, [-0.12, 0.0, 0.0]));
    assert_eq!(made, 4);
    assert!(said.contains("left and right eyes look swapped"), "{said}");

    let (made, said) = notes(|_, robot| offset_right(robot, [0.12, 0.02, 0.0]));
    assert_eq!(made, 4);
    assert!(said.contains("not rectified"), "{said}");

    // Images the other way round: the calibration is right, the pictures are not.
    let (made, said) = notes(|clip, _| {
        let left = clip.cameras[1].recorded.take();
        clip.cameras[1].recorded = std::mem::replace(&mut clip.cameras[4].recorded, left);
    });
    assert_eq!(made, 4);
    assert!(said.contains("left and right eyes look swapped"), "{said}");

    // Rows of the right images two lower: told, and matched all the same.
    let (made, said) = notes(|clip, _| {
        let row = 3 * clip.width as usize;
        let image = row * clip.height as usize;
        let rgb = clip.cameras[4].recorded.as_mut().unwrap();
        for image in rgb.chunks_exact_mut(image) {
            image.copy_within(..image.len() - 2 * row, 2 * row);
        }
    });
    assert_eq!(made, 6);
    assert!(said.contains("not rectified") && said.contains("+2.0 pixels"), "{said}");

    let (made, said) = notes(|clip, _| clip.cameras[4].recorded = None);
    assert_eq!(made, 4);
    assert!(said.is_empty() || said.contains("no pair"), "{said}");
}

/// Puts the right eye of `ext1` at this place in the left one's axes, metres, at every frame.
fn offset_right(robot: &mut RobotMaps, by: [f64; 3]) {
    let frames = FRAMES as usize;
    for frame in 0..frames {
        let left = robot.base_from_camera[frames + frame];
        let along = |row: usize| (0..3).map(|axis| left.rotation[3 * row + axis] * by[axis]).sum::<f64>();
        robot.base_from_camera[4 * frames + frame].translation =
            [0, 1, 2].map(|row| left.translation[row] + along(row));
    }
}

#[test]
fn a_clip_without_right_eyes_or_robot_is_told_so() {
    let (mut clip, mut robot) = scene().clone();
    let frames = clip.frame_count();
    clip.cameras.retain(|camera| camera.role == CameraRole::Source);
    for camera in &mut clip.cameras {
        camera.depth = None;
    }
    robot.base_from_camera.truncate(clip.cameras.len() * frames);
    robot.maps.iter_mut().for_each(|map| map.support.fill(0));
    let references = build(&clip, &robot, &always(), &mut Unobserved).unwrap();
    assert!(references.depth.is_empty() && references.tracks.is_none());
    let said = references.notes.join("\n");
    assert!(said.contains("no stereo depth of wrist, ext1, ext2"), "{said}");
    assert!(said.contains("no robot tracks"), "{said}");
}

#[test]
fn other_clips_and_impossible_parameters_are_refused() {
    let (clip, robot) = scene();
    let mut other = clip.clone();
    other.clip_id = "other".parse().unwrap();
    let error = build(&other, robot, &always(), &mut Unobserved).unwrap_err();
    assert!(error.message.contains("not of `other`"), "{error}");
    let mut longer = clip.clone();
    longer.episode_frames.push(EpisodeFrame(9));
    assert!(build(&longer, robot, &always(), &mut Unobserved).is_err());
    let wrong = |params: Params| build(clip, robot, &params, &mut Unobserved).unwrap_err().message;
    let mut params = always();
    params.stereo.near_m = -1.0;
    assert!(wrong(params).contains("`stereo`: invalid depths"));
    let mut params = always();
    params.depth_range_m = [5.0, 0.1];
    assert!(wrong(params).contains("`depth_range_m` 5 to 0.1"));
    let mut params = always();
    params.robot.spacing_px = 0;
    assert!(wrong(params).contains("`robot.spacing_px` 0"));
}

/// Cameras on the hand have other poses at every frame; the pair stays rigid.
#[test]
fn the_wrist_pair_moves_with_the_hand() {
    let (clip, robot) = scene();
    assert!(matches!(clip.cameras[0].mount, CameraMount::HandEye { .. }));
    let frames = clip.frame_count();
    assert_ne!(robot.base_from_camera[0], robot.base_from_camera[frames - 1]);
    assert!(
        made(clip, &always())
            .depth
            .iter()
            .any(|made| made.camera == CameraIndex(0))
    );
}

#[test]
fn the_same_references_for_any_number_of_threads() {
    let (clip, _) = scene();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        // Debug text, because NaN is not equal to itself.
        format!("{:?}", pool.install(|| made(clip, &always())))
    };
    assert!(with(1) == with(4));
}
