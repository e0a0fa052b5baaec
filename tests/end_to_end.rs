//! The whole program on procedural episodes: outputs, resume, failures, determinism.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use std::process::{Command, Stdio};
use std::time::Duration;

use rogs_needs::needs;
use support::{ROGS, Workspace};

/// Output files of one clip of the main run.
const FILES: [&str; 7] = [
    "clip.r4c",
    "robot.r4c",
    "conditioning.r4c",
    "field-1.r4c",
    "field-2.r4c",
    "scores-1.r4c",
    "scores-2.r4c",
];

#[test]
fn a_run_makes_every_output_and_a_second_run_makes_none() {
    let workspace = Workspace::with_episodes(1);
    let (code, first) = workspace.rogs_json(&["run", "manifest.toml", "--json"]);
    assert_eq!(code, Some(0), "{first:#}");
    assert_eq!(first["units"]["made"], FILES.len());
    let outputs = workspace.outputs("run");
    assert_eq!(outputs.len(), FILES.len());
    for file in FILES {
        assert!(outputs.keys().any(|path| path.ends_with(file)), "{file} is missing");
    }

    // The report is one self-contained page with pictures, the scores, and the warning about untrained weights.
    let report = std::fs::read_to_string(first["report"].as_str().unwrap()).unwrap();
    assert!(report.contains("data:image/jpeg;base64,"));
    assert!(report.contains("UNTRAINED WEIGHTS"));
    // Its one script is the viewer's; the scenes lie beside it.
    let (before, viewer) = report.rsplit_once("<script>").unwrap();
    assert!(!before.contains("http://") && !before.contains("https://") && !before.contains("<script"));
    assert!(viewer.contains("rogsScene"));
    for scene in ["0001-1.js", "0001-2.js"] {
        assert!(workspace.path("run/report/scenes").join(scene).is_file(), "{scene}");
        assert!(before.contains(scene), "{scene}");
    }

    // Both methods have scores; what has no reference (LPIPS without weights) is null, what has one is a number.
    let (_, scores) = workspace.rogs_json(&["table", "run", "--table", "main", "--json"]);
    let text = scores.to_string();
    assert!(text.contains("stage1"), "{text}");

    let (code, second) = workspace.rogs_json(&["run", "manifest.toml", "--json"]);
    assert_eq!(code, Some(0));
    assert_eq!(second["units"]["made"], 0);
    assert_eq!(second["units"]["up_to_date"], FILES.len());
    assert_eq!(workspace.outputs("run"), outputs);

    // Deleting any file is safe: it is made again, with the same bytes.
    let (path, bytes) = outputs.iter().find(|(path, _)| path.ends_with("robot.r4c")).unwrap();
    std::fs::remove_file(workspace.path("run").join(path)).unwrap();
    let (code, third) = workspace.rogs_json(&["run", "run", "--json"]);
    assert_eq!((code, third["units"]["made"].as_u64()), (Some(0), Some(1)), "{third:#}");
    assert_eq!(&workspace.outputs("run")[path], bytes);
}

#[test]
fn outputs_do_not_depend_on_threads() {
    let workspace = Workspace::with_episodes(1);
    let mut runs = Vec::new();
    for threads in ["1", "2"] {
        let out = format!("run-{threads}");
        workspace.manifest("threads.toml", &out);
        let (code, summary) = workspace.rogs_json(&[
            "run",
            "threads.toml",
            "--workers",
            "1",
            "--threads",
            threads,
            "--no-report",
            "--json",
        ]);
        assert_eq!(code, Some(0), "{summary:#}");
        runs.push(workspace.outputs(&out));
    }
    for (path, bytes) in &runs[0] {
        assert!(
            runs[1][path] == *bytes,
            "{} differs between 1 and 2 threads",
            path.display()
        );
    }
}

