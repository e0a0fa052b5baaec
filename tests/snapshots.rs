//! Text that people and scripts read, as it was when somebody last looked at it: help, plans, tables.
//! `UPDATE_EXPECT=1 cargo test --workspace --test snapshots` writes `tests/snapshots/`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "support/golden.rs"]
mod golden;

use std::fmt::Write as _;
use std::process::{Command, Stdio};

use expect_test::expect_file;
use golden::{GoldenRun, ROGS};
use serde_json::Value;

/// Help of a command, with the heading that tells which. Lines are broken at 100 columns as everywhere without a terminal.
fn help(arguments: &[&str]) -> String {
    let output = Command::new(ROGS)
        .args(arguments)
        .arg("--help")
        .env("COLUMNS", "100")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stderr.is_empty(), "help lies on standard output");
    let text = String::from_utf8(output.stdout).unwrap();
    format!("==== rogs {}\n{text}\n", arguments.join(" "))
}

/// Every command, as the arguments that name it.
fn commands() -> Vec<Vec<String>> {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("man");
    let output = Command::new(ROGS)
        .args(["man", "--json", "--out"])
        .arg(&out)
        .output()
        .unwrap();
    let pages: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let files: Vec<std::path::PathBuf> = serde_json::from_value(pages["files"].clone()).unwrap();
    let name = |file: &std::path::PathBuf| file.file_stem().unwrap().to_string_lossy().into_owned();
    let mut names: Vec<String> = files.iter().map(name).collect();
    names.sort();
    names.iter().map(|name| words(name, &names)).collect()
}

/// Arguments that name the command of a manual page. A command may hold a hyphen: it is what follows its parent's page.
fn words(name: &str, names: &[String]) -> Vec<String> {
    let inside = |parent: &&String| {
        name.strip_prefix(parent.as_str())
            .is_some_and(|rest| rest.starts_with('-'))
    };
    let Some(parent) = names.iter().filter(inside).max_by_key(|parent| parent.len()) else {
        return Vec::new();
    };
    let mut words = words(parent, names);
    words.push(name[parent.len() + 1..].to_owned());
    words
}

#[test]
fn help_of_every_command() {
    let mut text = String::new();
    for command in commands() {
        let words: Vec<&str> = command.iter().map(String::as_str).collect();
        text += &help(&words);
    }
    for stage in [
        "ingest",
        "robot-maps",
        "conditioning",
        "agreement",
        "references",
        "lift",
        "refine",
        "fit",
        "score",
    ] {
        text += &help(&["stage", stage]);
        text += &help(&["stage", stage, "one"]);
    }
    text += &help(&["stage", "ingest", "batch"]);
    text += &help(&["stage", "ingest", "worker"]);
    expect_file!["snapshots/help.txt"].assert_eq(&text);
}

#[test]
fn plan_of_a_run_with_nothing_made() {
    let run = GoldenRun::without_outputs();
    let plain = run.rogs(&["plan", "manifest.toml"]);
    // Workers and free space are those of the machine.
    let plain = plain.lines().filter(|line| !line.starts_with("about "));
    let plain = plain.map(|line| format!("{line}\n")).collect::<String>();
    let explained = run.rogs(&["plan", "manifest.toml", "--explain"]);
    expect_file!["snapshots/plan.txt"].assert_eq(&format!(
        "==== rogs plan manifest.toml\n{plain}\n==== rogs plan manifest.toml --explain\n{explained}"
    ));
}

#[test]
fn plan_as_json() {
    let run = GoldenRun::new();
    let mut plan: Value =
        serde_json::from_str(&run.rogs(&["plan", "manifest.toml", "--workers", "1", "--json"])).unwrap();
    assert!(plan["free_bytes"].is_u64());
    plan["free_bytes"] = Value::Null;
    expect_file!["snapshots/plan.json"].assert_eq(&format!("{plan:#}\n"));
}

#[test]
fn units_for_other_engines() {
    let run = GoldenRun::without_outputs();
    run.rogs(&["plan", "manifest.toml", "--emit", "jsonl", "--units", "units.jsonl"]);
    let units = std::fs::read_to_string(run.path().join("units.jsonl")).unwrap();
    let here = run.path().canonicalize().unwrap();
    let mut text = String::new();
    for line in units.lines() {
        let unit: Value = serde_json::from_str(line).unwrap();
        let _ = writeln!(text, "{unit:#}");
    }
    let text = text.replace(&here.display().to_string(), "[FOLDER]");
    expect_file!["snapshots/units.jsonl.txt"].assert_eq(&text.replace(&run.path().display().to_string(), "[FOLDER]"));
}

#[test]
fn tables_of_a_run() {
    let run = GoldenRun::new();
    run.rogs(&["run", "manifest.toml", "--no-report"]);
    let mut text = String::new();
    for arguments in [
        &["main"][..],
        &["main", "--published"],
        &["main", "--format", "csv"],
        &["main", "--format", "latex"],
        &["additional"],
        &["recurrence"],
        &["inputs"],
    ] {
        let table = run.rogs(&[&["table", "run", "--table"], arguments].concat());
        let _ = writeln!(text, "==== rogs table run --table {}\n{table}", arguments.join(" "));
    }
    expect_file!["snapshots/tables.txt"].assert_eq(&text);
}
