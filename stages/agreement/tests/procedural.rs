//! The stage on a procedural clip: good as it is, wrong and named when a mistake is planted, silent where nothing can be
//! told.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::sync::OnceLock;

use rogs_agreement_stage::{Params, Robot, build};
use rogs_geometry::{Base, Camera, Pose};
use rogs_robot_maps::Robot as MapsRobot;
use rogs_schemas::records::agreement::{Agreements, Verdict, ViewState};
use rogs_schemas::records::clip::{CameraMount, Clip};
use rogs_schemas::records::robot::RobotSpec;
use rogs_synth::{ROBOT_SPEC_FILE, SynthConfig, write_dataset};
use rogs_worker::{Observer, Unobserved};

struct Scene {
    clip: Clip,
    spec: RobotSpec,
    maps_robot: MapsRobot,
    robot: Robot,
}

fn scene() -> &'static Scene {
    static SCENE: OnceLock<Scene> = OnceLock::new();
    SCENE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let config = SynthConfig {
            frames: 24,
            ..SynthConfig::default()
        };
        let made = write_dataset(folder.path(), 1, 501, &config).unwrap();
        let params = rogs_ingest::Params {
            frames: 17,
            ..rogs_ingest::Params::default()
        };
        let (clip, _) = rogs_ingest::read_clip(&made.episodes[0], None, &params, "procedural").unwrap();
        let spec = made.robot.with_file_name(ROBOT_SPEC_FILE);
        let spec: RobotSpec = serde_json::from_slice(&std::fs::read(spec).unwrap()).unwrap();
        let params = rogs_robot_maps::Params {
            robot: spec.clone(),
            ..rogs_robot_maps::Params::default()
        };
        Scene {
            clip,
            maps_robot: MapsRobot::load(&made.robot, &params).unwrap(),
            robot: Robot::load(&made.robot, &spec).unwrap(),
            spec,
        }
    })
}

#[derive(Default)]
struct Warnings(Vec<String>);

impl Observer for Warnings {
    fn warn(&mut self, warning: String) {
        self.0.push(warning);
    }
}

/// What the stage says of a clip, with its warnings.
fn told(clip: &Clip, explain: bool) -> (Agreements, Vec<String>) {
    let Scene {
        spec,
        maps_robot,
        robot,
        ..
    } = scene();
    let params = rogs_robot_maps::Params {
        robot: spec.clone(),
        ..rogs_robot_maps::Params::default()
    };
    let maps = rogs_robot_maps::build(clip, maps_robot, &params, &mut Unobserved).unwrap();
    let params = Params {
        robot: spec.clone(),
        explain,
    };
    let mut warnings = Warnings::default();
    let found = build(clip, &maps, robot, &params, &mut warnings).unwrap();
    found.check().unwrap();
    (found, warnings.0)
}

#[test]
fn a_right_clip_is_good_and_nobody_is_warned() {
    let (found, warnings) = told(&scene().clip, true);
    assert_eq!(warnings, Vec::<String>::new());
    assert_eq!(found.cameras.len(), 3);
    assert_eq!(
        found.cameras[0].lag_frames, None,
        "the hand stands still in its own camera"
    );
    for camera in &found.cameras[1..] {
        assert_eq!(camera.verdict, Verdict::Good, "{}", camera.name);
        assert!(
            camera.overlay > 0.3 && camera.offset.unwrap().px < 1.0,
            "{}",
            camera.name
        );
        let measured = camera.views.iter().filter(|view| view.state == ViewState::Measured);
        assert!(measured.count() > 12, "{}", camera.name);
        assert!(camera.link_px.iter().any(|px| px.is_finite()));
    }
}

#[test]
fn an_inverted_pose_is_named_and_told() {
    let mut clip = scene().clip.clone();
    let CameraMount::Fixed { base_from_camera } = &mut clip.cameras[1].mount else {
        panic!("ext1 stands still");
    };
    let inverse: Pose<Base, Camera> = Pose::<Base, Camera>::from_rigid(base_from_camera)
        .unwrap()
        .inverse()
        .relabelled();
    *base_from_camera = inverse.to_rigid();
    let (found, warnings) = told(&clip, true);
    let camera = &found.cameras[1];
    assert_eq!(camera.verdict, Verdict::Wrong);
    assert_eq!(
        camera.mistake.as_ref().map(|own| own.name.as_str()),
        Some("inverted-pose")
    );
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(
        warnings[0].starts_with("camera `ext1` is wrong: ") && warnings[0].contains("give camera-to-base"),
        "{warnings:?}"
    );
    assert_eq!(found.cameras[2].verdict, Verdict::Good);
    // Without explanations it is only off, or not to be told.
    let (plain, _) = told(&clip, false);
    assert!(plain.cameras[1].mistake.is_none() && plain.cameras[1].verdict != Verdict::Good);
}

#[test]
fn what_cannot_be_told_is_said() {
    let mut clip = scene().clip.clone();
    clip.cameras[1].recorded.as_mut().unwrap().fill(127);
    clip.cameras[2].recorded = None;
    let (found, warnings) = told(&clip, true);
    assert_eq!(warnings, Vec::<String>::new());
    let [blank, none] = [&found.cameras[1], &found.cameras[2]];
    assert_eq!(
        (blank.verdict, blank.why.as_str()),
        (Verdict::CannotTell, "the image is blank")
    );
    assert_eq!(
        (none.verdict, none.why.as_str()),
        (Verdict::CannotTell, "there is no image")
    );
    assert!(none.offset.is_none() && none.views.iter().all(|view| view.state == ViewState::NoImage));
}

#[test]
fn threads_make_no_difference() {
    let clip = &scene().clip;
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        format!("{:?}", pool.install(|| told(clip, true).0))
    };
    assert_eq!(with(1), with(3));
}
