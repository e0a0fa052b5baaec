//! Killing everything at any moment: nothing is lost, nothing is half written, the bytes stay the same.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use common::{Workspace, example, walk};
use rogs_needs::needs;
use rogs_orchestrator::status;

/// A small generator, so that rounds differ and can be repeated.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

/// A moment in a run at which a worker stands still until it is released or killed.
struct Hold {
    folder: tempfile::TempDir,
    place: String,
}

impl Hold {
    /// At the start or end of a stage of a clip: `a@lift@begin`. An empty place holds nothing.
    fn at(place: &str) -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
            place: place.to_owned(),
        }
    }

    /// Waits until a worker stands there and returns its process number; `None` when the run ended without that.
    fn reached(&self, run: &mut Child) -> Option<String> {
        let held = self.folder.path().join("held");
        wait_until("a worker to get to its place", || {
            held.exists() || run.try_wait().unwrap().is_some()
        });
        std::fs::read_to_string(held).ok()
    }

    fn release(&self) {
        std::fs::write(self.folder.path().join("release"), "").unwrap();
    }

    /// Waits until no worker of this run lives any more: those of a killed orchestrator end by themselves.
    fn wait_for_workers(&self) {
        let file = std::fs::File::create(self.folder.path().join("alive")).unwrap();
        wait_until("the last worker to end", || file.try_lock().is_ok());
    }
}

