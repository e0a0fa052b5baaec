//! What lies in folders besides files, and folders that cannot be written.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::os::unix::fs::symlink;
use std::process::Command;

use crate::cases::{Cases, GOOD, Nothing};
use crate::support::{ROGS, Workspace};

fn make_pipe(path: &std::path::Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

#[test]
fn pipes_devices_and_links_to_folders_in_an_episode_stop_nothing() {
    let mut cases = Cases::new();
    symlink("/etc", cases.add("folder", Nothing).join("notes")).unwrap();
    symlink("/dev/zero", cases.add("device", Nothing).join("zero")).unwrap();
    make_pipe(&cases.add("pipe", Nothing).join("pipe"));
    cases.check();
}

#[test]
fn what_is_no_file_is_refused_before_it_is_read() {
    let workspace = Workspace::small(1);
    let urdf = "data/robot/synth.urdf";
    let urdf = match workspace.path(urdf).exists() {
        true => workspace.path(urdf),
        false => std::fs::read_dir(workspace.path("data/robot"))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .find(|path| path.extension().is_some_and(|extension| extension == "urdf"))
            .unwrap(),
    };
    let urdf = urdf.display().to_string();
    make_pipe(&workspace.path("pipe"));
    for ending in ["png", "jpg", "exr", "npz", "safetensors"] {
        symlink("/dev/zero", workspace.path(&format!("zero.{ending}"))).unwrap();
        symlink("pipe", workspace.path(&format!("pipe.{ending}"))).unwrap();
    }
    let refused = |arguments: &[&str]| {
        let output = workspace.rogs(arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(
            said.contains("it is a device") || said.contains("it is a pipe"),
            "{arguments:?}: {said}"
        );
    };
    for what in ["zero", "pipe"] {
        for ending in ["png", "jpg", "exr", "npz", "safetensors"] {
            let file = format!("{what}.{ending}");
            refused(&["metrics", &file, &file]);
        }
    }
    for place in ["/dev/zero", "pipe"] {
        refused(&["inspect", place]);
        refused(&["fk", &urdf, "--joints", place]);
    }
}

#[test]
fn the_report_is_not_written_behind_a_link() {
    let workspace = Workspace::small(1);
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let manifest = manifest.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1);
    workspace.write("manifest.toml", &manifest);
    assert_eq!(workspace.rogs(&["run", "manifest.toml"]).status.code(), Some(0));
    for place in ["run/report/tables", "run/report"] {
        let (place, elsewhere) = (workspace.path(place), workspace.path("elsewhere"));
        // A run of this kind may have no tables.
        let _ = std::fs::remove_dir_all(&place);
        std::fs::create_dir_all(&elsewhere).unwrap();
        symlink(&elsewhere, &place).unwrap();
        let output = workspace.rogs(&["report", "run"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        if !output.status.success() {
            assert_eq!(output.status.code(), Some(70), "{said}");
            assert!(said.contains("it is a link"), "{said}");
        }
        assert_eq!(std::fs::read_dir(&elsewhere).unwrap().count(), 0);
        std::fs::remove_file(&place).unwrap();
        std::fs::create_dir(&place).unwrap();
    }
}

#[test]
fn a_run_folder_that_vanishes_is_no_mistake_of_whoever_asked() {
    let workspace = Workspace::small(1);
    let mut child = Command::new(ROGS)
        .args(["run", "manifest.toml"])
        .current_dir(workspace.path("."))
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let clip = workspace.path("run/clips").join(GOOD).join("clip.r4c");
    while !clip.exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    // Something may be written while it is removed.
    while workspace.path("run").exists() && std::fs::remove_dir_all(workspace.path("run")).is_err() {}
    let code = child.wait().unwrap().code();
    assert!(code.is_some_and(|code| [1, 70].contains(&code)), "{code:?}");
}
