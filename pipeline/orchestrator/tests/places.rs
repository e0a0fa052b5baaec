//! Where a run lies and what lies in it: links, damaged outputs, file systems without locks, names that other programs take
//! for something else.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use common::{Workspace, example, programs, walk};
use rogs_needs::needs;
use rogs_orchestrator::{Exit, export, gc, quote, status, verify};

/// Runs the orchestrator as a process of its own.
fn run(workspace: &Workspace, environment: &[(&str, &Path)]) -> Output {
    Command::new(example("toy_pipeline"))
        .arg("run")
        .arg(workspace.path("toy.toml"))
        .args(["1", "1"])
        .envs(environment.iter().copied())
        .output()
        .unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Flips a bit in the middle of a file.
fn flip(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn nothing_behind_a_link_in_a_run_folder_is_changed() {
    let workspace = Workspace::new();
    workspace.run();
    let expected = workspace.outputs();
    workspace.write("victim", "precious");
    workspace.write("elsewhere/clip.r4c", "theirs");
    let (victim, elsewhere, run_folder) = (
        workspace.path("victim"),
        workspace.path("elsewhere"),
        workspace.run_folder(),
    );
    let untouched = |what: &str| {
        assert_eq!(std::fs::read(&victim).unwrap(), b"precious", "{what}");
        assert_eq!(std::fs::read(elsewhere.join("clip.r4c")).unwrap(), b"theirs", "{what}");
        assert_eq!(std::fs::read_dir(&elsewhere).unwrap().count(), 1, "{what}");
    };
    for hard in [false, true] {
        let lock = run_folder.join(".lock");
        std::fs::remove_file(&lock).unwrap();
        if hard {
            std::fs::hard_link(&victim, &lock).unwrap();
        } else {
            symlink(&victim, &lock).unwrap();
        }
        let _ = gc::collect(&run_folder, true);
        untouched("gc --dry-run");
        assert_eq!(gc::collect(&run_folder, false).is_ok(), hard);
        untouched("gc");
        assert_eq!(workspace.prepare().run().is_ok(), hard);
        untouched("run");
    }
    std::fs::remove_file(run_folder.join(".lock")).unwrap();
    // Each of them where the run wants to write.
    for (place, to) in [
        ("clips/a/log.jsonl", &victim),
        ("ledger", &elsewhere),
        ("clips/a", &elsewhere),
        ("clips", &elsewhere),
    ] {
        let (place, kept) = (run_folder.join(place), workspace.path("kept"));
        let output = run_folder.join("clips/a/scores-2.r4c");
        if output.exists() {
            std::fs::remove_file(&output).unwrap();
        }
        std::fs::rename(&place, &kept).unwrap();
        symlink(to, &place).unwrap();
        let _ = gc::collect(&run_folder, false);
        let _ = verify::remove_bad(&run_folder);
        untouched(&format!("gc and verify with {}", place.display()));
        let error = workspace.prepare().run().unwrap_err();
        assert_eq!(error.exit(), Exit::Environment, "{error}");
        assert!(error.to_string().contains("it is a link"), "{error}");
        untouched(&place.display().to_string());
        std::fs::remove_file(&place).unwrap();
        std::fs::rename(&kept, &place).unwrap();
    }
    // An output that is a link is replaced by one that is none.
    let output = run_folder.join("clips/a/scores-2.r4c");
    if output.exists() {
        std::fs::remove_file(&output).unwrap();
    }
    symlink(&victim, &output).unwrap();
    assert_eq!(workspace.run().exit, Exit::Done);
    untouched("an output");
    assert!(workspace.outputs() == expected);
    assert!(!output.is_symlink());
}

#[test]
fn damaged_outputs_are_noticed_by_the_run_that_needs_them_and_made_again() {
    let workspace = Workspace::new();
    workspace.run();
    let expected = workspace.outputs();
    let run_folder = workspace.run_folder();
    let outputs: Vec<PathBuf> = expected
        .keys()
        .filter(|path| path.starts_with("clips/a"))
        .cloned()
        .collect();
    assert_eq!(outputs.len(), 7);
    for output in &outputs {
        flip(&run_folder.join(output));
        // What is made of it must be made again.
        for other in outputs.iter().filter(|other| *other != output) {
            std::fs::remove_file(run_folder.join(other)).unwrap();
        }
        let summary = workspace.run();
        assert_eq!(summary.exit, Exit::Done, "{}: {:?}", output.display(), summary.failures);
        // Scores are read by nobody but the report.
        if output.ends_with("scores-1.r4c") || output.ends_with("scores-2.r4c") {
            assert_eq!(verify::remove_bad(&run_folder).unwrap().bad.len(), 1);
            workspace.run();
        } else {
            let said = summary.warnings.iter().find(|text| text.contains("is made again"));
            let name = output.file_name().unwrap().to_string_lossy().into_owned();
            assert!(said.is_some_and(|text| text.contains(&name)), "{:?}", summary.warnings);
        }
        assert!(workspace.outputs() == expected, "{}", output.display());
    }
    // All of them at once, by reading every byte.
    for output in &outputs {
        flip(&run_folder.join(output));
    }
    assert_eq!(verify::verify(&run_folder).unwrap().bad.len(), outputs.len());
    assert_eq!(verify::remove_bad(&run_folder).unwrap().bad.len(), outputs.len());
    assert_eq!(workspace.run().units.made, outputs.len());
    assert!(workspace.outputs() == expected);
}

#[test]
fn an_array_element_removes_a_damaged_input_and_asks_to_be_run_again() {
    let workspace = Workspace::new();
    workspace.run();
    let expected = workspace.outputs();
    let prepared = workspace.prepare();
    let exported = export::export(&prepared.plan, &programs(), 1, &workspace.path("units.jsonl")).unwrap();
    let run_folder = workspace.run_folder();
    flip(&run_folder.join("clips/a/robot.r4c"));
    std::fs::remove_file(run_folder.join("clips/a/conditioning.r4c")).unwrap();
    let run = |words: &[String]| Command::new(&words[0]).args(&words[1..]).output().unwrap();
    let output = run(&exported.commands[2]);
    assert_eq!(output.status.code(), Some(75), "{}", stderr(&output));
    assert!(stderr(&output).contains("it was removed"), "{}", stderr(&output));
    assert!(!run_folder.join("clips/a/robot.r4c").exists());
    for command in &exported.commands {
        assert_eq!(run(command).status.code(), Some(0));
    }
    assert!(workspace.outputs() == expected);
}

#[test]
fn planning_and_looking_write_nothing() {
    let workspace = Workspace::new();
    workspace.manifest("[slurm]\nshards = 3\n");
    workspace.run();
    let run_folder = workspace.run_folder();
    for name in ["clips/a/clip.r4c", "sources.json", ".lock"] {
        let path = run_folder.join(name);
        if path.exists() {
            std::fs::remove_file(path).unwrap();
        }
    }
    let names = || {
        let mut names = Vec::new();
        walk(&run_folder, &mut |path| {
            names.push((path.to_owned(), path.metadata().unwrap().modified().unwrap()));
        });
        names.sort();
        names
    };
    let before = names();
    let prepared = workspace.prepare();
    rogs_orchestrator::slurm::submit(&prepared, None, true).unwrap();
    rogs_orchestrator::estimate::estimate(&prepared.plan, &prepared.options).unwrap();
    status::status(&run_folder).unwrap();
    verify::verify(&run_folder).unwrap();
    gc::collect(&run_folder, true).unwrap();
    assert_eq!(names(), before);
}

/// Makes every operation fail that some file systems do not have.
const WITHOUT: &str = include_str!("../../../tests/support/without_operations.c");

#[needs(cc)]
#[test]
fn a_file_system_without_locks_and_flushes_of_folders_will_do() {
    let (usual, workspace) = (Workspace::new(), Workspace::new());
    usual.run();
    workspace.write("without.c", WITHOUT);
    let library = workspace.path("without.so");
    let made = Command::new("cc")
        .args(["-shared", "-fPIC", "-o"])
        .args([&library, &workspace.path("without.c")])
        .arg("-ldl")
        .status();
    assert!(made.unwrap().success());
    let environment = [("LD_PRELOAD", library.as_path())];
    let output = run(&workspace, &environment);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("has no locks"), "{}", stderr(&output));
    assert!(workspace.outputs() == usual.outputs());
    assert!(!workspace.run_folder().join(".lock.lease").exists());
    // Two at once: one works.
    std::fs::remove_dir_all(workspace.run_folder()).unwrap();
    let codes: Vec<i32> = std::thread::scope(|scope| {
        let start = || scope.spawn(|| run(&workspace, &environment).status.code().unwrap());
        [start(), start()].map(|thread| thread.join().unwrap()).to_vec()
    });
    assert!(
        codes.contains(&0) && codes.iter().all(|code| [0, 4].contains(code)),
        "{codes:?}"
    );
    assert!(workspace.outputs() == usual.outputs());
}

/// Blanks, quotes, a percent sign, an umlaut, what a shell or Slurm would take for something else.
const NAME: &str = "a b'c\"d 100%u #x $HOME `y` über";

#[test]
fn runs_lie_below_any_name() {
    let (usual, strange) = (Workspace::new(), Workspace::below(NAME));
    usual.run();
    assert_eq!(strange.run().exit, Exit::Done);
    assert!(strange.outputs() == usual.outputs());
    std::fs::remove_dir_all(strange.run_folder()).unwrap();
    // Exported lines are lines of a shell.
    let prepared = strange.prepare();
    let exported = export::export(&prepared.plan, &programs(), 1, &strange.path("units.jsonl")).unwrap();
    for command in &exported.commands {
        let status = Command::new("sh").args(["-c", &quote::shell_line(command)]).status();
        assert_eq!(status.unwrap().code(), Some(0));
    }
    assert!(strange.outputs() == usual.outputs());
    // And so are job scripts.
    std::fs::remove_dir_all(strange.run_folder()).unwrap();
    strange.manifest("[slurm]\nshards = 1\npartition = \"a b\"\n");
    let prepared = strange.prepare();
    let submission = rogs_orchestrator::slurm::submit(&prepared, None, true).unwrap();
    let folder = prepared.plan.run.display().to_string();
    let pattern = folder.replace('%', "%%").replace('"', "\\\"");
    for script in &submission.scripts {
        let line = format!("#SBATCH \"--output={pattern}/slurm/logs/%x_%A_%a.out\"\n");
        assert!(script.text.contains(&line), "{}", script.text);
        assert!(script.text.contains("#SBATCH \"--partition=a b\"\n"), "{}", script.text);
    }
}

#[test]
fn what_no_job_script_can_hold_is_refused_before_anything_is_written() {
    let workspace = Workspace::new();
    for manifest in [
        "[slurm]\npartition = \"a\\ntouch OOPS\"\n",
        "[slurm]\nextra = [\"--qos=a\\ntouch OOPS\"]\n",
    ] {
        workspace.manifest(manifest);
        let error = rogs_orchestrator::slurm::submit(&workspace.prepare(), None, true).unwrap_err();
        assert_eq!(error.exit(), Exit::Usage);
        assert!(error.to_string().contains("line end"), "{error}");
    }
    for key in ["name", "out"] {
        workspace.manifest("");
        let text = std::fs::read_to_string(workspace.path("toy.toml")).unwrap();
        let text = text.replacen(&format!("{key} = \""), &format!("{key} = \"a\\nb"), 1);
        workspace.write("toy.toml", &text);
        let error = workspace.try_prepare().unwrap_err();
        assert!(error.to_string().contains("control character"), "{error}");
    }
    assert!(!workspace.run_folder().exists());
}

#[test]
fn a_job_that_cannot_be_recorded_is_cancelled() {
    let workspace = Workspace::new();
    let bin = workspace.path("bin");
    for (name, text) in [
        (
            "sbatch",
            "#!/bin/sh\necho 'note of the site'\necho 'Submitted batch job 7'\n",
        ),
        ("scancel", "#!/bin/sh\necho \"$@\" >> \"$FAKE_LOG\"\n"),
    ] {
        workspace.write(&format!("bin/{name}"), text);
        let made = Command::new("chmod").arg("+x").arg(bin.join(name)).status();
        assert!(made.unwrap().success());
    }
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let submit = || {
        Command::new(example("toy_pipeline"))
            .arg("submit")
            .arg(workspace.path("toy.toml"))
            .args(["1", "1"])
            .env("PATH", &path)
            .env("FAKE_LOG", workspace.path("cancelled"))
            .output()
            .unwrap()
    };
    // Where the record shall go, nothing can be written: it is a link.
    std::fs::create_dir_all(workspace.path("run/slurm")).unwrap();
    let record = workspace.path("run/slurm/submissions.jsonl");
    symlink(workspace.path("gone"), &record).unwrap();
    let output = submit();
    assert_eq!(output.status.code(), Some(70), "{}", stderr(&output));
    let cancelled = std::fs::read_to_string(workspace.path("cancelled")).unwrap_or_default();
    assert_eq!(cancelled, "7 7 7 7 7 7\n", "{}", stderr(&output));
    std::fs::remove_file(record).unwrap();
    assert_eq!(submit().status.code(), Some(0));
}
