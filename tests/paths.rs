//! The ways that people take, from their data to a report: the scripts in `tests/paths/`, and the tutorials that show them.
//!
//! Built without optimisation a clip at the size of the built-in networks takes minutes, so manifests get a smaller size here;
//! `tests/paths/run` runs the scripts as they are and tells commands and seconds.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

#[path = "support/lerobot.rs"]
mod lerobot;
mod support;
#[path = "../stages/ingest/tests/common/tables.rs"]
mod tables;

use std::path::{Path, PathBuf};
use std::process::Command;

use rogs_needs::{needs, shared};
use rogs_r4c::read_record;
use rogs_schemas::records::clip::{CameraMount, Clip};
use rogs_schemas::records::scores::Scores;
use rogs_synth::{CAMERA_NAMES, DroidEpisode, Mount};
use support::{ROGS, Workspace};

/// What makes a manifest small, behind the line that wrote it.
const SMALL: &str =
    "sed -i 's/^height = .*/height = 42/; s/^width = .*/width = 56/; s/^updates = .*/updates = 1/' *.toml";

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn script(name: &str) -> String {
    std::fs::read_to_string(repository().join(format!("tests/paths/{name}.sh"))).unwrap()
}

/// Runs a script in a workspace; what it printed.
fn run(workspace: &Workspace, name: &str, shared: &Path) -> String {
    let mut text = String::from("set -eu\n");
    for line in script(name).lines() {
        text.push_str(line);
        text.push('\n');
        if line.starts_with("rogs init") {
            text.push_str(SMALL);
            text.push('\n');
        }
    }
    let programs = Path::new(ROGS).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let output = Command::new("sh")
        .args(["-c", &text])
        .current_dir(workspace.path("."))
        .env("PATH", path)
        .env("ROGS_SHARED", shared)
        .env("ROGS_REPOSITORY", repository())
        .output()
        .unwrap();
    let (out, err) = (
        String::from_utf8_lossy(&output.stdout).into_owned(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    );
    assert!(output.status.success(), "{name}: {out}\n{err}");
    out
}

fn run_alone(name: &str) -> String {
    run(&Workspace::empty(), name, Path::new(""))
}

#[test]
fn an_own_episode_becomes_a_report_and_a_film_in_three_commands() {
    let said = run_alone("own-episode");
    assert!(said.contains("1 of 1 clips done, 0 failed"), "{said}");
    assert!(said.contains("lift: built-in weights"), "{said}");
    assert!(
        said.contains("WARNING: the built-in networks are made for images of 154x84"),
        "{said}"
    );
}

#[test]
fn an_evaluator_learns_the_frames_of_a_clip_and_gets_numbers() {
    let said = run_alone("evaluator");
    assert!(said.contains("its frames 7 to 23"), "{said}");
    assert!(said.contains("camera     wrist (source): fx "), "{said}");
}

#[test]
fn an_arm_that_no_preset_knows_gets_a_manifest_that_runs() {
    let said = run_alone("another-arm");
    assert!(said.contains("check its names in the manifest"), "{said}");
    assert!(said.contains("1 of 1 clips done, 0 failed"), "{said}");
}

#[needs(long = "the demo at full size, built without optimisation")]
#[test]
fn a_visitor_sees_a_report_after_one_command() {
    assert!(run_alone("visitor").contains("1 of 1 clips done"));
}

#[needs(shared, ffmpeg)]
#[test]
fn a_lerobot_set_runs_from_its_wrist_camera() {
    let said = run(&Workspace::empty(), "lerobot", &shared!(""));
    assert!(said.contains("1 of 1 clips done, 0 failed"), "{said}");
}

/// The same script on a made-up set that has the names of that one.
#[needs(ffmpeg)]
#[test]
fn a_made_up_lerobot_set_runs_from_its_wrist_camera() {
    let workspace = Workspace::empty();
    let data = workspace.path("data");
    let arguments = [
        "synth",
        "--episodes",
        "1",
        "--size",
        "280x168",
        "--frames",
        "24",
        "--out",
        "data",
    ];
    assert!(workspace.rogs(&arguments).status.success());
    let episode = data.join("episodes/synth-00000000");
    lerobot::write_set(&data.join("lerobot_v30_droid"), &episode);
    // What is left lies as in the folder of reference data: the set, and a robot beside it.
    std::fs::remove_dir_all(data.join("episodes")).unwrap();
    let said = run(&workspace, "lerobot", &workspace.path("."));
    assert!(said.contains("1 of 1 clips done, 0 failed"), "{said}");
}

#[needs(libx264, long = "six raw DROID episodes through every stage")]
#[test]
fn raw_droid_runs_as_it_was_released() {
    let workspace = Workspace::small(1);
    std::fs::rename(workspace.path("data"), workspace.path("kitchen")).unwrap();
    let config = rogs_synth::droid_config(33, [180, 320]);
    let episodes = rogs_synth::write_droid(&workspace.path("droid"), 0, &config).unwrap();
    let said = run(&workspace, "raw-droid", Path::new(""));
    assert!(said.contains("6 of 6 clips done, 0 failed"), "{said}");
    let mut clips = Vec::new();
    files(&workspace.path("."), "clip.r4c", &mut clips);
    assert_eq!(clips.len(), episodes.len(), "{clips:?}");
    for path in clips {
        let (clip, _) = read_record::<Clip>(&path).unwrap();
        let episode = episodes.iter().find(|own| own.uuid == clip.episode_id).unwrap();
        cameras_stand_as_drawn(&clip, episode);
        let (scores, _) = read_record::<Scores>(&path.with_file_name("scores-2.r4c")).unwrap();
        assert!(
            scores.summary.images.iter().all(|image| image.psnr.is_some()),
            "{}",
            clip.episode_id
        );
    }
}

/// Files of a name below a folder.
fn files(folder: &Path, name: &str, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => files(&path, name, found),
            false if path.ends_with(name) => found.push(path),
            false => {}
        }
    }
}

