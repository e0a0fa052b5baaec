//! `rogs export`: every form is written whole, foreign programs read the same numbers, and wrong requests say what to do.
//! Numbers are compared by `round_trips.py`, which uses packages that are not ours where there are any.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use rogs_needs::needs;

const ROGS: &str = env!("CARGO_BIN_EXE_rogs");

fn tests() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests")
}

/// A record of the golden clip.
fn golden(name: &str) -> String {
    tests().join("golden/outputs").join(name).to_string_lossy().into_owned()
}

fn rogs(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(ROGS).args(arguments).current_dir(folder).output().unwrap()
}

fn done(folder: &Path, arguments: &[&str]) {
    let output = rogs(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {said}");
}

fn refused(folder: &Path, arguments: &[&str]) -> String {
    let output = rogs(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success(), "{arguments:?} was done");
    assert!(!said.contains("panicked"), "{said}");
    said
}

/// Exports of all stored times in the base frame, with the corrections of Stage 2.
fn field(folder: &Path, format: &str, times: &str, out: &str) {
    let (file, correction) = (golden("field-1.r4c"), golden("field-2.r4c"));
    let all = [
        "export",
        "field",
        &file,
        "--refinement",
        &correction,
        "--format",
        format,
        "--times",
        times,
        "--axes",
        "base",
        "--out",
        out,
    ];
    done(folder, &all);
}

/// What `round_trips.py` says of an export.
fn read_back(what: &str, folder: &Path) {
    field(folder, "npz", "all", "field.npz");
    let python = std::env::var("ROGS_PEER_PYTHON").unwrap_or_else(|_| "python3".into());
    let script = tests().join("exports/round_trips.py");
    let output = Command::new(python).arg(script).arg(what).arg(folder).output().unwrap();
    println!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[needs(plyfile)]
#[test]
fn plyfile_reads_the_ply() {
    let folder = tempfile::tempdir().unwrap();
    field(folder.path(), "ply", "0", "field.ply");
    read_back("ply", folder.path());
}

#[needs(numpy)]
#[test]
fn spz_holds_the_numbers_within_its_steps() {
    let folder = tempfile::tempdir().unwrap();
    field(folder.path(), "spz", "0", "field.spz");
    read_back("spz", folder.path());
}

#[needs(fourdgs)]
#[test]
fn the_reference_reader_of_4dgs_finds_every_time() {
    let folder = tempfile::tempdir().unwrap();
    field(folder.path(), "4dgs", "all", "field.4dgs");
    read_back("4dgs", folder.path());
}

#[needs(numpy)]
#[test]
fn gltf_holds_every_time() {
    let folder = tempfile::tempdir().unwrap();
    field(folder.path(), "gltf", "all", "field.glb");
    read_back("gltf", folder.path());
}

fn clip(folder: &Path, format: &str) {
    let file = golden("clip.r4c");
    let all = [
        "export",
        "clip",
        &file,
        "--format",
        format,
        "--frames",
        "all",
        "--masks",
        "background",
        "--out",
        format,
    ];
    done(folder, &all);
}

#[needs(pycolmap)]
#[test]
fn pycolmap_projects_every_point_to_its_pixel() {
    let folder = tempfile::tempdir().unwrap();
    clip(folder.path(), "colmap");
    read_back("colmap", folder.path());
}

#[needs(numpy)]
#[test]
fn the_formula_of_nerfstudio_projects_every_point_to_its_pixel() {
    let folder = tempfile::tempdir().unwrap();
    clip(folder.path(), "nerfstudio");
    read_back("nerfstudio", folder.path());
}

#[test]
fn sequences_are_folders_and_what_is_transparent_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    field(folder.path(), "spz", "all", "sequence");
    let names: Vec<serde_json::Value> =
        serde_json::from_slice(&std::fs::read(folder.path().join("sequence/times.json")).unwrap()).unwrap();
    assert!(names.len() > 1);
    for name in &names {
        let path = folder.path().join("sequence").join(name["file"].as_str().unwrap());
        assert_eq!(std::fs::read(path).unwrap()[..2], [0x1f, 0x8b]);
    }
    let file = golden("field-1.r4c");
    let pruned = [
        "export",
        "field",
        &file,
        "--format",
        "spz",
        "--times",
        "0",
        "--min-opacity",
        "0.05",
        "--out",
        "few.spz",
    ];
    done(folder.path(), &pruned);
    let size = |name: &str| std::fs::metadata(folder.path().join(name)).unwrap().len();
    assert!(size("few.spz") < size("sequence/000000.spz"));
    // Asked again, the same bytes.
    let first = std::fs::read(folder.path().join("few.spz")).unwrap();
    done(folder.path(), &pruned);
    assert!(first == std::fs::read(folder.path().join("few.spz")).unwrap());
}

#[test]
fn wrong_requests_say_what_to_do_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (field, clip) = (golden("field-1.r4c"), golden("clip.r4c"));
    let of_field = |rest: &[&str]| {
        refused(
            folder.path(),
            &[&["export", "field", &field, "--out", "out"], rest].concat(),
        )
    };
    let of_clip = |rest: &[&str]| {
        refused(
            folder.path(),
            &[&["export", "clip", &clip, "--out", "out"], rest].concat(),
        )
    };
    assert!(of_field(&["--format", "spz", "--times", "1.5"]).contains("outside the clip"));
    assert!(of_field(&["--format", "spz", "--urdf", "robot.urdf", "--times", "0"]).contains("--urdf"));
    assert!(of_field(&["--format", "gltf", "--clip", "nothing.r4c"]).contains("nothing.r4c"));
    assert!(of_field(&["--format", "4dgs", "--times", "1,0"]).contains("ascend"));
    assert!(of_clip(&["--format", "colmap", "--cameras", "wrst"]).contains("did you mean `wrist`"));
    assert!(of_clip(&["--format", "colmap", "--frames", "99"]).contains("frame 99 is outside"));
    assert!(of_clip(&["--format", "nerfstudio", "--frames", "early"]).contains("expected `source`"));
    assert!(
        refused(
            folder.path(),
            &["export", "clip", &field, "--format", "colmap", "--out", "out"]
        )
        .contains("rogs.clip")
    );
    std::fs::create_dir(folder.path().join("out")).unwrap();
    assert!(of_clip(&["--format", "colmap"]).contains("is there already"));
    std::fs::remove_dir(folder.path().join("out")).unwrap();
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
}
