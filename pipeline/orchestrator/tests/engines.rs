//! Handing work to other engines: exported plans, Slurm scripts, and keeping house.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use std::process::Command;

use common::{Workspace, example, programs, walk};
use expect_test::expect_file;
use rogs_orchestrator::{Exit, diff, export, gc, logs, slurm, status};

fn run_commands(commands: &[Vec<String>]) -> Vec<i32> {
    let run = |words: &Vec<String>| {
        Command::new(&words[0])
            .args(&words[1..])
            .output()
            .unwrap()
            .status
            .code()
            .unwrap()
    };
    commands.iter().map(run).collect()
}

#[test]
fn an_exported_plan_gives_the_same_bytes_as_a_local_run() {
    let (local, exported) = (Workspace::new(), Workspace::new());
    local.run();
    let prepared = exported.prepare();
    let export = export::export(&prepared.plan, &programs(), 2, &exported.path("units.jsonl")).unwrap();
    assert_eq!((export.units, export.shards, export.commands.len()), (21, 2, 12));
    assert_eq!(run_commands(&export.commands), [0; 12]);
    assert!(local.outputs() == exported.outputs());
    let status = status::status(&exported.run_folder()).unwrap();
    assert_eq!((status.exit, status.clips.done), (Exit::Done, 3));
    // Again: everything is up to date, nothing is written.
    let before = std::fs::metadata(exported.run_folder().join("clips/a/field-1.r4c"))
        .unwrap()
        .modified()
        .unwrap();
    assert_eq!(run_commands(&export.commands), [0; 12]);
    assert_eq!(
        before,
        std::fs::metadata(exported.run_folder().join("clips/a/field-1.r4c"))
            .unwrap()
            .modified()
            .unwrap()
    );
    let difference = diff::diff(&local.run_folder(), &exported.run_folder()).unwrap();
    assert_eq!((difference.same, difference.exit()), (21, Exit::Done));
}

