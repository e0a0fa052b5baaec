//! The Slurm back-end on a real Slurm on this host.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

#[path = "common/cluster.rs"]
mod cluster;
mod common;

use std::process::Command;

use cluster::{Cluster, Turn, wait_until};
use common::{Workspace, example, programs, walk};
use rogs_needs::needs;
use rogs_orchestrator::{Exit, export, gc, status};

/// One clip a shard, so that shard `i` is clip `a`, `b`, `c`; every stage small, `lift` with a pretended GPU.
const SLURM: &str = "[slurm]\nshards = 3\nextra = [\"--export=ALL\"]\n[slurm.gres]\nlift = \"gpu:1\"\n[slurm.memory]\n\
                     ingest = \"150 MiB\"\nrobot-maps = \"150 MiB\"\nconditioning = \"150 MiB\"\nlift = \"150 MiB\"\n\
                     refine = \"150 MiB\"\nscore = \"150 MiB\"\n";

/// Stages in the order in which they are submitted.
const STAGES: [&str; 6] = ["ingest", "robot-maps", "conditioning", "lift", "refine", "score"];

/// A workspace on a cluster.
struct Site {
    workspace: Workspace,
    control: tempfile::TempDir,
    turn: Turn,
}

/// What a submission printed.
struct Submitted {
    ids: Vec<String>,
    shards: Vec<u64>,
}

impl Submitted {
    /// The array of a stage.
    fn id(&self, stage: &str) -> &str {
        &self.ids[STAGES.iter().position(|name| *name == stage).unwrap()]
    }
}

impl Site {
    fn new() -> Self {
        let turn = Cluster::get();
        let workspace = Workspace::new();
        workspace.manifest(SLURM);
        Self {
            workspace,
            control: tempfile::tempdir().unwrap(),
            turn,
        }
    }

