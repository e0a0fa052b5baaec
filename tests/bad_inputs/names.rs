//! Names with control characters: shown escaped, wherever they are shown.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use crate::cases::{Cases, Failure};

/// Turns a terminal red, sets its title, begins a line of its own, turns the direction of writing.
const NAME: &str = "j\u{1b}[31m\u{1b}]0;T\u{7}\nerror: fake\u{9b}2J\u{202e}x";

/// Fails where a text has characters that a terminal obeys.
#[track_caller]
fn plain(what: &str, bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let steers = |c: char| (c.is_control() && c != '\n' && c != '\t') || c == '\u{202e}';
    assert!(!text.contains(steers), "{what}: {text:?}");
    assert!(
        !text.lines().any(|line| line.starts_with("error: fake")),
        "{what}: {text}"
    );
}

#[test]
fn names_cannot_steer_a_terminal_or_hide_in_a_page() {
    let mut cases = Cases::new();
    cases.edited("joint", Failure("", ""), |episode| {
        episode["robot"]["joint_names"][0] = NAME.into();
    });
    cases.edited("states", Failure("", ""), |episode| {
        episode["robot"]["states"] = NAME.into();
    });
    let workspace = &cases.workspace;
    let output = workspace.rogs(&["run", "manifest.toml"]);
    assert_eq!(output.status.code(), Some(3));
    plain("run", &output.stdout);
    plain("run", &output.stderr);
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("\\u{1b}[31m"),
        "it is shown"
    );
    plain("page", &std::fs::read(workspace.path("run/report/index.html")).unwrap());
    for arguments in [
        &["status", "run"][..],
        &["logs", "run", "joint"],
        &["logs", "run", "states"],
        &["run", "manifest.toml", "--json"],
        &["status", "run", "--json"],
    ] {
        let output = workspace.rogs(arguments);
        plain(&arguments.join(" "), &output.stdout);
        plain(&arguments.join(" "), &output.stderr);
    }
    // Names of files, of columns, of runs, of keys.
    let table = workspace.path(&NAME.replace('\n', "_"));
    std::fs::write(&table, format!("{}\n0\n", NAME.replace('\n', " "))).unwrap();
    let urdf = std::fs::read_dir(workspace.path("data/robot"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.extension().is_some_and(|extension| extension == "urdf"))
        .unwrap();
    let output = workspace.rogs(&[
        "fk",
        &urdf.display().to_string(),
        "--joints",
        &table.display().to_string(),
    ]);
    assert_eq!(output.status.code(), Some(2));
    plain("fk", &output.stderr);
    let output = workspace.rogs(&["inspect", NAME]);
    plain("inspect", &output.stderr);
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let escaped = NAME
        .chars()
        .map(|c| format!("\\u{:04X}", u32::from(c)))
        .collect::<String>();
    let named = manifest.lines().map(|line| match line.starts_with("name = ") {
        true => format!("name = \"{escaped}\"\n"),
        false => format!("{line}\n"),
    });
    workspace.write("named.toml", &named.collect::<String>());
    workspace.write("key.toml", &format!("{manifest}\n[robot-maps]\n\"{escaped}\" = 1\n"));
    for name in ["named.toml", "key.toml"] {
        let output = workspace.rogs(&["plan", name]);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        plain(name, &output.stderr);
    }
}