#[test]
fn shards_tell_how_they_ended() {
    let workspace = Workspace::new();
    workspace.episode("a", "fail@robot-maps");
    let prepared = workspace.prepare();
    let export = export::export(&prepared.plan, &programs(), 1, &workspace.path("units.jsonl")).unwrap();
    assert_eq!(
        run_commands(&export.commands),
        [0, 1, 1, 1, 1, 1],
        "failed, then blocked"
    );
    let status = status::status(&workspace.run_folder()).unwrap();
    assert_eq!(
        (status.clips.done, status.clips.failed, status.failures.len()),
        (2, 1, 1)
    );
    assert!(status.nodes[2].blocked == 1, "{:?}", status.nodes);
    let mut going = export.commands[2].clone();
    going.push("--keep-going".into());
    assert_eq!(run_commands(&[going]), [0]);
    // A wrong shard, a wrong count, a broken plan: usage errors.
    let stage = |arguments: &[&str]| {
        let words = ["stage", "lift", "batch", "--plan"].iter().chain(arguments);
        Command::new(example("toy_pipeline")).args(words).output().unwrap()
    };
    let units = workspace.path("units.jsonl").display().to_string();
    assert_eq!(stage(&[&units, "--shard-index", "7"]).status.code(), Some(2));
    assert_eq!(
        stage(&[&units, "--shard-index", "0", "--shard-count", "9"])
            .status
            .code(),
        Some(2)
    );
    assert_eq!(stage(&[&units, "--shard-index", "auto"]).status.code(), Some(2));
    workspace.write("broken.jsonl", "{}\n");
    let broken = workspace.path("broken.jsonl").display().to_string();
    let output = stage(&[&broken, "--shard-index", "0"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("line 1"), "{output:?}");
}

/// Text with the folder of the test and the program's place taken out.
fn plain(text: &str, workspace: &Workspace) -> String {
    let place = workspace.path("").display().to_string();
    text.replace(&example("toy_pipeline").display().to_string(), "rogs")
        .replace(place.trim_end_matches('/'), "/runs")
}

const SLURM: &str = "[slurm]\nshards = 3\nat-once = 2\npartition = \"batch\"\ntime = \"01:00:00\"\nsetup = [\"module load ffmpeg\"]\n\
                     [slurm.cpus]\nlift = 2\n[slurm.memory]\nlift = \"8 GiB\"\n[slurm.gres]\nlift = \"gpu:1\"\n";

#[test]
fn a_dry_run_prints_the_scripts_and_touches_nothing() {
    let workspace = Workspace::new();
    workspace.manifest(SLURM);
    let prepared = workspace.prepare();
    let finally = [
        "rogs".to_owned(),
        "report".to_owned(),
        prepared.plan.run.display().to_string(),
    ];
    let submission = slurm::submit(&prepared, Some(&finally), true).unwrap();
    assert!(!workspace.run_folder().exists());
    let text = plain(&submission.text(), &workspace);
    expect_file!["golden/slurm.txt"].assert_eq(&text);
}

#[test]
fn submissions_chain_the_arrays_and_the_next_one_is_sparse() {
    let workspace = Workspace::new();
    workspace.episode("b", "fail@lift");
    workspace.manifest(SLURM);
    // A stand-in for Slurm: runs each script's elements at once and prints an id.
    let bin = workspace.path("bin");
    let sbatch = "#!/bin/sh\nprintf '%s\\n' \"$*\" >> \"$FAKE_LOG\"\nfor last; do :; done\n\
        for index in $(sed -n 's/^#SBATCH --array=//p' \"$last\" | sed 's/%.*//; s/0-2/0,1,2/; s/,/ /g'); do\n\
        SLURM_ARRAY_TASK_ID=$index sh \"$last\" >/dev/null 2>&1; done\nwc -l < \"$FAKE_LOG\" | tr -d ' '\n";
    workspace.script("bin/sbatch", sbatch);
    // `module` is a shell function of real clusters.
    workspace.script("bin/module", "#!/bin/sh\n");
    let path = std::env::var("PATH").unwrap();
    // Environment of this test process is shared with others, so the submission runs in a child.
    let submit = || {
        let mut command = Command::new(example("toy_pipeline"));
        command.arg("submit").arg(workspace.path("toy.toml")).args(["1", "1"]);
        command
            .env("PATH", format!("{}:{path}", bin.display()))
            .env("FAKE_LOG", workspace.path("fake.log"));
        let output = command.output().unwrap();
        (
            output.status.code().unwrap(),
            String::from_utf8_lossy(&output.stdout).into_owned(),
            output,
        )
    };
    let (code, text, output) = submit();
    assert_eq!(code, 0, "{output:?}");
    assert!(text.contains("\"shards\":[0,1,2]"), "{text}");
    let calls = std::fs::read_to_string(workspace.path("fake.log")).unwrap();
    let calls: Vec<&str> = calls.lines().collect();
    assert_eq!(calls.len(), 6);
    assert!(
        !calls[0].contains("dependency") && calls[1].contains("--dependency=aftercorr:1 --kill-on-invalid-dep=yes"),
        "{calls:?}"
    );
    let status = status::status(&workspace.run_folder()).unwrap();
    assert_eq!((status.clips.done, status.clips.failed), (2, 1));
    workspace.episode("b", "mended");
    let (code, text, output) = submit();
    assert_eq!(code, 0, "{output:?}");
    assert!(
        text.contains("\"shards\":[1]"),
        "only what is left is submitted: {text}"
    );
    assert_eq!(status::status(&workspace.run_folder()).unwrap().clips.done, 3);
    let (code, _, output) = submit();
    assert_eq!(code, 0, "nothing to submit: {output:?}");
}

#[test]
fn a_controller_that_is_away_for_a_moment_is_asked_again_and_a_refusal_is_told() {
    let workspace = Workspace::new();
    let bin = workspace.path("bin");
    // The first call of each script finds the controller busy.
    let sbatch = "#!/bin/sh\nfor last; do :; done\nprintf '%s\\n' \"$last\" >> \"$FAKE_LOG\"\n\
        if [ -n \"$FAKE_REFUSAL\" ]; then echo \"$FAKE_REFUSAL\" >&2; exit 1; fi\n\
        if [ \"$(grep -c -x -F -- \"$last\" \"$FAKE_LOG\")\" = 1 ]; then\n\
        echo 'sbatch: error: Batch job submission failed: Socket timed out on send/recv operation' >&2; exit 1; fi\n\
        wc -l < \"$FAKE_LOG\" | tr -d ' '\n";
    workspace.script("bin/sbatch", sbatch);
    let path = std::env::var("PATH").unwrap();
    let submit = |log: &str, refusal: &str| {
        let mut command = Command::new(example("toy_pipeline"));
        command.arg("submit").arg(workspace.path("toy.toml")).args(["1", "1"]);
        command
            .env("PATH", format!("{}:{path}", bin.display()))
            .env("FAKE_LOG", workspace.path(log))
            .env("FAKE_REFUSAL", refusal);
        let output = command.output().unwrap();
        let calls = std::fs::read_to_string(workspace.path(log)).unwrap().lines().count();
        (
            output.status.code().unwrap(),
            calls,
            String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr),
        )
    };
    let (code, calls, text) = submit("refused.log", "sbatch: error: invalid partition specified: none");
    assert_eq!((code, calls), (70, 1), "{text}");
    assert!(
        text.contains("`sbatch`: refused") && text.contains("invalid partition specified: none"),
        "{text}"
    );
    assert!(!text.contains("stage program"), "{text}");
    let (code, calls, text) = submit("busy.log", "");
    assert_eq!((code, calls), (0, 12), "{text}");
    assert!(text.contains(r#""ids":["2","4","6","8","10","12"]"#), "{text}");
}

#[test]
fn gc_removes_what_no_plan_names_and_nothing_else() {
    let workspace = Workspace::new();
    workspace.manifest("[[variants]]\nname = \"v\"\nlift.seed = 1\n");
    workspace.run();
    workspace.manifest("");
    std::fs::remove_file(workspace.path("episodes/c.txt")).unwrap();
    // What writers elsewhere left: one of them may still be at work.
    let left = [
        "run/report/tables/.main.csv.4194300.00000000.tmp",
        "run/clips/a/.field-1.r4c.4194300.tmp",
    ];
    for name in left {
        workspace.write(name, "half");
        let file = std::fs::File::options().write(true).open(workspace.path(name)).unwrap();
        file.set_modified(std::time::UNIX_EPOCH).unwrap();
    }
    workspace.write("run/clips/a/.field-1.r4c.4194301.00000000.tmp", "half");
    workspace.write("run/clips/a/notes.txt", "mine");
    workspace.write("run/clips/a/progress.png", "mine too");
    // What a killed job of a stage that is no longer asked for showed.
    workspace.write("run/clips/a/field-fit.progress.json", "{}");
    workspace.write("run/clips/a/field-fit.progress.png", "picture");
    workspace.run();
    let names = || {
        let mut names = Vec::new();
        walk(&workspace.run_folder(), &mut |path| names.push(path.to_owned()));
        names
    };
    let before = names();
    let dry = gc::collect(&workspace.run_folder(), true).unwrap();
    assert_eq!(names(), before, "a dry run writes nothing");
    // Four outputs of the variant in two clips; of the third clip eleven and its log; what was shown of a killed job.
    let leftover = dry
        .files
        .iter()
        .filter(|file| file.extension().is_some_and(|extension| extension == "tmp"))
        .count();
    assert_eq!(dry.files.len() - leftover, 8 + 11 + 1 + 2, "{:?}", dry.files);
    assert!(dry.bytes > 0 && workspace.run_folder().join("clips/c").exists());
    let done = gc::collect(&workspace.run_folder(), false).unwrap();
    assert_eq!(done.files, dry.files);
    assert!(!workspace.run_folder().join("clips/c").exists());
    for name in ["notes.txt", "progress.png"] {
        assert!(workspace.run_folder().join("clips/a").join(name).exists(), "{name}");
    }
    assert_eq!(workspace.run().units.made, 0);
    let elsewhere = workspace.run_folder().join("clips/a/.field-1.r4c.4194301.00000000.tmp");
    assert_eq!(workspace.temporaries(), [elsewhere]);
}

#[test]
fn diff_names_what_differs() {
    let (one, two) = (Workspace::new(), Workspace::new());
    two.manifest("[conditioning]\nsigma_m = 0.2\n");
    one.run();
    two.run();
    let found = diff::diff(&one.run_folder(), &two.run_folder()).unwrap();
    assert_eq!((found.same, found.exit()), (6, Exit::Failed));
    let conditioning = found
        .different
        .iter()
        .find(|output| output.output.ends_with("a/conditioning.r4c"))
        .unwrap();
    assert_eq!(conditioning.what, ["parameters", "content"]);
    let lift = found
        .different
        .iter()
        .find(|output| output.output.ends_with("a/field-1.r4c"))
        .unwrap();
    assert_eq!(lift.what, ["inputs"], "another input, the same content");
    assert!(diff::diff(&one.path("episodes"), &two.run_folder()).is_err());
}

#[test]
fn logs_tell_what_happened_to_a_clip() {
    let workspace = Workspace::new();
    workspace.episode("b", "panic@lift");
    workspace.run();
    let attempts = logs::logs(&workspace.run_folder(), "b").unwrap();
    let last = logs::text(attempts.last().unwrap());
    assert!(
        last.contains("failed") && last.contains("a panic in lift") && last.contains("| "),
        "{last}"
    );
    assert!(logs::logs(&workspace.run_folder(), "bb").unwrap_err().hint().is_some());
}
