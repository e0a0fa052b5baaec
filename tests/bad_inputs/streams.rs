//! Standard output and error that are closed, full or a terminal that went away: nothing ends, and exit codes stay.

use std::process::{Command, Stdio};

use crate::cases::{Cases, Failure};
use crate::support::ROGS;

/// Runs the program in the workspace with its streams as a shell sets them up.
fn run(cases: &Cases, arguments: &str, streams: &str) -> Option<i32> {
    let script = format!("exec \"$0\" {arguments} {streams}");
    let status = Command::new("sh")
        .args(["-c", &script, ROGS])
        .current_dir(cases.workspace.path("."))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    status.unwrap().code()
}

#[test]
fn nobody_need_listen_to_a_run() {
    let mut cases = Cases::new();
    cases.edited("failing", Failure("gone", ""), |episode| {
        episode["robot"]["states"] = "gone.csv".into();
    });
    let arguments = "run manifest.toml --no-report";
    for streams in ["2>/dev/full", ">/dev/full", ">/dev/full 2>&1", ">&- 2>&-"] {
        let _ = std::fs::remove_dir_all(cases.workspace.path("run"));
        assert_eq!(run(&cases, arguments, streams), Some(3), "{streams}");
        // What is done is done: the same again.
        assert_eq!(run(&cases, arguments, streams), Some(3), "{streams}");
    }
    // Whoever reads goes away at once.
    let _ = std::fs::remove_dir_all(cases.workspace.path("run"));
    let mut child = Command::new(ROGS)
        .args(arguments.split(' '))
        .current_dir(cases.workspace.path("."))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop((child.stdout.take(), child.stderr.take()));
    assert_eq!(child.wait().unwrap().code(), Some(3));
    // Commands whose code is an answer keep it, others say that they could not give theirs.
    assert_eq!(run(&cases, "status run", ">/dev/full"), Some(3));
    assert_eq!(run(&cases, "verify run", ">/dev/full"), Some(0));
    assert_eq!(run(&cases, "schema", ">/dev/full"), Some(70));
    assert_eq!(run(&cases, "plan manifest.toml", ">/dev/full"), Some(70));
}

#[test]
fn a_terminal_that_goes_away_does_not_end_a_run() {
    let cases = Cases::new();
    let mut child = Command::new(ROGS)
        .args(["run", "manifest.toml", "--no-report"])
        .current_dir(cases.workspace.path("."))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // From the moment on at which the run folder is there, signals are waited for.
    let plan = cases.workspace.path("run/plan.jsonl");
    while !plan.exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let hang_up = format!("kill -s HUP {}", child.id());
    let _ = Command::new("sh").args(["-c", &hang_up]).status();
    assert_eq!(child.wait().unwrap().code(), Some(0));
}
