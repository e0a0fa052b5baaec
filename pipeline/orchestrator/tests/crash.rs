//! Killing everything at any moment: nothing is lost, nothing is half written, the bytes stay the same.

mod common;

use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use common::{Workspace, example, walk};
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

fn orchestrator(workspace: &Workspace, workers: u32) -> Child {
    let manifest = workspace.path("toy.toml");
    let mut command = Command::new(example("toy_pipeline"));
    command
        .arg("run")
        .arg(manifest)
        .args([workers.to_string(), "1".to_owned()]);
    command
        .process_group(0)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command.spawn().unwrap()
}

fn send(signal: &str, target: &str) {
    let _ = Command::new("kill")
        .args([signal, "--", target])
        .stderr(Stdio::null())
        .status();
}

/// Process numbers of the workers of an orchestrator.
fn children(parent: u32) -> Vec<u32> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Ok(id) = entry.file_name().to_string_lossy().parse::<u32>() else {
            continue;
        };
        let stat = std::fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
        // The parent is the second field behind the name, which stands in parentheses.
        let after = stat
            .rsplit_once(')')
            .map(|(_, after)| after.to_owned())
            .unwrap_or_default();
        if after.split_whitespace().nth(1).and_then(|field| field.parse().ok()) == Some(parent) {
            found.push(id);
        }
    }
    found
}

fn wait(mut child: Child, what: &str) -> ExitStatus {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        assert!(start.elapsed() < Duration::from_secs(120), "{what} does not end");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Waits until no process holds the workspace any more: workers of a killed orchestrator end by themselves.
fn wait_for_workers(workspace: &Workspace) {
    let place = workspace.path("").display().to_string();
    let start = Instant::now();
    let busy = || {
        let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
        let opens = |folder: &Path| {
            std::fs::read_dir(folder.join("fd"))
                .into_iter()
                .flatten()
                .flatten()
                .any(|fd| std::fs::read_link(fd.path()).is_ok_and(|file| file.to_string_lossy().starts_with(&place)))
        };
        entries
            .filter(|entry| {
                entry
                    .file_name()
                    .to_string_lossy()
                    .parse::<u32>()
                    .is_ok_and(|id| id != std::process::id())
            })
            .any(|entry| opens(&entry.path()))
    };
    while busy() {
        assert!(
            start.elapsed() < Duration::from_secs(30),
            "a worker outlives its orchestrator"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Kills in `rounds` rounds, each time something else at another moment, then lets the run finish.
fn kill_loop(rounds: u64, workers: u32) {
    let undisturbed = Workspace::new();
    for name in ["a", "b", "c", "d"] {
        undisturbed.episode(name, &format!("{name} sleep@conditioning sleep@refine"));
    }
    undisturbed.run();
    let expected = undisturbed.outputs();
    let workspace = Workspace::new();
    let mut random = Random(42 + u64::from(workers));
    let mut kills = 0;
    for round in 0..rounds {
        for name in ["a", "b", "c", "d"] {
            workspace.episode(name, &format!("{name} sleep@conditioning sleep@refine"));
        }
        let child = orchestrator(&workspace, workers);
        std::thread::sleep(Duration::from_millis(random.below(700)));
        match random.below(3) {
            0 => send("-KILL", &child.id().to_string()),
            1 => children(child.id())
                .iter()
                .for_each(|worker| send("-KILL", &worker.to_string())),
            _ => send("-KILL", &format!("-{}", child.id())),
        }
        let status = wait(child, "a killed orchestrator");
        kills += u64::from(status.signal() == Some(9));
        wait_for_workers(&workspace);
        // Whatever lies there is whole: a reader never meets half a file.
        for (name, bytes) in workspace.outputs() {
            assert!(expected[&name] == bytes, "round {round}: `{}` differs", name.display());
        }
        if round % 4 == 3 {
            // Start afresh, so that kills hit every phase of a run.
            std::fs::remove_dir_all(workspace.run_folder()).unwrap();
        }
    }
    assert!(kills > 0);
    let status = wait(orchestrator(&workspace, workers), "the last run");
    assert_eq!(status.code(), Some(0));
    assert!(
        workspace.outputs() == expected,
        "the tree of outputs is that of an undisturbed run"
    );
    assert!(workspace.temporaries().is_empty(), "{:?}", workspace.temporaries());
}

#[test]
fn killed_runs_resume_to_the_same_bytes() {
    kill_loop(5, 1);
    kill_loop(5, 2);
}

#[test]
#[ignore = "long: 100 rounds of kills"]
fn a_hundred_kills_lose_nothing() {
    kill_loop(50, 1);
    kill_loop(50, 2);
}

#[test]
fn what_is_done_is_not_made_again_after_a_kill() {
    let workspace = Workspace::new();
    workspace.episode("b", "sleep@refine sleep@lift sleep@score");
    let child = orchestrator(&workspace, 1);
    let start = Instant::now();
    while workspace.outputs().len() < 5 {
        assert!(start.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(2));
    }
    send("-KILL", &child.id().to_string());
    wait(child, "a killed orchestrator");
    wait_for_workers(&workspace);
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
        workspace.episode(name, "sleep@ingest sleep@robot-maps sleep@lift sleep@refine");
    }
    let child = orchestrator(&workspace, 2);
    let start = Instant::now();
    while workspace.outputs().is_empty() {
        assert!(start.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(2));
    }
    send("-INT", &child.id().to_string());
    assert_eq!(wait(child, "an interrupted orchestrator").code(), Some(75));
    assert!(workspace.temporaries().is_empty());
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
    workspace.episode("a", "hang@lift");
    let first = orchestrator(&workspace, 1);
    let start = Instant::now();
    while !workspace.run_folder().join("clips/a/conditioning.r4c").exists() {
        assert!(start.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(status::status(&workspace.run_folder()).unwrap().active);
    assert_eq!(
        wait(orchestrator(&workspace, 1), "the second orchestrator").code(),
        Some(4)
    );
    send("-KILL", &first.id().to_string());
    wait(first, "the first orchestrator");
    wait_for_workers(&workspace);
    workspace.episode("a", "well again");
    assert_eq!(
        wait(orchestrator(&workspace, 1), "the third orchestrator").code(),
        Some(0)
    );
}
