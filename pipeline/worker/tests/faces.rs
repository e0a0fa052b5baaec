//! The faces of a stage program, through a real process: `examples/toy_stage.rs`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use rogs_r4c::Record as _;
use rogs_schemas::ClipId;
use rogs_schemas::interim::Interim;
use rogs_schemas::key::KeyMaterial;
use rogs_schemas::protocol::{Description, Event, FailureCode, Job, JobId};
use rogs_schemas::records::scores::Scores;
use serde_json::json;

/// `cargo test` builds examples beside the tests.
fn program() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let path = test.ancestors().nth(2).unwrap().join("examples/toy_stage");
    assert!(
        path.exists(),
        "run all targets of the crate (`cargo test -p rogs-worker`), so that examples are built"
    );
    path
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str, text: &str) -> PathBuf {
        std::fs::write(self.path(name), text).unwrap();
        self.path(name)
    }

    /// A job that copies a file with this text to `out.r4c`.
    fn job(&self, number: u64, text: &str) -> Job {
        let source = self.text(&format!("source-{number}"), text);
        let params = json!({});
        let material = KeyMaterial {
            stage: "toy".into(),
            stage_version: 3,
            schema: Scores::SCHEMA.to_string(),
            params: json!({"repeat": 1, "sleep": 0.0}).to_string(),
            inputs: [("source".to_owned(), format!("{number}"))].into(),
        };
        Job {
            job: JobId(number),
            clip_id: ClipId::made_of(&format!("clip-{number}")),
            inputs: [("source".to_owned(), source)].into(),
            output: self.path("out.r4c"),
            params,
            key: material.key(),
            material,
        }
    }

    fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).unwrap();
        let mut names: Vec<_> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }
}

struct Worker {
    child: Child,
    lines: std::io::Lines<BufReader<std::process::ChildStdout>>,
}

impl Worker {
    fn start() -> Self {
        Self::with(&[])
    }

    fn with(arguments: &[&str]) -> Self {
        let mut command = Command::new(program());
        command
            .arg("worker")
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        Self { child, lines }
    }

    fn event(&mut self) -> Event {
        serde_json::from_str(&self.lines.next().expect("an event").unwrap()).unwrap()
    }

    fn send(&mut self, job: &Job) {
        let mut line = serde_json::to_vec(job).unwrap();
        line.push(b'\n');
        self.child.stdin.as_mut().unwrap().write_all(&line).unwrap();
    }

    /// Sends a job and returns its last event.
    fn run(&mut self, job: &Job) -> Event {
        self.send(job);
        assert_eq!(self.event(), Event::Started { job: job.job });
        loop {
            match self.event() {
                Event::Progress { job: number, .. } => assert_eq!(number, job.job),
                last => return last,
            }
        }
    }

    fn finish(mut self) -> i32 {
        drop(self.child.stdin.take());
        self.child.wait().unwrap().code().unwrap()
    }
}

fn failure(event: Event) -> (FailureCode, String) {
    let Event::Failed { code, message, .. } = event else {
        panic!("expected a failure, got {event:?}")
    };
    (code, message)
}

fn warnings(event: Event) -> Vec<String> {
    let Event::Done {
        warnings,
        seconds,
        peak_rss_bytes,
        threads,
        ..
    } = event
    else {
        panic!("expected done, got {event:?}")
    };
    assert!(seconds.contains_key("total") && peak_rss_bytes > 0 && threads > 0);
    warnings
}

fn method(path: &Path) -> String {
    rogs_r4c::read_record::<Scores>(path).unwrap().0.summary.method
}

#[test]
fn a_worker_survives_clips_that_fail_and_panic() {
    let folder = Folder::new();
    let mut worker = Worker::start();
    assert_eq!(
        worker.event(),
        Event::Ready {
            stage: "toy".into(),
            stage_version: 3
        }
    );
    assert_eq!(
        failure(worker.run(&folder.job(1, "fail"))),
        (FailureCode::BadInput, "the text says so".into())
    );
    let (code, message) = failure(worker.run(&folder.job(2, "panic")));
    assert_eq!(code, FailureCode::Internal);
    assert!(
        message.contains("clip-2") && message.contains("the text says so"),
        "{message}"
    );
    assert_eq!(failure(worker.run(&folder.job(3, "silent"))).0, FailureCode::Internal);
    assert_eq!(failure(worker.run(&folder.job(4, "regret"))).0, FailureCode::BadInput);
    assert!(
        !folder.path("out.r4c").exists(),
        "an output that its stage took back must not stay"
    );
    worker.run(&folder.job(5, "hello"));
    assert_eq!(method(&folder.path("out.r4c")), "hello");
    assert_eq!(worker.finish(), 0);
}