#[test]
fn one_corrupt_episode_among_three() {
    let workspace = Workspace::small(3);
    let episodes = workspace.path("data/episodes");
    let mut folders: Vec<_> = std::fs::read_dir(&episodes)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    folders.retain(|path| path.is_dir());
    folders.sort();
    assert_eq!(folders.len(), 3);
    // A joint angle that is not a number, in row 3 of the middle episode.
    let states = std::fs::read_dir(&folders[1])
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.extension().is_some_and(|extension| extension == "csv"))
        .unwrap();
    let text = std::fs::read_to_string(&states).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    // The clip starts at frame 7 or later only in long episodes; damage a row inside it.
    let row = lines.len() / 2;
    let comma = lines[row].find(',').unwrap();
    lines[row] = format!("nan{}", &lines[row][comma..]);
    std::fs::write(&states, lines.join("\n") + "\n").unwrap();

    let (code, summary) = workspace.rogs_json(&["run", "manifest.toml", "--json"]);
    assert_eq!(code, Some(3), "some clips done, one failed: {summary:#}");
    assert_eq!(summary["clips"]["done"], 2);
    assert_eq!(summary["clips"]["failed"], 1);
    let message = summary["failures"][0].to_string();
    assert!(
        message.contains(".csv") || message.contains("row"),
        "the message names the place: {message}"
    );
    let report = std::fs::read_to_string(summary["report"].as_str().unwrap()).unwrap();
    assert!(report.contains("<h2>Failures</h2>"));

    let (code, status) = workspace.rogs_json(&["status", "run", "--json"]);
    assert_eq!(code, Some(3));
    assert_eq!(status["clips"]["failed"], 1);
}

/// Kills the whole process group of a run at ten stages of its progress, resumes, and compares with an undisturbed run.
#[cfg(unix)]
#[needs(long = "ten kills and resumes with 1 and with 2 threads")]
#[test]
fn killed_runs_resume_to_the_same_bytes() {
    use std::os::unix::process::CommandExt as _;

    let workspace = Workspace::small(2);
    let (code, _) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(0));
    let expected = workspace.outputs("run");

    for threads in ["1", "2"] {
        let out = format!("killed-{threads}");
        workspace.manifest("killed.toml", &out);
        let text = std::fs::read_to_string(workspace.path("killed.toml")).unwrap();
        // Workers that have lost their orchestrator stop at once.
        workspace.write("killed.toml", &format!("{text}\n[executor]\ngrace = 0.0\n"));
        let mut kills = 0;
        for round in 0..10 {
            let mut child = Command::new(ROGS)
                .args(["run", "killed.toml", "--threads", threads, "--no-report"])
                .current_dir(workspace.path("."))
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .process_group(0)
                .spawn()
                .unwrap();
            // Kills fall behind every output that is new, or a little later, inside the next stages.
            let goal = round + 1;
            wait_until("the next output", || {
                workspace.outputs(&out).len() >= goal || child.try_wait().unwrap().is_some()
            });
            std::thread::sleep(Duration::from_millis(60 * (round as u64 % 4)));
            let kill = format!("kill -s KILL -- -{}", child.id());
            let _ = Command::new("sh")
                .args(["-c", &kill])
                .stderr(Stdio::null())
                .status()
                .unwrap();
            kills += u32::from(child.wait().unwrap().code().is_none());
        }
        assert!(kills > 0, "no run was killed before its end");
        let (code, summary) =
            workspace.rogs_json(&["run", "killed.toml", "--threads", threads, "--no-report", "--json"]);
        assert_eq!(code, Some(0), "{summary:#}");
        let outputs = workspace.outputs(&out);
        assert_eq!(outputs.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
        for (path, bytes) in &expected {
            assert!(
                outputs[path] == *bytes,
                "{} differs after ten kills with {threads} threads",
                path.display()
            );
        }
        wait_until("leftovers of killed workers to be gone", || {
            workspace.rogs(&["gc", &out]);
            workspace.leftovers(&out).is_empty()
        });
    }
}

/// Waits for something that happens on any machine, however slow; the limit only turns a hang into a failure.
#[cfg(unix)]
fn wait_until(what: &str, mut happened: impl FnMut() -> bool) {
    let start = std::time::Instant::now();
    while !happened() {
        assert!(start.elapsed() < Duration::from_secs(600), "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}
