//! The viewer in a real browser, and its bundle.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rogs_needs::needs;
use support::{ROGS, Workspace};

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Runs a script of node; what it printed.
fn node(script: &str, arguments: &[&str]) -> String {
    let output = Command::new("node")
        .arg(repository().join(script))
        .args(arguments)
        .output()
        .unwrap();
    let (out, err) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(output.status.success(), "{script}: {out}\n{err}");
    out.into_owned()
}

#[needs(node)]
#[test]
fn the_viewer_is_what_its_sources_give() {
    node("pipeline/report/viewer/bundle.mjs", &["--check"]);
}

/// A name that is a picture with a script in it, should anybody take it for markup.
const HOSTILE: &str = "<img src=x onerror=alert(1)>";

#[needs(chromium, node)]
#[test]
fn the_report_plays_from_a_file_and_asks_nobody() {
    let workspace = Workspace::small(1);
    let manifest = std::fs::read_to_string(workspace.path("data/manifest.toml")).unwrap();
    let lines = manifest.lines().map(|line| match line.split_once(" = ") {
        Some(("name", _)) => format!("name = {HOSTILE:?}"),
        _ => line.to_owned(),
    });
    let lines: Vec<String> = lines.collect();
    workspace.write("data/manifest.toml", &lines.join("\n"));
    workspace.manifest("hostile.toml", "run");
    let (code, done) = workspace.rogs_json(&["run", "hostile.toml", "--json"]);
    assert_eq!(code, Some(0), "{done:#}");
    let clips = workspace.path("run/clips");
    let clip = std::fs::read_dir(clips).unwrap().next().unwrap().unwrap().path();
    let field = clip.join("field-1.r4c");
    let render = workspace.rogs(&[
        "render",
        field.to_str().unwrap(),
        "--camera",
        "wrist",
        "--out",
        "render",
    ]);
    assert!(render.status.success(), "{}", String::from_utf8_lossy(&render.stderr));
    let page = format!("file://{}", done["report"].as_str().unwrap());
    let render = workspace.path("render/wrist.png");
    println!(
        "{}",
        node("tests/viewer/check.mjs", &[&page, render.to_str().unwrap(), HOSTILE])
    );
}

#[needs(chromium, node)]
#[test]
fn a_field_is_served_to_the_browser() {
    let workspace = Workspace::empty();
    let folder = workspace.path(HOSTILE);
    std::fs::create_dir(&folder).unwrap();
    for name in ["clip.r4c", "robot.r4c", "field-1.r4c", "field-2.r4c"] {
        std::fs::copy(repository().join("tests/golden/outputs").join(name), folder.join(name)).unwrap();
    }
    let field = folder.join("field-1.r4c");
    let field = field.to_str().unwrap();
    let render = workspace.rogs(&["render", field, "--camera", "wrist", "--out", "render"]);
    assert!(render.status.success(), "{}", String::from_utf8_lossy(&render.stderr));
    let mut server = Command::new(ROGS)
        .args(["view", field, "--no-open"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut address = String::new();
    BufReader::new(server.stdout.take().unwrap())
        .read_line(&mut address)
        .unwrap();
    let render = workspace.path("render/wrist.png");
    let checked = std::panic::catch_unwind(|| {
        println!(
            "{}",
            node(
                "tests/viewer/check.mjs",
                &[address.trim(), render.to_str().unwrap(), HOSTILE]
            )
        );
    });
    server.kill().unwrap();
    server.wait().unwrap();
    checked.unwrap();
}
