//! The real program and its stages on a real Slurm; the cases of faults run on toy stages, in
//! `pipeline/orchestrator/tests/slurm.rs`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

#[path = "../pipeline/orchestrator/tests/common/cluster.rs"]
mod cluster;

use std::process::Command;

use cluster::Cluster;
use rogs_needs::needs;
use serde_json::{Value, json};
use support::{ROGS, Workspace};

const STAGES: [&str; 6] = ["ingest", "robot-maps", "conditioning", "lift", "refine", "score"];

/// Submits a manifest, waits for the end of all jobs, and returns what `rogs submit` printed.
fn submit_and_wait(workspace: &Workspace, cluster: &Cluster, manifest: &str) -> Value {
    let output = Command::new(ROGS)
        .args(["submit", manifest, "--json"])
        .current_dir(workspace.path("."))
        .env("SLURM_CONF", cluster.configuration())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let submission: Value = serde_json::from_slice(&output.stdout).unwrap();
    let ids = submission["ids"].as_array().unwrap();
    let ids: Vec<String> = ids.iter().map(|id| id.as_str().unwrap().to_owned()).collect();
    assert_eq!(
        ids.len(),
        STAGES.len() + 1,
        "an array a stage, and the report: {submission:#}"
    );
    cluster.wait_for(&ids);
    submission
}

#[needs(slurm, long = "starts a Slurm on this host and runs all stages on it")]
#[test]
fn real_stages_through_slurm_give_a_report_and_the_bytes_of_a_local_run() {
    let turn = Cluster::get();
    let workspace = Workspace::small(2);
    workspace.manifest("cluster.toml", "cluster");
    let memory: String = STAGES.iter().map(|stage| format!("{stage} = \"1500 MiB\"\n")).collect();
    let manifest = std::fs::read_to_string(workspace.path("cluster.toml")).unwrap();
    workspace.write(
        "cluster.toml",
        &format!("{manifest}\n[slurm]\nshards = 2\nextra = [\"--export=ALL\"]\n[slurm.memory]\n{memory}"),
    );
    // One episode is corrupt: the other one is made, and the report tells.
    let mut clips: Vec<String> = std::fs::read_dir(workspace.path("data/episodes"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    clips.sort();
    let states = workspace.path(&format!("data/episodes/{}/joints.csv", clips[1]));
    let whole = std::fs::read_to_string(&states).unwrap();
    let (head, rest) = whole.split_once('\n').unwrap();
    let (time, rest) = rest.split_once(',').unwrap();
    let (_, rest) = rest.split_once(',').unwrap();
    std::fs::write(&states, format!("{head}\n{time},nan,{rest}")).unwrap();
    submit_and_wait(&workspace, &turn.cluster, "cluster.toml");
    let (code, status) = workspace.rogs_json(&["status", "cluster", "--json"]);
    assert_eq!((code, &status["clips"]["done"]), (Some(3), &json!(1)), "{status:#}");
    let report = workspace.path("cluster/report/index.html");
    let page = std::fs::read_to_string(&report).unwrap();
    assert!(page.contains(&clips[0]) && page.contains(&clips[1]));
    assert!(page.contains("joints.csv"), "what failed is told");

    // Mended: only its shard goes again; then everything is as a run on this machine makes it.
    std::fs::write(&states, &whole).unwrap();
    let again = submit_and_wait(&workspace, &turn.cluster, "cluster.toml");
    assert_eq!(again["shards"], json!([1]), "{again:#}");
    assert_eq!(workspace.rogs(&["status", "cluster"]).status.code(), Some(0));
    let page = std::fs::read_to_string(&report).unwrap();
    assert!(!page.contains("joints.csv"), "nothing failed any more");
    assert_eq!(
        workspace.rogs(&["run", "manifest.toml", "--no-report"]).status.code(),
        Some(0)
    );
    let (local, cluster) = (workspace.outputs("run"), workspace.outputs("cluster"));
    assert_eq!(local.len(), 14);
    assert!(local == cluster, "Slurm differs from a local run");
}
