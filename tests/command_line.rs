//! What scripts rely on: exit codes, streams, completions, the schema for editors, and plans that other engines run.
//! `json_output.rs` is about `--json`, `snapshots.rs` about help texts.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use rogs_needs::needs;
use serde_json::{Value, json};
use support::{ROGS, Workspace};

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Checks an exit code and that what is said lies where `docs/exit-codes.md` says.
fn ends(output: &Output, code: i32, said: &str) {
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    assert!(stderr.contains(said), "`{said}` is not in: {stderr}");
    if [2, 4, 70].contains(&code) {
        assert!(output.stdout.is_empty(), "{}", text(&output.stdout));
        assert!(stderr.starts_with("error: "), "{stderr}");
    }
}

#[test]
fn exit_codes_are_those_of_the_table() {
    let workspace = Workspace::small(1);
    // Two stages are enough here.
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let short = manifest.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1);
    workspace.write("manifest.toml", &short);

    // 2: wrong requests. Nothing is on standard output, also with `--json`.
    ends(&workspace.rogs(&["statsu", "run"]), 2, "'status'");
    ends(
        &workspace.rogs(&["run", "manifest.toml", "--wrkers", "1"]),
        2,
        "'--workers'",
    );
    ends(&workspace.rogs(&["run", "missing.toml", "--json"]), 2, "missing.toml");
    ends(
        &workspace.rogs(&["status", "nowhere", "--json"]),
        2,
        "is not a run folder",
    );
    workspace.write("typo.toml", &short.replace("height =", "hieght ="));
    let typo = workspace.rogs(&["run", "typo.toml", "--json"]);
    ends(&typo, 2, "unknown parameter `hieght` of `ingest`");
    assert!(text(&typo.stderr).contains("typo.toml:") && text(&typo.stderr).contains("did you mean `height`?"));
    ends(
        &workspace.rogs(&["run", "manifest.toml", "--only", "nobody"]),
        2,
        "nobody",
    );
    workspace.write("no.r4c", "not a container");
    ends(&workspace.rogs(&["inspect", "no.r4c"]), 2, "no.r4c");

    // 70: the machine or the installation does not let the program continue.
    std::fs::create_dir(workspace.path("empty")).unwrap();
    ends(
        &workspace.rogs(&["run", "manifest.toml", "--programs", "empty", "--json"]),
        70,
        "rogs-ingest",
    );
    workspace.write("file", "");
    workspace.write("blocked.toml", &short.replace("/run\"", "/file/run\""));
    ends(&workspace.rogs(&["run", "blocked.toml"]), 70, "file/run");

    // 75: something is left, nothing failed. 0: all is done.
    ends(
        &workspace.rogs(&["plan", "manifest.toml", "--emit", "jsonl"]),
        0,
        "2 units",
    );
    assert_eq!(workspace.rogs(&["status", "run"]).status.code(), Some(75));
    // 4: somebody works there.
    let lock = rogs_orchestrator::lock::RunLock::acquire(&workspace.path("run")).unwrap();
    ends(
        &workspace.rogs(&["run", "manifest.toml", "--json"]),
        4,
        "is in use by process",
    );
    ends(&workspace.rogs(&["gc", "run"]), 4, "hint: ");
    drop(lock);
    ends(&workspace.rogs(&["run", "manifest.toml", "--no-report"]), 0, "");
    assert_eq!(workspace.rogs(&["status", "run"]).status.code(), Some(0));

    // 1: a check found something, or nothing could be done; standard output has the value all the same.
    let episode = std::fs::read_dir(workspace.path("data/episodes"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let clip = workspace
        .path("run/clips")
        .join(episode.file_name().unwrap())
        .join("robot.r4c");
    let mut bytes = std::fs::read(&clip).unwrap();
    bytes[70] ^= 1;
    std::fs::write(&clip, bytes).unwrap();
    let (code, found) = workspace.rogs_json(&["verify", "run", "--json"]);
    assert_eq!((code, found["bad"].as_array().unwrap().len()), (Some(1), 1));
    std::fs::remove_file(episode.join("joints.csv")).unwrap();
    let (code, summary) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!((code, &summary["clips"]["failed"]), (Some(1), &json!(1)), "{summary:#}");
    assert_eq!(workspace.rogs(&["status", "run"]).status.code(), Some(1));
    // 3 is the end of `one_corrupt_episode_among_three`.
}

/// Waits for something that happens on any machine, however slow; the limit only turns a hang into a failure.
fn wait_until(what: &str, mut happened: impl FnMut() -> bool) {
    let start = Instant::now();
    while !happened() {
        assert!(start.elapsed() < Duration::from_secs(300), "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
#[cfg(unix)]
fn an_interrupted_run_ends_with_75_and_says_how_to_go_on() {
    use std::os::unix::fs::PermissionsExt as _;

    let workspace = Workspace::small(1);
    std::fs::create_dir(workspace.path("programs")).unwrap();
    // The worker of the second stage stands still until it is released.
    for stage in ["ingest", "robot-maps", "conditioning"] {
        let wait = match stage {
            "robot-maps" => "touch held; while [ ! -e release ]; do sleep 0.02; done",
            _ => ":",
        };
        let script =
            format!("#!/bin/sh\nif [ \"$1\" = worker ]; then {wait}; fi\nexec '{ROGS}' stage {stage} \"$@\"\n");
        workspace.write(&format!("programs/rogs-{stage}"), &script);
        let path = workspace.path(&format!("programs/rogs-{stage}"));
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    workspace.write(
        "manifest.toml",
        &manifest.replacen("[run]\n", "[run]\nstages = [\"conditioning\"]\n", 1),
    );
    let child = Command::new(ROGS)
        .args([
            "run",
            "manifest.toml",
            "--programs",
            "programs",
            "--no-report",
            "--json",
        ])
        .current_dir(workspace.path("."))
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_until("the second stage", || workspace.path("held").exists());
    let interrupt = format!("kill -s INT {}", child.id());
    assert!(Command::new("sh").args(["-c", &interrupt]).status().unwrap().success());
    workspace.write("release", "");
    let output = child.wait_with_output().unwrap();
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(75), "{said}");
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    // The clip in hand may have got to the end of its unit.
    let units = |name: &str| summary["units"][name].as_u64().unwrap();
    assert!(units("left") >= 1 && units("made") + units("left") == 3, "{summary:#}");
    assert!(
        said.contains("Resume with: rogs run manifest.toml"),
        "it says how to resume: {said}"
    );
    let (code, summary) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!((code, &summary["clips"]["done"]), (Some(0), &json!(1)), "{summary:#}");
    assert!(summary["units"]["up_to_date"].as_u64().unwrap() >= 1, "{summary:#}");
}

#[test]
fn exported_lines_run_through_xargs_give_the_bytes_of_a_local_run() {
    let workspace = Workspace::small(2);
    workspace.manifest("exported.toml", "exported");
    assert_eq!(
        workspace.rogs(&["run", "manifest.toml", "--no-report"]).status.code(),
        Some(0)
    );
    let output = workspace.rogs(&["plan", "exported.toml", "--emit", "jsonl", "--shards", "2"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let lines = text(&output.stdout);
    assert_eq!(lines.lines().count(), 12, "{lines}");
    // A stage at a time, its shards side by side, as `docs/slurm.md` has it.
    for stage in ["ingest", "robot-maps", "conditioning", "lift", "refine", "score"] {
        let of_stage: Vec<&str> = lines
            .lines()
            .filter(|line| line.contains(&format!(" stage {stage} ")))
            .collect();
        assert_eq!(of_stage.len(), 2, "{stage}");
        workspace.write("lines", &(of_stage.join("\n") + "\n"));
        let status = Command::new("sh")
            .args(["-c", "xargs -d '\\n' -n 1 -P 2 sh -c < lines"])
            .current_dir(workspace.path("."))
            .output()
            .unwrap();
        assert!(status.status.success(), "{stage}: {}", text(&status.stderr));
    }
    assert_eq!(workspace.rogs(&["status", "exported"]).status.code(), Some(0));
    let (local, exported) = (workspace.outputs("run"), workspace.outputs("exported"));
    assert_eq!(local.len(), 14);
    assert!(local == exported, "an exported plan differs from a local run");
    let (code, difference) = workspace.rogs_json(&["diff", "run", "exported", "--json"]);
    assert_eq!((code, &difference["same"]), (Some(0), &json!(14)));
}

#[test]
fn shells_complete_commands_and_options() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = Command::new(ROGS).args(["completions", shell]).output().unwrap();
        let script = text(&output.stdout);
        assert!(output.status.success(), "{shell}");
        for word in ["explain", "no-report", "inspect", "weights"] {
            assert!(script.contains(word), "{shell}: `{word}` is not completed");
        }
    }
    let output = Command::new(ROGS).args(["completions", "csh"]).output().unwrap();
    ends(&output, 2, "bash");
}

#[needs(bash)]
#[test]
fn bash_completes_with_its_script() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rogs.bash");
    std::fs::write(
        &path,
        Command::new(ROGS)
            .args(["completions", "bash"])
            .output()
            .unwrap()
            .stdout,
    )
    .unwrap();
    let ask = format!(
        "source '{}'; COMP_WORDS=(rogs pl); COMP_CWORD=1; _rogs rogs pl rogs; echo \"${{COMPREPLY[*]}}\"",
        path.display()
    );
    let output = Command::new("bash").args(["-c", &ask]).output().unwrap();
    assert_eq!(text(&output.stdout).trim(), "plan", "{}", text(&output.stderr));
}

#[test]
fn the_published_schema_is_that_of_the_program_and_knows_every_parameter() {
    let output = Command::new(ROGS).args(["schema", "manifest"]).output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../manifests");
    let file = root.join("manifest.schema.json");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::write(&file, &output.stdout).unwrap();
    }
    let published = std::fs::read(&file).expect("manifests/manifest.schema.json; UPDATE_EXPECT=1 writes it");
    let mut schema: Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut published: Value = serde_json::from_slice(&published).unwrap();
    // What is allowed must agree; words may be older.
    without_words(&mut schema);
    without_words(&mut published);
    assert!(
        published == schema,
        "manifests/manifest.schema.json is old: UPDATE_EXPECT=1 cargo test --workspace --test command_line schema"
    );
    let mut references = 0;
    every_reference(&schema, &mut |reference| {
        references += 1;
        let pointer = reference.strip_prefix('#').expect("within the file");
        assert!(schema.pointer(pointer).is_some(), "`{reference}` leads nowhere");
    });
    assert!(references > 20);
    assert_eq!(schema["properties"]["lift"]["$ref"], "#/$defs/lift");
    assert_eq!(
        schema["$defs"]["Variant"]["properties"]["robot-maps"]["$ref"],
        "#/$defs/robot-maps"
    );
    for stage in ["ingest", "robot-maps", "conditioning", "lift", "refine", "score"] {
        let output = Command::new(ROGS).args(["stage", stage, "describe"]).output().unwrap();
        let description: Value = serde_json::from_slice(&output.stdout).unwrap();
        for name in description["default_params"].as_object().unwrap().keys() {
            assert!(schema["$defs"][stage]["properties"][name].is_object(), "{stage}.{name}");
        }
    }
    // The examples keep to it: every table and key of theirs is known.
    let mut checked = 0;
    for entry in std::fs::read_dir(&root).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "toml") {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            text.starts_with("#:schema manifest.schema.json\n"),
            "{}: editors find no schema",
            path.display()
        );
        let manifest: toml::Value = toml::from_str(&text).unwrap();
        known(&schema, &schema, &manifest, &path.display().to_string());
        checked += 1;
    }
    assert!(checked >= 5);
}