/// Waits for something that happens on any machine, however slow; the limit only turns a hang into a failure.
fn wait_until(what: &str, mut happened: impl FnMut() -> bool) {
    let start = Instant::now();
    while !happened() {
        assert!(start.elapsed() < Duration::from_secs(120), "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(3));
    }
}

fn orchestrator(workspace: &Workspace, workers: u32, hold: &Hold) -> Child {
    let manifest = workspace.path("toy.toml");
    let mut command = Command::new(example("toy_pipeline"));
    command
        .arg("run")
        .arg(manifest)
        .args([workers.to_string(), "1".to_owned()]);
    command
        .env("ROGS_TOY_HOLD", &hold.place)
        .env("ROGS_TOY_FOLDER", hold.folder.path())
        .process_group(0)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command.spawn().unwrap()
}

/// Sends a signal through the shell, whose `kill` is there on every machine.
fn send(signal: &str, target: &str) {
    let _ = Command::new("sh")
        .args(["-c", &format!("kill -s {signal} -- {target}")])
        .stderr(Stdio::null())
        .status();
}

fn wait(mut child: Child, what: &str) -> ExitStatus {
    wait_until(what, || child.try_wait().unwrap().is_some());
    child.wait().unwrap()
}

/// Runs to the end without being disturbed.
fn finish(workspace: &Workspace, workers: u32) -> ExitStatus {
    wait(orchestrator(workspace, workers, &Hold::at("")), "a run to end")
}

/// Output files of a clip with the stages that make them.
const OUTPUTS: [(&str, &str); 7] = [
    ("clip.r4c", "ingest"),
    ("robot.r4c", "robot-maps"),
    ("conditioning.r4c", "conditioning"),
    ("field-1.r4c", "lift"),
    ("field-2.r4c", "refine"),
    ("scores-1.r4c", "score"),
    ("scores-2.r4c", "score"),
];

/// Kills something in every round - the orchestrator, the worker in hand, everything - while a unit that is still to be
/// made stands at its begin or its end, and now and then everything at an arbitrary time. Then lets the run finish.
fn kill_loop(rounds: u64, workers: u32) {
    let names = ["a", "b", "c", "d"];
    let undisturbed = Workspace::new();
    let workspace = Workspace::new();
    for name in names {
        undisturbed.episode(name, name);
        workspace.episode(name, name);
    }
    undisturbed.run();
    let expected = undisturbed.outputs();
    let mut random = Random(42 + u64::from(workers));
    for round in 0..rounds {
        let missing = |workspace: &Workspace| -> Vec<String> {
            let there = workspace.outputs();
            let units = names
                .iter()
                .flat_map(|name| OUTPUTS.map(|(file, stage)| (name, file, stage)));
            units
                .filter(|(name, file, _)| !there.contains_key(Path::new(&format!("clips/{name}/{file}"))))
                .map(|(name, _, stage)| format!("{name}@{stage}"))
                .collect()
        };
        let mut places = missing(&workspace);
        if places.is_empty() {
            std::fs::remove_dir_all(workspace.run_folder()).unwrap();
            places = missing(&workspace);
        }
        let place = &places[random.below(places.len() as u64) as usize];
        let moment = ["begin", "end"][random.below(2) as usize];
        let hold = Hold::at(&if round % 4 == 3 {
            String::new()
        } else {
            format!("{place}@{moment}")
        });
        let mut child = orchestrator(&workspace, workers, &hold);
        let group = format!("-{}", child.id());
        if round % 4 == 3 {
            std::thread::sleep(Duration::from_millis(random.below(400)));
            send("KILL", &group);
            wait(child, "a killed group to end");
        } else {
            let worker = hold.reached(&mut child).expect("the unit is still to be made");
            match round % 4 {
                0 => {
                    send("KILL", &child.id().to_string());
                    assert_eq!(wait(child, "a killed orchestrator to end").signal(), Some(9));
                }
                1 => {
                    send("KILL", &worker);
                    // The orchestrator continues with another worker.
                    assert_eq!(wait(child, "a run whose worker was killed").code(), Some(0), "{place}");
                    assert!(workspace.outputs() == expected, "round {round}");
                }
                _ => {
                    send("KILL", &format!("{group} {worker}"));
                    assert_eq!(wait(child, "a killed group to end").signal(), Some(9));
                }
            }
        }
        hold.release();
        hold.wait_for_workers();
        // Whatever lies there is whole: a reader never meets half a file.
        for (name, bytes) in workspace.outputs() {
            assert!(expected[&name] == bytes, "round {round}: `{}` differs", name.display());
        }
    }
    assert_eq!(finish(&workspace, workers).code(), Some(0));
    assert!(
        workspace.outputs() == expected,
        "the tree of outputs is that of an undisturbed run"
    );
    let folder = workspace.run_folder();
    rogs_orchestrator::gc::collect(&folder, false).unwrap();
    workspace.assert_no_temporaries();
}

#[test]
fn killed_runs_resume_to_the_same_bytes() {
    kill_loop(5, 1);
    kill_loop(5, 2);
}

#[needs(long = "100 rounds of kills")]
#[test]
fn a_hundred_kills_lose_nothing() {
    kill_loop(50, 1);
    kill_loop(50, 2);
}

#[test]
fn what_is_done_is_not_made_again_after_a_kill() {
    let workspace = Workspace::new();
    let hold = Hold::at("b@refine@begin");
    let mut child = orchestrator(&workspace, 1, &hold);
    hold.reached(&mut child).expect("the unit is still to be made");
    send("KILL", &child.id().to_string());
    wait(child, "a killed orchestrator to end");
    hold.release();
    hold.wait_for_workers();
    let times = || {
        let mut times = Vec::new();
        walk(&workspace.run_folder(), &mut |path| {
            if path.extension().is_some_and(|extension| extension == "r4c") {
                times.push((path.to_owned(), path.metadata().unwrap().modified().unwrap()));
            }
        });
        times
    };
    let before = times();
    let done = before.len();
    assert!(done >= 4, "what the held unit needs is there: {before:?}");
    let summary = workspace.run();
    assert_eq!((summary.units.up_to_date, summary.units.made), (done, 21 - done));
    let after = times();
    assert!(
        before.iter().all(|file| after.contains(file)),
        "a file that was done has been written again"
    );
}

#[test]
fn one_interrupt_drains_and_the_same_command_goes_on() {
    let workspace = Workspace::new();
    for name in ["a", "b", "c", "d", "e", "f"] {
        workspace.episode(name, name);
    }
    let hold = Hold::at("f@lift@begin");
    let mut child = orchestrator(&workspace, 2, &hold);
    hold.reached(&mut child).expect("the unit is still to be made");
    send("INT", &child.id().to_string());
    hold.release();
    assert_eq!(wait(child, "an interrupted orchestrator to end").code(), Some(75));
    hold.wait_for_workers();
    workspace.assert_no_temporaries();
    let status = status::status(&workspace.run_folder()).unwrap();
    assert!(
        status.failures.is_empty(),
        "a stopped clip has not failed: {:?}",
        status.failures
    );
    assert!(status.clips.done < 6 && !status.active);
    let summary = workspace.run();
    assert_eq!(summary.clips.done, 6);
    assert!(summary.units.up_to_date > 0);
}

#[test]
fn the_second_orchestrator_is_refused_with_its_own_exit_code() {
    let workspace = Workspace::new();
    let hold = Hold::at("a@lift@begin");
    let mut first = orchestrator(&workspace, 1, &hold);
    hold.reached(&mut first).expect("the unit is still to be made");
    assert!(status::status(&workspace.run_folder()).unwrap().active);
    assert_eq!(finish(&workspace, 1).code(), Some(4));
    send("KILL", &first.id().to_string());
    wait(first, "a killed orchestrator to end");
    hold.release();
    hold.wait_for_workers();
    assert_eq!(finish(&workspace, 1).code(), Some(0));
}