#[test]
fn the_stage_is_loaded_once_and_again_when_a_source_changes_or_after_a_panic() {
    let folder = Folder::new();
    let mut worker = Worker::start();
    worker.event();
    let (one, mut two) = (folder.job(1, "a"), folder.job(1, "a"));
    assert_eq!(warnings(worker.run(&one)), ["loaded 1 times"]);
    assert_eq!(warnings(worker.run(&one)), ["loaded 1 times"]);
    two.inputs.insert("weights".into(), folder.text("weights", "w"));
    assert_eq!(warnings(worker.run(&two)), ["loaded 2 times"]);
    two.params = json!({"repeat": 2});
    two.material.params = json!({"repeat": 2, "sleep": 0.0}).to_string();
    two.key = two.material.key();
    assert_eq!(warnings(worker.run(&two)), ["loaded 3 times"]);
    assert_eq!(method(&folder.path("out.r4c")), "aa");
    worker.finish();
}

#[test]
fn outputs_carry_the_provenance_of_the_plan_and_of_what_was_read() {
    let folder = Folder::new();
    let mut worker = Worker::start();
    worker.event();
    let first = folder.job(1, "first");
    worker.run(&first);
    let (_, before) = rogs_r4c::read_record::<Scores>(&first.output).unwrap();
    assert_eq!(before.provenance.material, first.material);
    std::fs::rename(&first.output, folder.path("before.r4c")).unwrap();

    let mut second = folder.job(2, "second");
    second.inputs.insert("before".into(), folder.path("before.r4c"));
    second.material.inputs.insert("before".into(), first.key.to_string());
    second.key = second.material.key();
    worker.run(&second);
    let (record, info) = rogs_r4c::read_record::<Scores>(&second.output).unwrap();
    assert_eq!(record.summary.method, "first second");
    assert_eq!(info.provenance.input_content["before"], before.content);

    second.material.inputs.insert("before".into(), "00".repeat(16));
    second.key = second.material.key();
    assert!(failure(worker.run(&second)).1.contains("the plan names"));
    worker.finish();
}

#[test]
fn jobs_that_do_not_fit_the_program_are_refused() {
    let folder = Folder::new();
    let mut worker = Worker::start();
    worker.event();
    let good = folder.job(1, "a");
    let mut refuse = |change: &dyn Fn(&mut Job), why: &str| {
        let mut job = good.clone();
        change(&mut job);
        let (_, message) = failure(worker.run(&job));
        assert!(message.contains(why), "`{message}` should say `{why}`");
    };
    refuse(&|job| job.key.0[0] ^= 1, "is not that of its material");
    refuse(
        &|job| (job.material.stage_version = 2, job.key = job.material.key()).1,
        "stage version `2`",
    );
    refuse(
        &|job| (job.material.params = "{}".into(), job.key = job.material.key()).1,
        "parameters `{}`",
    );
    refuse(
        &|job| (job.material.schema = "x 1.0".into(), job.key = job.material.key()).1,
        "output schema `x 1.0`",
    );
    refuse(&|job| job.params = json!({"repaet": 2}), "repaet");
    refuse(&|job| job.inputs.clear(), "names no input `source`");
    refuse(
        &|job| drop(job.inputs.insert("source".into(), "gone".into())),
        "input `source` of clip `clip-1` is missing",
    );
    assert!(!good.output.exists());
    worker.finish();
}

#[test]
fn nothing_is_left_beside_the_output() {
    let folder = Folder::new();
    let mut worker = Worker::start();
    worker.event();
    assert_eq!(failure(worker.run(&folder.job(1, "litter"))).0, FailureCode::Io);
    worker.finish();
    assert_eq!(folder.names(), ["source-1"]);
}

