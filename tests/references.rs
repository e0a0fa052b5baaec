//! A run that makes its own references: `[references]` in the manifest, and what tables and report say of them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

#[path = "support/golden.rs"]
mod golden;

use std::path::{Path, PathBuf};

use golden::GoldenRun;
use rogs_r4c::read_record;
use rogs_schemas::CameraIndex;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::references::References;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::Scores;

/// Adds text to the manifest of a run.
fn extend(run: &GoldenRun, more: &str) {
    let path = run.path().join("manifest.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(path, format!("{text}\n{more}\n")).unwrap();
}

/// Whether the plan has a unit that makes references.
fn makes_references(run: &GoldenRun) -> bool {
    run.rogs(&["plan", "manifest.toml", "--explain"])
        .lines()
        .any(|line| line.contains(" references: "))
}

#[test]
fn references_are_made_where_the_manifest_asks_for_them() {
    let run = GoldenRun::new();
    assert!(!makes_references(&run));
    extend(
        &run,
        "[references]\ndepth = \"always\"\ntracks = \"always\"\nstereo = { speckle_px = 8 }\nrobot = { spacing_px = 2 }",
    );
    assert!(makes_references(&run));
    run.rogs(&["run", "manifest.toml"]);
    let (scores, _) = read_record::<Scores>(&run.clip_folder().join("scores-1.r4c")).unwrap();
    let origins: Vec<ReferenceOrigin> = scores.summary.references.iter().map(|used| used.origin).collect();
    let mut expected = vec![ReferenceOrigin::ClassicalStereo; 6];
    expected.push(ReferenceOrigin::Kinematics);
    assert_eq!(origins, expected);

    let table = run.rogs(&["table", "run", "--table", "main"]);
    assert!(table.contains("depth references: classical stereo (n=1)"), "{table}");
    assert!(table.contains("track references: kinematics (n=1)"), "{table}");
    let page = std::fs::read_to_string(run.path().join("run/report/index.html")).unwrap();
    assert!(
        page.contains("depth references: classical stereo"),
        "the report names the origins"
    );
}

/// The `field-1.r4c` of a variant: the one that does not lie in the clip's own folder.
fn field_of_variant(run: &GoldenRun) -> Field {
    fn below(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                below(&path, found);
            } else if path.ends_with("field-1.r4c") {
                found.push(path);
            }
        }
    }
    let mut found = Vec::new();
    below(&run.path().join("run"), &mut found);
    found.retain(|path| path.parent() != Some(&run.clip_folder()));
    let [path] = &found[..] else { panic!("{found:?}") };
    read_record::<Field>(path).unwrap().0
}

/// The mean distance of the points of a camera's made depth at the source times from where it stands at the first of them,
/// metres: with arithmetic of its own.
fn mean_distance_m(clip: &Clip, robot: &RobotMaps, made: &References, camera: CameraIndex) -> f64 {
    let depth = made.depth.iter().find(|depth| depth.camera == camera).unwrap();
    let (width, area) = (clip.width as usize, (clip.width * clip.height) as usize);
    let pose = |frame: usize| &robot.base_from_camera[camera.at() * clip.frame_count() + frame];
    let first = pose(clip.source_frames[0].at()).translation;
    let lens = clip.cameras[camera.at()].intrinsics;
    let (mut sum, mut count) = (0.0, 0usize);
    for frame in &clip.source_frames {
        let map = made.frames.iter().position(|own| own == frame).unwrap();
        let (rotation, centre) = (pose(frame.at()).rotation, pose(frame.at()).translation);
        for pixel in 0..area {
            let z = f64::from(depth.depth_m[map * area + pixel]);
            if !(z > f64::from(depth.range_m[0]) && z < f64::from(depth.range_m[1])) {
                continue;
            }
            let x = ((pixel % width) as f64 + 0.5 - lens.cx) / lens.fx * z;
            let y = ((pixel / width) as f64 + 0.5 - lens.cy) / lens.fy * z;
            let square = (0..3).map(|row| {
                let [a, b, c] = [0, 1, 2].map(|column| rotation[3 * row + column]);
                (a * x + b * y + c * z + centre[row] - first[row]).powi(2)
            });
            sum += square.sum::<f64>().sqrt();
            count += 1;
        }
    }
    assert!(count > 100, "camera {camera} has {count} points");
    sum / count as f64
}

const VARIANT: &str = "[[variants]]\nname = \"camera-wise\"\n\
    lift = { attention = \"camera-wise\", anchoring = false, fk_conditioning = false }";

#[test]
fn only_camera_wise_lifting_asks_for_references() {
    let run = GoldenRun::new();
    let path = run.path().join("manifest.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replacen("[run]\n", "[run]\nstages = [\"lift\"]\n", 1)).unwrap();
    extend(&run, "[references]\ndepth = \"always\"");
    assert!(!makes_references(&run), "nothing reads them");
    extend(&run, VARIANT);
    assert!(makes_references(&run));
}

#[test]
fn camera_wise_lifting_takes_its_unit_from_the_references() {
    let run = GoldenRun::new();
    extend(&run, VARIANT);
    run.rogs(&["run", "manifest.toml", "--no-report"]);
    let exact = field_of_variant(&run).weights.description;
    let said = run.rogs(&["table", "run", "--table", "inputs"]);
    assert!(
        exact.contains("unit of each camera: wrist ") && exact.contains("m (exact)"),
        "{exact}"
    );
    assert!(said.contains("scale only: exact"), "{said}");

    let run = GoldenRun::new();
    extend(&run, "[references]\ndepth = \"always\"\nstereo = { speckle_px = 8 }");
    extend(&run, VARIANT);
    run.rogs(&["run", "manifest.toml", "--no-report"]);
    let label = field_of_variant(&run).weights.description;
    let read = |name: &str| run.clip_folder().join(name);
    let (clip, _) = read_record::<Clip>(&read("clip.r4c")).unwrap();
    let (robot, _) = read_record::<RobotMaps>(&read("robot.r4c")).unwrap();
    let (made, _) = read_record::<References>(&read("references.r4c")).unwrap();
    for camera in clip.source_cameras() {
        let name = format!("{} ", clip.cameras[camera.at()].id);
        let own = label
            .split(&name)
            .nth(1)
            .unwrap_or_else(|| panic!("no `{name}` in `{label}`"));
        let unit_m: f64 = own.split(' ').next().unwrap().parse().unwrap();
        let expected = mean_distance_m(&clip, &robot, &made, camera);
        assert!((unit_m - expected).abs() < 2e-4, "{name}{unit_m}, expected {expected}");
        assert!(own.starts_with(&format!("{unit_m:.4} m (classical stereo)")), "{label}");
    }
    let said = run.rogs(&["table", "run", "--table", "inputs"]);
    assert!(said.contains("scale only: classical stereo"), "{said}");
}

#[test]
fn exact_references_are_named_in_tables_of_a_run_without() {
    let run = GoldenRun::new();
    run.rogs(&["run", "manifest.toml"]);
    let table = run.rogs(&["table", "run", "--table", "main"]);
    assert!(table.contains("depth references: exact (n=1)"), "{table}");
    assert!(table.contains("track references: exact (n=1)"), "{table}");
}
