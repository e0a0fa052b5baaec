//! Languages, zones, names of folders.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::process::Command;

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