#[test]
fn a_killed_job_goes_on_from_what_it_kept_and_another_does_not() {
    let folder = Folder::new();
    let [figures, picture, kept] = ["json", "png", "r4c"].map(|ending| format!("out.progress.{ending}"));
    let die = |job: &Job| {
        let mut worker = Worker::start();
        worker.event();
        worker.send(job);
        assert!(!worker.child.wait().unwrap().success());
    };
    let first = folder.job(1, "steps");
    die(&first);
    die(&first);
    assert_eq!(folder.names(), [&figures, &picture, &kept, "source-1"]);
    let shown: Interim = serde_json::from_slice(&std::fs::read(folder.path(&figures)).unwrap()).unwrap();
    assert_eq!((shown.key, shown.figures.update), (first.key, 2));
    assert_eq!(std::fs::read(folder.path(&picture)).unwrap(), b"picture");
    // A job of another key begins at its beginning, in the place of what was kept.
    die(&folder.job(2, "steps"));
    die(&first);
    die(&first);
    let mut worker = Worker::start();
    worker.event();
    warnings(worker.run(&first));
    assert_eq!(method(&first.output), "after 2");
    assert_eq!(folder.names(), ["out.r4c", "source-1", "source-2"]);
    // What is damaged counts as nothing, and what failed for good is taken away.
    folder.text(&kept, "no record");
    assert_eq!(failure(worker.run(&folder.job(1, "fail"))).0, FailureCode::BadInput);
    worker.finish();
    assert_eq!(folder.names(), ["out.r4c", "source-1", "source-2"]);
}

#[test]
fn termination_gives_up_the_clip_in_hand_and_exits_75() {
    let folder = Folder::new();
    let terminate = |worker: &Worker| {
        let id = worker.child.id().to_string();
        // The shell's own `kill` is there on every machine.
        let kill = format!("kill -s TERM {id}");
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    };
    let mut idle = Worker::start();
    idle.event();
    terminate(&idle);
    assert_eq!(idle.child.wait().unwrap().code(), Some(75));

    let mut job = folder.job(1, "slow");
    job.params = json!({"sleep": 30.0});
    job.material.params = json!({"repeat": 1, "sleep": 30.0}).to_string();
    job.key = job.material.key();
    let mut busy = Worker::with(&["--grace", "0"]);
    busy.event();
    busy.send(&job);
    busy.event();
    terminate(&busy);
    assert_eq!(busy.child.wait().unwrap().code(), Some(75));

    job.params = json!({"sleep": 0.3});
    job.material.params = json!({"repeat": 1, "sleep": 0.3}).to_string();
    job.key = job.material.key();
    let mut patient = Worker::with(&["--grace", "60"]);
    patient.event();
    patient.send(&job);
    patient.event();
    terminate(&patient);
    assert_eq!(patient.child.wait().unwrap().code(), Some(75));
    assert_eq!(
        method(&job.output),
        "slow",
        "a clip within the grace period is finished"
    );
    assert_eq!(folder.names(), ["out.r4c", "source-1"]);
}

