//! Languages, zones, names of folders.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::process::Command;

use rogs_needs::needs;

use crate::support::{ROGS, Workspace};

#[test]
fn environments() {
    let workspace = Workspace::small(1);
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let short = manifest.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1);
    workspace.write("manifest.toml", &short);
    assert_eq!(
        workspace.rogs(&["run", "manifest.toml", "--no-report"]).status.code(),
        Some(0)
    );
    let expected = workspace.outputs("run");
    // A decimal comma, another zone, no home, a senseless number of threads.
    workspace.write("strange.toml", &short.replace("/run\"", "/strange\""));
    let output = Command::new(ROGS)
        .args(["run", "strange.toml", "--no-report"])
        .current_dir(workspace.path("."))
        .env_remove("HOME")
        .envs([
            ("LC_ALL", "de_DE.UTF-8"),
            ("LANG", "de_DE.UTF-8"),
            ("TZ", "Pacific/Chatham"),
            ("RAYON_NUM_THREADS", "0"),
        ])
        .output()
        .unwrap();
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(
        workspace.outputs("strange") == expected,
        "the environment changed outputs"
    );
    // A folder whose name is not UTF-8: refused in words, or used as it is; never a panic.
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::ffi::OsStrExt as _;
        let folder = workspace.path(".").join(std::ffi::OsStr::from_bytes(b"d\xffr"));
        std::fs::create_dir(&folder).unwrap();
        let output = Command::new(ROGS).arg("status").arg(&folder).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("is not a run folder"), "{said}");
        std::fs::copy(workspace.path("manifest.toml"), folder.join("m.toml")).unwrap();
        let relative = short.replace(&format!("{:?}", workspace.path("run")), "\"out\"");
        std::fs::write(folder.join("m.toml"), relative).unwrap();
        let output = Command::new(ROGS)
            .arg("run")
            .arg(folder.join("m.toml"))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!said.contains("panicked") && said.contains("error: "), "{said}");
    }
}

/// What some file systems do not have, and names that a shell or Slurm would take for something else.
#[needs(cc)]
#[test]
fn every_stage_and_command_does_without_locks_below_any_name() {
    const NAME: &str = "a b'c\"d 100%u #x $HOME `y` über";
    let workspace = Workspace::small(1);
    assert_eq!(workspace.rogs(&["run", "manifest.toml"]).status.code(), Some(0));
    let library = workspace.path("without.so");
    workspace.write("without.c", include_str!("../support/without_operations.c"));
    let mut compiler = Command::new("cc");
    compiler.args(["-shared", "-fPIC", "-o"]).arg(&library);
    let made = compiler.arg(workspace.path("without.c")).arg("-ldl").status();
    assert!(made.unwrap().success());
    let folder = workspace.path(NAME);
    std::fs::create_dir(&folder).unwrap();
    std::fs::rename(workspace.path("data"), folder.join("da ta")).unwrap();
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let manifest = manifest
        .replace("data/", "da ta/")
        .replace(&format!("{:?}", workspace.path("run")), "\"r ü n\"");
    std::fs::write(folder.join("m n.toml"), manifest).unwrap();
    let rogs = |arguments: &[&str]| {
        let mut command = Command::new(ROGS);
        command.args(arguments).current_dir(&folder).env("LD_PRELOAD", &library);
        let output = command.output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
        assert!(!said.contains("panicked"), "{arguments:?}: {said}");
        String::from_utf8_lossy(&output.stdout).into_owned() + &said
    };
    assert!(rogs(&["run", "m n.toml"]).contains("has no locks"));
    let expected = workspace.outputs("run");
    assert_eq!(workspace.outputs(&format!("{NAME}/r ü n")).len(), expected.len());
    for (path, bytes) in expected {
        assert!(
            std::fs::read(folder.join("r ü n").join(&path)).unwrap() == bytes,
            "{} differs",
            path.display()
        );
    }
    for command in ["status", "verify", "gc", "table", "report"] {
        rogs(&[command, "r ü n"]);
    }
    rogs(&["plan", "m n.toml", "--emit", "jsonl"]);
    // What else this machine lacks decides its exit code.
    let doctor = Command::new(ROGS)
        .arg("doctor")
        .current_dir(&folder)
        .env("LD_PRELOAD", &library)
        .output();
    let doctor = String::from_utf8_lossy(&doctor.unwrap().stdout).into_owned();
    assert!(doctor.contains("no lock on files, no flush of folders"), "{doctor}");
    // Commands that it prints are commands of a shell.
    assert!(
        rogs(&[
            "synth",
            "--episodes",
            "1",
            "--frames",
            "17",
            "--size",
            "14x14",
            "--out",
            "x y"
        ])
        .contains("'x y/")
    );
}
