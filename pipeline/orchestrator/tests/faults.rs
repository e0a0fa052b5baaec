//! What the world does to a run besides killing it: operations that fail, full disks, limits, hangs, wrong clocks.
//! `docs/faults.md` is the table of these cases.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, SystemTime};

use common::{Workspace, example, walk};
use rogs_needs::needs;
use rogs_orchestrator::{Exit, gc, ledger, status};
use rogs_schemas::ledger::{Attempt, Failure, Outcome};
use rogs_schemas::protocol::FailureCode;

type Outputs = BTreeMap<PathBuf, Vec<u8>>;

/// Kinds of file operations that `ROGS_FAULTS` can strike.
const KINDS: [&str; 8] = ["create", "write", "short", "sync", "rename", "folder", "append", "open"];

/// One good episode, so that a run takes little.
fn small() -> Workspace {
    let workspace = Workspace::new();
    for name in ["b", "c"] {
        std::fs::remove_file(workspace.path(&format!("episodes/{name}.txt"))).unwrap();
    }
    workspace
}

/// Runs the orchestrator as a process of its own.
fn run(workspace: &Workspace, environment: &[(&str, &str)]) -> Output {
    Command::new(example("toy_pipeline"))
        .arg("run")
        .arg(workspace.path("toy.toml"))
        .args(["1", "1"])
        .envs(environment.iter().copied())
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs again without trouble: everything is there, as if nothing had happened.
fn recovers(workspace: &Workspace, expected: &Outputs, what: &str) {
    let output = run(workspace, &[]);
    assert_eq!(output.status.code(), Some(0), "{what}: {}", stderr(&output));
    assert!(workspace.outputs() == *expected, "{what}: other outputs");
    gc::collect(&workspace.run_folder(), false).unwrap();
    assert!(
        workspace.temporaries().is_empty(),
        "{what}: {:?}",
        workspace.temporaries()
    );
}

/// Strikes the n-th operation of every kind with each of `faults`, for n up to `most` or until none is left to strike.
/// Returns how many runs were struck.
fn strike(faults: &[&str], most: u32) -> u32 {
    let undisturbed = small();
    undisturbed.run();
    let expected = undisturbed.outputs();
    // A run waits more than it works, so all kinds at a time.
    std::thread::scope(|scope| {
        let threads = KINDS.map(|kind| scope.spawn(|| strike_kind(kind, faults, most, &expected)));
        threads.into_iter().map(|thread| thread.join().unwrap()).sum()
    })
}

fn strike_kind(kind: &str, faults: &[&str], most: u32, expected: &Outputs) -> u32 {
    let workspace = small();
    let log = workspace.path("faults.log");
    let mut struck = 0;
    for fault in faults {
        for number in 1..=most {
            // With a plus all later operations of the kind fail as well.
            let what = match fault.strip_prefix('+') {
                Some(fault) => format!("{kind}:{number}+={fault}"),
                None => format!("{kind}:{number}={fault}"),
            };
            let _ = std::fs::remove_dir_all(workspace.run_folder());
            let _ = std::fs::remove_file(&log);
            if kind == "open" {
                // There must be something to open.
                recovers(&workspace, expected, &what);
                std::fs::remove_file(workspace.run_folder().join("clips/a/conditioning.r4c")).unwrap();
            }
            let output = run(
                &workspace,
                &[("ROGS_FAULTS", &what), ("ROGS_FAULTS_LOG", &log.display().to_string())],
            );
            let text = stderr(&output);
            assert!(!text.contains("panicked"), "{what}: {text}");
            let outputs = workspace.outputs();
            for (name, bytes) in &outputs {
                assert!(expected[name] == *bytes, "{what}: `{}` is wrong", name.display());
            }
            if output.status.code() == Some(0) {
                assert_eq!(outputs.len(), 7, "{what}: done, but not everything is there");
            }
            if !log.exists() {
                assert_eq!(output.status.code(), Some(0), "{what}: {text}");
                break;
            }
            struck += 1;
            recovers(&workspace, expected, &what);
        }
    }
    struck
}

#[test]
fn an_operation_that_fails_or_a_process_that_dies_at_it_loses_nothing() {
    assert!(strike(&["EIO", "abort"], 1) >= 2 * KINDS.len() as u32 - 2);
}

#[needs(long = "every file operation of a run fails in eight ways")]
#[test]
fn any_operation_may_fail_in_any_way() {
    let struck = strike(
        &["EIO", "ENOSPC", "EDQUOT", "EINTR", "EMFILE", "abort", "+EIO", "+ENOSPC"],
        40,
    );
    println!("{struck} runs were struck");
    assert!(struck > 100, "{struck}");
}

/// A small file system in memory; needs root and the right to mount.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(at: PathBuf, size: &str) -> Self {
        std::fs::create_dir_all(&at).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"])
            .arg(&at)
            .status();
        assert!(mounted.unwrap().success(), "a small file system cannot be mounted here");
        Self(at)
    }

    fn grow(&self, size: &str) {
        self.remount(&format!("size={size}"));
    }

    fn remount(&self, options: &str) {
        let status = Command::new("mount")
            .args(["-o", &format!("remount,{options}")])
            .arg(&self.0)
            .status();
        assert!(status.unwrap().success());
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[needs(mount)]
#[test]
fn a_full_disk_fails_with_a_hint_and_a_larger_one_goes_on() {
    let undisturbed = Workspace::new();
    undisturbed.run();
    let expected = undisturbed.outputs();
    let workspace = Workspace::new();
    // From too small for anything to too small for the last outputs.
    let disk = SmallDisk::mount(workspace.run_folder(), "8k");
    let mut failed = 0;
    for size in ["8k", "16k", "32k", "64k", "96k"] {
        disk.grow(size);
        let output = run(&workspace, &[]);
        let text = stderr(&output);
        assert!(!text.contains("panicked"), "{size}: {text}");
        let code = output.status.code();
        if code != Some(0) {
            failed += 1;
            assert!([Some(1), Some(3), Some(70)].contains(&code), "{size}: {code:?}: {text}");
            assert!(
                text.contains("No space left") || text.contains("space"),
                "{size}: {text}"
            );
        }
        for (name, bytes) in workspace.outputs() {
            assert!(expected[&name] == bytes, "{size}: `{}` is wrong", name.display());
        }
    }
    assert!(failed > 0);
    disk.grow("64m");
    recovers(&workspace, &expected, "after the disk grew");
}

/// A manifest whose stages are scripts around the toy's, so that limits hold for one stage alone.
fn with_limit(workspace: &Workspace, stage: &str, limit: &str, more: &str) {
    for name in ["ingest", "robot-maps", "conditioning", "lift", "refine", "score"] {
        let limit = if name == stage { limit } else { ":" };
        let script = format!(
            "#!/bin/sh\nif [ \"$1\" = worker ]; then {limit}; fi\nexec '{}' stage {name} \"$@\"\n",
            example("toy_pipeline").display()
        );
        workspace.script(&format!("programs/rogs-{name}"), &script);
    }
    workspace.manifest(&format!("[executor]\nprograms = \"programs\"\n{more}"));
}

#[test]
fn a_limit_on_file_sizes_is_named() {
    let workspace = Workspace::new();
    with_limit(&workspace, "lift", "ulimit -f 1", "");
    let summary = workspace.run();
    assert_eq!((summary.exit, summary.clips.failed), (Exit::Failed, 3));
    for failure in &summary.failures {
        assert_eq!(
            (failure.node.as_str(), failure.code),
            ("lift", FailureCode::Resource),
            "{failure:?}"
        );
        assert!(
            failure.hint.as_deref().unwrap_or_default().contains("ulimit -f"),
            "{failure:?}"
        );
    }
    workspace.manifest("");
    assert_eq!(workspace.run().exit, Exit::Done);
}

#[test]
fn a_stage_that_runs_out_of_memory_costs_its_clip_and_nothing_else() {
    let workspace = Workspace::new();
    workspace.episode("b", "memory@lift");
    with_limit(&workspace, "lift", "ulimit -v 280000", "");
    let summary = workspace.run();
    assert_eq!(
        (summary.exit, summary.clips.done, summary.clips.failed),
        (Exit::Partial, 2, 1)
    );
    let failure = &summary.failures[0];
    assert_eq!(
        (failure.clip.as_str(), failure.node.as_str(), failure.code),
        ("b", "lift", FailureCode::Resource)
    );
    assert!(
        failure.hint.as_deref().unwrap_or_default().contains("fewer workers"),
        "{failure:?}"
    );
    let tries = ledger::read_all(&workspace.run_folder()).unwrap();
    let tries = tries
        .iter()
        .filter(|attempt| attempt.clip_id == "b" && attempt.stage == "lift")
        .count();
    assert_eq!(tries, 2, "once more, alone");
}

#[test]
fn a_worker_that_hears_no_signal_is_killed_after_its_deadline() {
    let workspace = Workspace::new();
    workspace.episode("c", "stop@refine");
    workspace.manifest("[executor]\ngrace = 0.0\n[executor.deadline]\nrefine = 0.3\n");
    let mut prepared = workspace.prepare();
    prepared.options.only = Some(vec![2]);
    let summary = prepared.run().unwrap();
    assert_eq!(summary.clips.failed, 1);
    assert!(
        summary.failures[0].message.contains("took longer than 0.3 s"),
        "{:?}",
        summary.failures
    );
    workspace.episode("c", "well again");
    workspace.manifest("");
    assert_eq!(workspace.run().clips.done, 3);
}

#[test]
fn a_clock_that_went_back_changes_nothing() {
    let workspace = Workspace::new();
    workspace.run();
    let run = workspace.run_folder();
    // Records and outputs from the future.
    let one = &ledger::read_all(&run).unwrap()[0];
    let future = Attempt {
        unix_ms: 4_102_444_800_000,
        outcome: Outcome::Failed,
        failure: Some(Failure {
            code: FailureCode::Io,
            message: "from the future".into(),
            hint: None,
        }),
        ..one.clone()
    };
    rogs_r4c::ledger::append(&run.join("ledger/future.jsonl"), &future).unwrap();
    let stamp = |path: &Path, time: SystemTime| {
        let file = std::fs::File::options().append(true).open(path).unwrap();
        file.set_modified(time).unwrap();
    };
    let later = SystemTime::now() + Duration::from_secs(1 << 30);
    walk(&run.join("clips"), &mut |path| stamp(path, later));
    assert_eq!(status::status(&run).unwrap().exit, Exit::Done);
    assert_eq!(workspace.run().units.made, 0);
    // An episode that was changed while the clock was wrong: as long as before, and older.
    let episode = workspace.path("episodes/a.txt");
    let before = SystemTime::now() - Duration::from_secs(86_400);
    stamp(&episode, before);
    assert_eq!(workspace.run().units.made, 0, "the content is the same");
    std::fs::write(&episode, "eno").unwrap();
    stamp(&episode, before - Duration::from_secs(60));
    assert_eq!(workspace.run().units.made, 7);
}

#[test]
fn inputs_may_be_read_only_and_are_left_as_they_are() {
    let workspace = Workspace::new();
    let inputs = workspace.path("episodes");
    assert!(
        Command::new("chmod")
            .args(["-R", "a-w"])
            .arg(&inputs)
            .status()
            .unwrap()
            .success()
    );
    let look = || {
        let mut found = Vec::new();
        walk(&inputs, &mut |path| {
            found.push((
                path.to_owned(),
                path.metadata().unwrap().modified().unwrap(),
                std::fs::read(path).unwrap(),
            ));
        });
        found
    };
    let before = look();
    assert_eq!(workspace.run().exit, Exit::Done);
    assert_eq!(look(), before);
    assert!(
        Command::new("chmod")
            .args(["-R", "u+w"])
            .arg(&inputs)
            .status()
            .unwrap()
            .success()
    );
}

#[needs(mount)]
#[test]
fn a_file_system_that_is_mounted_read_only_is_enough_for_inputs_and_named_where_a_run_shall_lie() {
    let workspace = Workspace::new();
    let disk = SmallDisk::mount(workspace.path("episodes"), "1m");
    // The mount hides the episodes that were there.
    for (name, text) in [("a", "one"), ("b", "two"), ("c", "three")] {
        workspace.episode(name, text);
    }
    disk.remount("ro");
    assert_eq!(workspace.run().exit, Exit::Done);
    let text = std::fs::read_to_string(workspace.path("toy.toml")).unwrap();
    workspace.write("toy.toml", &text.replace("\"run\"", "\"episodes/run\""));
    let output = run(&workspace, &[]);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(Exit::Environment.code().into()), "{text}");
    assert!(
        text.contains("making the folder") && text.contains("Read-only file system"),
        "{text}"
    );
}

