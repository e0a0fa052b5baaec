//! Other engines: the commands of `docs/clusters.md` run a manifest to the end, with the bytes of a local run.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use std::path::{Path, PathBuf};
use std::process::Command;

use rogs_needs::needs;
use support::{ROGS, Workspace};

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The block of commands of the page that names a program.
fn block(program: &str) -> String {
    let page = std::fs::read_to_string(repository().join("docs/clusters.md")).unwrap();
    let mut blocks = page.split("```").skip(1).step_by(2);
    let found = blocks.find(|block| block.contains("--emit jsonl") && block.contains(program));
    found
        .unwrap_or_else(|| panic!("the page has no commands with `{program}`"))
        .to_owned()
}

/// Runs the block in a workspace with the manifest `kitchen.toml` and compares with a run of its own.
fn runs_to_the_bytes_of_a_local_run(program: &str) {
    let workspace = Workspace::small(2);
    workspace.manifest("kitchen.toml", "runs/kitchen");
    workspace.manifest("local.toml", "local");
    let python = std::env::var("ROGS_PEER_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let script = repository().join("docs/python");
    let commands: String = block(program)
        .lines()
        .filter(|line| !line.starts_with("pip install"))
        .map(|line| line.replace("--shards 8", "--shards 2").replace("lines 4", "lines 1") + "\n")
        .collect();
    let commands = commands
        .replace("python3 ", &format!("{python} "))
        .replace("docs/python", script.to_str().unwrap());
    let programs = Path::new(ROGS).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let output = Command::new("sh")
        .args(["-euc", &commands])
        .current_dir(workspace.path("."))
        .env("PATH", path)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{commands}\n{said}");
    assert!(workspace.path("runs/kitchen/report/index.html").is_file(), "{said}");
    let local = workspace.rogs(&["run", "local.toml", "--no-report"]);
    assert!(local.status.success(), "{}", String::from_utf8_lossy(&local.stderr));
    let (code, same) = workspace.rogs_json(&["diff", "runs/kitchen", "local", "--json"]);
    assert_eq!((code, &same["same"]), (Some(0), &serde_json::json!(14)), "{same:#}");
}

#[needs(parallel)]
#[test]
fn gnu_parallel_runs_the_lines_of_a_plan() {
    runs_to_the_bytes_of_a_local_run("parallel --jobs");
}

#[needs(hyperqueue)]
#[test]
fn hyperqueue_runs_the_lines_of_a_plan() {
    runs_to_the_bytes_of_a_local_run("hyperqueue_run.py");
}