/// Takes descriptions out, but not parameters of that name.
fn without_words(value: &mut Value) {
    match value {
        Value::Object(table) => {
            table.retain(|key, value| key != "description" || !value.is_string());
            table.values_mut().for_each(without_words);
        }
        Value::Array(items) => items.iter_mut().for_each(without_words),
        _ => {}
    }
}

fn every_reference(value: &Value, visit: &mut dyn FnMut(&str)) {
    match value {
        Value::Object(table) => {
            if let Some(Value::String(reference)) = table.get("$ref") {
                visit(reference);
            }
            table.values().for_each(|value| every_reference(value, visit));
        }
        Value::Array(items) => items.iter().for_each(|item| every_reference(item, visit)),
        _ => {}
    }
}

/// Fails when a table has a key that its schema does not allow.
fn known(root: &Value, schema: &Value, value: &toml::Value, place: &str) {
    let mut schema = schema;
    while let Some(reference) = schema["$ref"].as_str() {
        schema = root.pointer(&reference[1..]).unwrap();
    }
    if let Some(choices) = schema["anyOf"].as_array() {
        // An option: the other choice is null.
        let Some(choice) = choices.iter().find(|choice| choice["type"] != "null") else {
            return;
        };
        return known(root, choice, value, place);
    }
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let place = format!("{place}: {key}");
                match schema["properties"].get(key) {
                    Some(below) => known(root, below, value, &place),
                    None => assert!(
                        schema["additionalProperties"] != json!(false),
                        "{place} is not in the schema"
                    ),
                }
            }
        }
        toml::Value::Array(items) => items.iter().for_each(|item| known(root, &schema["items"], item, place)),
        _ => {}
    }
}