/// Poses of the external left eyes and the hand-eye of the wrist camera, within 1e-6 of the truth.
fn cameras_stand_as_drawn(clip: &Clip, episode: &DroidEpisode) {
    for camera in clip.cameras.iter().filter(|camera| !camera.id.ends_with("_right")) {
        let index = CAMERA_NAMES.iter().position(|name| *name == camera.id).unwrap();
        let (found, truth) = match (&camera.mount, &episode.truth.cameras[index].mount) {
            (CameraMount::Fixed { base_from_camera }, Mount::Fixed(truth)) => (base_from_camera, truth.to_rigid()),
            (CameraMount::HandEye { link_from_camera, .. }, Mount::Flange(truth)) => {
                (link_from_camera, truth.to_rigid())
            }
            (found, expected) => panic!("{}: {found:?}, {expected:?}", camera.id),
        };
        let turned = found.rotation.iter().zip(&truth.rotation);
        let moved = found.translation.iter().zip(&truth.translation);
        let off = turned.chain(moved).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-6, "{}, {}: {off}", clip.episode_id, camera.id);
    }
}

/// Commands of a page: the lines of its blocks of shell.
fn commands(page: &str) -> Vec<&str> {
    let mut inside = false;
    let mut out = Vec::new();
    for line in page.lines() {
        match line {
            "```sh" => inside = true,
            "```" => inside = false,
            _ if inside => out.push(line),
            _ => {}
        }
    }
    out
}

#[test]
fn every_command_of_a_tutorial_is_one_of_its_script() {
    for (page, name) in [
        ("own-episode", "own-episode"),
        ("lerobot", "lerobot"),
        ("droid", "raw-droid"),
        ("evaluators", "evaluator"),
    ] {
        let text = std::fs::read_to_string(repository().join(format!("docs/tutorials/{page}.md"))).unwrap();
        let (shown, run) = (commands(&text), script(name));
        assert!(shown.len() > 3, "{page}: commands are not found any more");
        for command in shown {
            assert!(
                run.lines().any(|line| line == command),
                "{page}: `{command}` is not run"
            );
        }
    }
}