#[test]
fn of_many_orchestrators_at_once_one_works_and_the_others_say_so() {
    let undisturbed = Workspace::new();
    undisturbed.run();
    let workspace = Workspace::new();
    let start = || {
        Command::new(example("toy_pipeline"))
            .arg("run")
            .arg(workspace.path("toy.toml"))
            .args(["1", "1"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    };
    let children: Vec<_> = (0..4).map(|_| start()).collect();
    let codes: Vec<Option<i32>> = children
        .into_iter()
        .map(|mut child| child.wait().unwrap().code())
        .collect();
    assert!(codes.contains(&Some(0)), "{codes:?}");
    assert!(codes.iter().all(|code| [Some(0), Some(4)].contains(code)), "{codes:?}");
    assert!(workspace.outputs() == undisturbed.outputs());
    let attempts = ledger::read_all(&workspace.run_folder()).unwrap();
    assert_eq!(attempts.len(), 21, "every unit was made once");
}

#[test]
fn nothing_is_cleaned_away_while_a_run_is_at_work() {
    let workspace = Workspace::new();
    workspace.run();
    let lock = rogs_orchestrator::lock::RunLock::acquire(&workspace.run_folder()).unwrap();
    workspace.write("run/clips/gone/clip.r4c", "of no plan");
    let error = gc::collect(&workspace.run_folder(), false).unwrap_err();
    assert_eq!(error.exit(), Exit::Locked);
    assert!(workspace.path("run/clips/gone/clip.r4c").exists());
    drop(lock);
    assert_eq!(gc::collect(&workspace.run_folder(), false).unwrap().files.len(), 1);
}