    /// Submits what is left, in a process with this cluster's environment; `hold` as in `examples/toy_pipeline.rs`.
    fn submit(&self, hold: &str) -> Submitted {
        let output = Command::new(example("toy_pipeline"))
            .arg("submit")
            .arg(self.workspace.path("toy.toml"))
            .args(["1", "1"])
            .env("SLURM_CONF", self.turn.cluster.configuration())
            .env("ROGS_TOY_FINALLY", "1")
            .env("ROGS_TOY_HOLD", hold)
            .env("ROGS_TOY_FOLDER", self.control.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let value: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let list = |name: &str| value[name].as_array().unwrap().clone();
        Submitted {
            ids: list("ids").iter().map(|id| id.as_str().unwrap().to_owned()).collect(),
            shards: list("shards").iter().map(|shard| shard.as_u64().unwrap()).collect(),
        }
    }

    /// Submits and waits for the end of all jobs.
    fn submit_and_wait(&self) -> Submitted {
        let submitted = self.submit("");
        self.turn.cluster.wait_for(&submitted.ids);
        submitted
    }

    /// Process number of the worker that stands at the place that `submit` named.
    fn held(&self) -> String {
        let held = self.control.path().join("held");
        wait_until("a worker to get to its place", || held.exists());
        std::fs::read_to_string(held).unwrap()
    }

    fn status(&self) -> status::Status {
        status::status(&self.workspace.run_folder()).unwrap()
    }

    /// What an element of a stage's array wrote.
    fn log(&self, stage: &str, id: &str, shard: u64) -> String {
        let name = format!("slurm/logs/rogs-toy-{stage}_{id}_{shard}.out");
        std::fs::read_to_string(self.workspace.run_folder().join(name)).unwrap_or_default()
    }

    /// Output files with the times of their last change.
    fn times(&self) -> Vec<(std::path::PathBuf, std::time::SystemTime)> {
        let mut times = Vec::new();
        walk(&self.workspace.run_folder(), &mut |path| {
            if path.extension().is_some_and(|extension| extension == "r4c") {
                times.push((path.to_owned(), path.metadata().unwrap().modified().unwrap()));
            }
        });
        times
    }
}

#[needs(slurm, long = "starts a Slurm on this host")]
#[test]
fn slurm_local_and_exported_plans_give_the_same_bytes() {
    let site = Site::new();
    let submitted = site.submit_and_wait();
    assert_eq!((submitted.ids.len(), &submitted.shards[..]), (7, &[0, 1, 2][..]));
    let status = site.status();
    assert_eq!((status.exit, status.clips.done), (Exit::Done, 3), "{}", status.table());
    // Every element has a log, every clip its own.
    for stage in STAGES {
        for shard in 0..3 {
            let log = site.log(stage, submitted.id(stage), shard);
            assert!(
                log.contains(&format!("{stage} shard {shard}: ")),
                "{stage} {shard}: `{log}`"
            );
        }
    }
    for clip in ["a", "b", "c"] {
        let attempts = rogs_orchestrator::logs::logs(&site.workspace.run_folder(), clip).unwrap();
        assert_eq!(attempts.len(), 7, "{clip}");
    }
    // The job behind all arrays ran last.
    let last = site.workspace.run_folder().join("final.txt");
    assert!(std::fs::read_to_string(last).unwrap().contains("3 of 3 clips done"));

    let (local, exported) = (Workspace::new(), Workspace::new());
    local.run();
    let plan = exported.prepare().plan;
    let export = export::export(&plan, &programs(), 2, &exported.path("units.jsonl")).unwrap();
    for command in &export.commands {
        assert!(
            Command::new(&command[0])
                .args(&command[1..])
                .output()
                .unwrap()
                .status
                .success()
        );
    }
    let expected = local.outputs();
    assert!(site.workspace.outputs() == expected, "Slurm differs from local");
    assert!(exported.outputs() == expected, "an exported plan differs from local");
}

#[needs(slurm, long = "starts a Slurm on this host")]
#[test]
fn one_corrupt_episode_leaves_the_others_alone_and_the_next_submission_is_sparse() {
    let site = Site::new();
    site.workspace.episode("b", "fail@lift");
    let submitted = site.submit_and_wait();
    let status = site.status();
    assert_eq!((status.clips.done, status.clips.failed), (2, 1), "{}", status.table());
    assert_eq!(status.failures[0].failure.hint.as_deref(), Some("edit the episode"));
    // What follows the failure is blocked, not lost; the last stage of the shard tells by its exit status.
    assert_eq!(status.nodes[4].blocked, 1, "{}", status.table());
    assert!(
        site.turn
            .cluster
            .job(&format!("{}_1", submitted.id("score")))
            .contains("ExitCode=1:0")
    );
    assert!(
        site.turn
            .cluster
            .job(&format!("{}_0", submitted.id("score")))
            .contains("ExitCode=0:0")
    );
    let last = site.workspace.run_folder().join("final.txt");
    assert!(
        std::fs::read_to_string(last)
            .unwrap()
            .contains("2 of 3 clips done, 1 failed")
    );
    // Mended: one shard, and nothing of the others is touched.
    let before = site.times();
    site.workspace.episode("b", "mended");
    let again = site.submit_and_wait();
    assert_eq!(again.shards, [1]);
    assert_eq!(site.status().clips.done, 3);
    let after = site.times();
    let others = before
        .iter()
        .filter(|(path, _)| !path.to_string_lossy().contains("clips/b/"));
    assert!(others.clone().count() == 14 && others.into_iter().all(|file| after.contains(file)));
}

#[needs(slurm, long = "starts a Slurm on this host")]
#[test]
fn a_killed_task_loses_one_unit_and_nothing_done_is_made_again() {
    let site = Site::new();
    let submitted = site.submit("b@lift@begin");
    let worker = site.held();
    assert!(
        Command::new("sh")
            .args(["-c", &format!("kill -s KILL {worker}")])
            .status()
            .unwrap()
            .success()
    );
    site.turn.cluster.wait_for(&submitted.ids);
    let lost = site.turn.cluster.job(&format!("{}_1", submitted.id("lift")));
    assert!(lost.contains("ExitCode=0:9"), "{lost}");
    // The dependents of the lost element are cancelled instead of waiting forever.
    let dependent = site.turn.cluster.job(&format!("{}_1", submitted.id("refine")));
    assert!(dependent.contains("JobState=CANCELLED"), "{dependent}");
    let status = site.status();
    assert_eq!((status.clips.done, status.clips.failed), (2, 0), "{}", status.table());
    let before = site.times();
    assert_eq!(before.len(), 17);
    let again = site.submit_and_wait();
    assert_eq!(again.shards, [1]);
    assert_eq!(site.status().exit, Exit::Done);
    let after = site.times();
    assert!(
        before.iter().all(|file| after.contains(file)),
        "something was made twice"
    );
    let expected = Workspace::new();
    expected.run();
    assert!(site.workspace.outputs() == expected.outputs());
}

#[needs(slurm, long = "starts a Slurm on this host")]
#[test]
fn a_drained_task_ends_with_75_leaves_nothing_behind_and_goes_on() {
    let site = Site::new();
    let submitted = site.submit("b@conditioning@begin");
    site.held();
    let element = format!("{}_1", submitted.id("conditioning"));
    let cluster = &site.turn.cluster;
    cluster.ask("scancel", &["--signal=TERM", "--batch", &element]);
    // The clip in hand stands still beyond its grace period, so it is given up.
    cluster.wait_for(&submitted.ids);
    let drained = cluster.job(&element);
    assert!(drained.contains("ExitCode=75:0"), "{drained}");
    site.workspace.assert_no_temporaries();
    let status = site.status();
    assert_eq!((status.clips.done, status.clips.failed), (2, 0), "{}", status.table());
    let before = site.times();
    assert_eq!(site.submit_and_wait().shards, [1]);
    assert_eq!(site.status().exit, Exit::Done);
    let after = site.times();
    assert!(
        before.iter().all(|file| after.contains(file)),
        "something was made twice"
    );
}

#[needs(slurm, long = "starts a Slurm on this host")]
#[test]
fn a_requeued_task_goes_on_by_itself_and_keeps_its_first_log() {
    let site = Site::new();
    let submitted = site.submit("b@lift@begin");
    let worker = site.held();
    let element = format!("{}_1", submitted.id("lift"));
    let cluster = &site.turn.cluster;
    cluster.ask("scontrol", &["requeue", &element]);
    wait_until("the first try to end", || !cluster::lives(&worker));
    let again = format!("jobid={element}");
    // Slurm holds a requeued task back for two minutes, unless an option forbids it.
    cluster.ask("scontrol", &["update", &again, "StartTime=now"]);
    cluster.wait_for(&submitted.ids);
    let requeued = cluster.job(&element);
    assert!(
        requeued.contains("Restarts=1") && requeued.contains("ExitCode=0:0"),
        "{requeued}"
    );
    // Those behind it waited for the second try.
    let status = site.status();
    assert_eq!((status.exit, status.clips.done), (Exit::Done, 3), "{}", status.table());
    site.workspace.assert_no_temporaries();
    let log = site.log("lift", submitted.id("lift"), 1);
    assert!(log.contains("1 made"), "`{log}`");
}

#[needs(slurm, long = "starts a Slurm on this host")]
#[test]
fn a_controller_and_nodes_that_die_and_come_back_cost_nothing() {
    let site = Site::new();
    let submitted = site.submit("b@lift@begin");
    site.held();
    site.turn.cluster.crash();
    std::fs::write(site.control.path().join("release"), "").unwrap();
    site.turn.cluster.wait_for(&submitted.ids);
    if site.status().exit != Exit::Done {
        // What the controller had not saved yet is submitted again.
        assert_eq!(site.status().clips.failed, 0, "{}", site.status().table());
        site.submit_and_wait();
    }
    assert_eq!(site.status().exit, Exit::Done, "{}", site.status().table());
    // Workers that the new controller does not know are killed wherever they are; what such a writer leaves behind goes
    // with `rogs gc`.
    wait_until("the last writers to end", || {
        gc::collect(&site.workspace.run_folder(), false).unwrap();
        site.workspace.temporaries().is_empty()
    });
    let expected = Workspace::new();
    expected.run();
    assert!(site.workspace.outputs() == expected.outputs());
}

#[needs(slurm, long = "starts a Slurm on this host")]
#[test]
fn a_shard_that_runs_out_of_memory_gets_more_the_next_time() {
    let site = Site::new();
    site.workspace.episode("c", "memory@lift");
    let script = site.workspace.run_folder().join("slurm/lift.sbatch");
    let asked = || {
        let text = std::fs::read_to_string(&script).unwrap();
        text.lines()
            .find_map(|line| line.strip_prefix("#SBATCH --mem=").map(str::to_owned))
            .unwrap()
    };
    let mut tries = Vec::new();
    let first = site.submit_and_wait();
    tries.push((asked(), site.status().clips.done));
    let log = site.log("lift", first.id("lift"), 2);
    assert!(log.contains("memory limit"), "`{log}`");
    for _ in 0..2 {
        assert_eq!(site.submit_and_wait().shards, [2]);
        tries.push((asked(), site.status().clips.done));
    }
    let tries: Vec<(&str, usize)> = tries.iter().map(|(memory, done)| (memory.as_str(), *done)).collect();
    assert_eq!(tries, [("150M", 2), ("300M", 2), ("600M", 3)]);
}

#[needs(slurm, long = "starts a Slurm on this host")]
#[test]
fn a_unit_whose_predecessor_vanished_names_the_input_it_lacks() {
    let site = Site::new();
    site.submit_and_wait();
    let run = site.workspace.run_folder();
    for file in ["conditioning.r4c", "field-1.r4c"] {
        std::fs::remove_file(run.join("clips/b").join(file)).unwrap();
    }
    // Slurm takes a dependency on a job that it does not know, and starts at once.
    let script = run.join("slurm/lift.sbatch").display().to_string();
    let id = site
        .turn
        .cluster
        .ask("sbatch", &["--parsable", "--dependency=afterok:4000000", &script]);
    site.turn.cluster.wait_for(std::slice::from_ref(&id));
    let log = site.log("lift", &id, 1);
    assert!(log.contains("b lift: blocked: its input `conditioning` ("), "`{log}`");
    assert!(log.contains("0 made, 0 up to date, 0 failed, 1 blocked"), "`{log}`");
    assert!(!run.join("clips/b/field-1.r4c").exists());
}