#[test]
fn a_worker_whose_parent_is_gone_ends_within_its_grace_whatever_it_is_doing() {
    let folder = Folder::new();
    let (jobs, events) = (folder.path("jobs"), folder.path("events"));
    assert!(Command::new("mkfifo").arg(&jobs).status().unwrap().success());
    let script = r#""$1" worker --parent $$ --grace 0.2 <"$2" >"$3" 2>/dev/null & echo $!; wait"#;
    let mut parent = Command::new("sh")
        .args(["-c", script, "sh"])
        .args([&program(), &jobs, &events])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    // Held open to the end: the worker learns nothing from the end of its jobs.
    let mut sender = std::fs::File::options().read(true).write(true).open(&jobs).unwrap();
    let mut line = String::new();
    BufReader::new(parent.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let mut job = folder.job(1, "slow");
    job.params = json!({"sleep": 300.0});
    job.material.params = json!({"repeat": 1, "sleep": 300.0}).to_string();
    job.key = job.material.key();
    writeln!(sender, "{}", serde_json::to_string(&job).unwrap()).unwrap();
    let wait_until = |happened: &dyn Fn() -> bool, what: &str| {
        let begin = std::time::Instant::now();
        while !happened() {
            assert!(begin.elapsed().as_secs() < 100, "waited in vain for {what}");
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    };
    let begun = || std::fs::read_to_string(&events).unwrap_or_default().contains("started");
    wait_until(&begun, "the job to begin");
    parent.kill().unwrap();
    parent.wait().unwrap();
    // Whoever inherits the process may not have taken note of its end.
    let ended = || match std::fs::read_to_string(format!("/proc/{}/stat", line.trim())) {
        Ok(stat) => stat.contains(") Z "),
        Err(_) => true,
    };
    wait_until(&ended, "the worker to end");
}

#[test]
fn numbers_that_no_machine_has_are_refused() {
    for arguments in [
        ["worker", "--threads", "100000000"],
        ["worker", "--threads", "18446744073709551615"],
        ["worker", "--grace", "nan"],
        ["worker", "--grace", "inf"],
        ["worker", "--grace", "-1"],
        ["batch", "--grace", "1e300"],
    ] {
        let output = Command::new(program()).args(arguments).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(!said.contains("panicked"), "{said}");
    }
}

#[test]
fn a_stage_program_whose_messages_nobody_can_read_ends_as_ever() {
    let folder = Folder::new();
    let run = |text: &str, streams: &str| {
        let source = folder.text("source", text);
        let script = format!("exec \"$1\" one --source \"$2\" --out \"$3\" {streams}");
        Command::new("sh")
            .args(["-c", &script, "sh"])
            .args([&program(), &source, &folder.path("out.r4c")])
            .status()
            .unwrap()
            .code()
    };
    // What the stage itself prints to standard output is its own business.
    for streams in ["2>/dev/full", "2>&-"] {
        assert_eq!(run("good", streams), Some(0), "{streams}");
        assert_eq!(run("fail", streams), Some(1), "{streams}");
    }
    let describe = Command::new("sh")
        .args(["-c", "exec \"$1\" describe >/dev/full", "sh"])
        .arg(program())
        .output()
        .unwrap();
    assert_eq!(describe.status.code(), Some(2));
    assert!(
        stderr(&describe).contains("cannot print the answer"),
        "{}",
        stderr(&describe)
    );
}

#[test]
fn a_dead_worker_leaves_no_event_behind() {
    let folder = Folder::new();
    let mut worker = Worker::start();
    worker.event();
    worker.send(&folder.job(1, "abort"));
    let rest: Vec<_> = worker.lines.by_ref().map(|line| line.unwrap()).collect();
    assert!(
        rest.iter()
            .all(|line| !line.contains("done") && !line.contains("failed")),
        "{rest:?}"
    );
    assert_eq!(worker.child.wait().unwrap().code(), None);
}

fn one(arguments: &[&str]) -> Output {
    Command::new(program()).args(arguments).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn one_runs_a_clip_by_hand() {
    let folder = Folder::new();
    let source = folder.text("source", "by hand");
    let (source, out) = (source.to_str().unwrap(), folder.path("deep/out.r4c"));
    let done = one(&[
        "one",
        "--source",
        source,
        "--out",
        out.to_str().unwrap(),
        "--params",
        "repeat=2",
        "--threads",
        "1",
    ]);
    assert!(done.status.success(), "{}", stderr(&done));
    assert!(stderr(&done).contains("wrote"), "{}", stderr(&done));
    assert_eq!(method(&out), "by handby hand");
    let wrong = one(&["one", "--source", source, "--out", "x", "--params", "repaet=2"]);
    assert_eq!(wrong.status.code(), Some(1));
    assert!(stderr(&wrong).contains("repaet"), "{}", stderr(&wrong));
    let unknown = one(&["one", "--suorce", source]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(
        stderr(&unknown).contains("--source"),
        "clap suggests the right name: {}",
        stderr(&unknown)
    );
}

#[test]
fn describe_tells_what_a_plan_needs() {
    let output = one(&["describe", "--params", r#"{"repeat": 5}"#]);
    let description: Description = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((description.stage.as_str(), description.stage_version), ("toy", 3));
    assert_eq!(description.output_schema, Scores::SCHEMA.to_string());
    assert_eq!(description.default_params, json!({"repeat": 5, "sleep": 0.0}));
    assert!(description.params_schema["properties"]["sleep"]["description"].is_string());
    assert_eq!(description.inputs.iter().filter(|input| input.required).count(), 1);
}