#[test]
fn effective_values_say_where_they_come_from() {
    let workspace = Workspace::small(1);
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    workspace.write("manifest.toml", &format!("{manifest}\n[executor]\nthreads = 3\n"));
    let arguments = ["config", "show", "manifest.toml", "--workers", "2"];
    let output = workspace.rogs(&arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    let line = |key: &str| {
        let found = said.lines().find(|line| line.starts_with(&format!("{key} = ")));
        found.unwrap_or_else(|| panic!("no `{key}`: {said}")).to_owned()
    };
    let written = manifest.lines().position(|line| line.starts_with("height = ")).unwrap() + 1;
    assert!(line("ingest.height").ends_with(&format!("# line {written}")), "{said}");
    assert!(line("ingest.frames").ends_with("# default"), "{said}");
    assert!(line("executor.workers").starts_with("executor.workers = 2 "), "{said}");
    assert!(line("executor.workers").ends_with("# command line"), "{said}");
    // The workers of the command line decide on the threads, whatever the manifest says.
    assert!(line("executor.threads").ends_with("# this machine"), "{said}");
    assert!(line("robot.spec.base_link").contains("panda_link0"), "{said}");
    // Nothing that it names need be there, and the environment is told.
    workspace.write("manifest.toml", &manifest.replace("data/episodes", "gone"));
    let output = Command::new(ROGS)
        .args(["config", "show", "manifest.toml"])
        .current_dir(workspace.path("."))
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    assert!(
        text(&output.stdout).contains("NO_COLOR = \"1\""),
        "{}",
        text(&output.stderr)
    );
}

#[test]
fn less_and_more_is_told_and_the_result_is_the_same() {
    let workspace = Workspace::small(1);
    let told = |name: &str, flag: &[&str]| {
        workspace.manifest("m.toml", name);
        let manifest = std::fs::read_to_string(workspace.path("m.toml")).unwrap();
        let manifest = manifest.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1);
        workspace.write("m.toml", &manifest);
        let output = workspace.rogs(&[&["run", "m.toml", "--no-report"], flag].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert!(
            text(&output.stdout).contains("1 of 1 clips done"),
            "{}",
            text(&output.stdout)
        );
        text(&output.stderr)
    };
    let (quiet, usual, detailed) = (told("q", &["-q"]), told("u", &[]), told("v", &["-v"]));
    assert!(!quiet.contains("[1/2]"), "{quiet}");
    assert!(
        usual.contains("[2/2]") && !usual.contains("starts on worker"),
        "{usual}"
    );
    assert!(
        usual.contains("about ") && usual.contains(" left"),
        "time is told from the start: {usual}"
    );
    assert!(
        detailed.contains("[2/2]") && detailed.contains("starts on worker"),
        "{detailed}"
    );
    let both = workspace.rogs(&["run", "m.toml", "-q", "-v"]);
    assert_eq!(both.status.code(), Some(2));
}

#[test]
fn a_table_of_degrees_warns() {
    let workspace = Workspace::small(1);
    workspace.write("degrees.csv", "panda_joint1,panda_joint4\n90,-105\n45,-100\n");
    let output = workspace.rogs(&["fk", "data/robot/panda_synth.urdf", "--joints", "degrees.csv"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stderr);
    assert!(
        said.contains("warning: `degrees.csv`: joint `panda_joint4` leaves its limits"),
        "{said}"
    );
    assert!(
        said.contains("in 2 of 2 rows (worst value -105.0000); are the values degrees"),
        "{said}"
    );
}

#[test]
fn colours_are_forced_and_switched_off_by_the_environment() {
    let said = |variable: &str| {
        let output = Command::new(ROGS)
            .args(["status", "nowhere"])
            .env_remove("NO_COLOR")
            .env_remove("CLICOLOR_FORCE")
            .env(variable, "1")
            .output()
            .unwrap();
        text(&output.stderr)
    };
    assert!(
        said("CLICOLOR_FORCE").starts_with("\u{1b}[31merror:\u{1b}[0m "),
        "{}",
        said("CLICOLOR_FORCE")
    );
    assert!(said("NO_COLOR").starts_with("error: "), "{}", said("NO_COLOR"));
}

/// Every URDF of `example-robot-data` in random states: all links as pinocchio has them, to 1e-9.
#[needs(pinocchio)]
#[test]
fn link_poses_of_public_robots_are_those_of_pinocchio() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/robots/compare_with_pinocchio.py");
    let python = std::env::var("ROGS_PEER_PYTHON").unwrap_or_else(|_| "python3".into());
    let output = Command::new(python)
        .arg(script)
        .args(["--states", "2", "--rogs", &format!("'{ROGS}' fk")])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}{}",
        text(&output.stdout),
        text(&output.stderr)
    );
    assert!(
        text(&output.stdout).contains(" robots, 0 fail"),
        "{}",
        text(&output.stdout)
    );
}
