//! Baselines of a manifest: outputs and rows of their own, weights that must be asked for, failures that are counted.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use serde_json::Value;
use support::Workspace;

const BASELINES: &str = r#"
[[baselines]]
method = "movies"

[[baselines]]
method = "4dgt"
lift = { configuration = "compact", height = 28, width = 42 }

[[baselines]]
method = "4dgt"
name = "4dgt+5-frames"
lift = { configuration = "compact", height = 28, width = 42, frames = "source" }
"#;

/// The manifest of a workspace with baselines and these weights for them.
fn with_baselines(workspace: &Workspace, weights: &str) {
    workspace.manifest("baselines.toml", "run");
    let manifest = std::fs::read_to_string(workspace.path("baselines.toml")).unwrap();
    assert!(manifest.contains("[weights]\n"), "{manifest}");
    let manifest = manifest.replace("[weights]\n", &format!("[weights]\n{weights}"));
    workspace.write("baselines.toml", &(manifest + BASELINES));
}

fn row<'a>(table: &'a Value, method: &str) -> &'a Value {
    let rows = table["rows"].as_array().unwrap();
    let found = rows.iter().find(|row| row["method"] == method);
    found.unwrap_or_else(|| panic!("no row `{method}`: {table:#}"))
}

fn notes(table: &Value) -> String {
    let notes = table["footnotes"].as_array().unwrap().iter();
    notes.map(|note| note.as_str().unwrap().to_owned() + "\n").collect()
}

/// The report of the run plays the stages and these baselines, in this order.
fn assert_played(workspace: &Workspace, baselines: &[&str]) {
    let (code, made) = workspace.rogs_json(&["report", "run", "--json"]);
    assert_eq!(code, Some(0), "{made:#}");
    let page = std::fs::read_to_string(workspace.path("run/report/index.html")).unwrap();
    for (number, name) in (1..).zip(["Stage 1", "Stage 1+2"].iter().chain(baselines)) {
        let script = format!("scenes/0001-{number}.js");
        let source = format!("&quot;name&quot;:&quot;{name}&quot;,&quot;script&quot;:&quot;{script}&quot;");
        assert!(page.contains(&source), "{name}");
        let text = std::fs::read_to_string(workspace.path("run/report").join(&script)).unwrap();
        assert!(text.contains("rogsScene("), "{name}");
    }
}

#[test]
fn baselines_are_units_of_the_run_with_rows_of_their_own() {
    let workspace = Workspace::small(1);
    with_baselines(
        &workspace,
        "movies = \"seeded\"\n4dgt = \"seeded\"\ndinov2 = \"seeded\"\n",
    );
    let (code, made) = workspace.rogs_json(&["run", "baselines.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(0), "{made:#}");
    let (_, main) = workspace.rogs_json(&["table", "run", "--table", "main", "--json"]);
    for (method, label) in [
        ("movies", "MoVieS (seeded weights)"),
        ("4dgt", "4DGT (seeded weights)"),
        ("stage1", "Ours (Stage 1)"),
    ] {
        let row = row(&main, method);
        assert_eq!(
            (&row["label"], &row["clips"]),
            (&Value::from(label), &Value::from(1)),
            "{main:#}"
        );
        assert!(row["cells"][0].get("mean").is_some(), "{row:#}");
    }
    assert!(notes(&main).contains("UNTRAINED WEIGHTS: 4dgt"), "{main:#}");
    let (_, frames) = workspace.rogs_json(&["table", "run", "--table", "frames_4dgt", "--json"]);
    assert_eq!(row(&frames, "4dgt/5-frames")["clips"], 1);
    let (_, inputs) = workspace.rogs_json(&["table", "run", "--table", "inputs", "--json"]);
    let text = row(&inputs, "4dgt")["cells"].to_string();
    assert!(text.contains("17 / camera"), "{text}");
    assert_played(&workspace, &["4DGT"]);
    // Nothing of a baseline is made twice, and nothing of it lies among the outputs of the run.
    let (code, again) = workspace.rogs_json(&["run", "baselines.toml", "--no-report", "--json"]);
    assert_eq!((code, &again["units"]["made"]), (Some(0), &Value::from(0)), "{again:#}");
}

#[test]
fn a_baseline_runs_with_its_own_weights_or_not_at_all() {
    let workspace = Workspace::small(1);
    with_baselines(&workspace, "movies = \"seeded\"\n");
    let plan = |text: &str, expected: &[&str]| {
        workspace.write("other.toml", text);
        let output = workspace.rogs(&["plan", "other.toml"]);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        for expected in expected {
            assert!(stderr.contains(expected), "{expected}: {stderr}");
        }
    };
    let manifest = std::fs::read_to_string(workspace.path("baselines.toml")).unwrap();
    plan(
        &manifest,
        &["4DGT needs weights: [weights] has no `4dgt`", "docs/baselines.md"],
    );
    plan(
        &manifest.replace("[weights]\n", "[weights]\n4dgt = \"builtin\"\n"),
        &["4DGT needs weights: there are none of the name `builtin`"],
    );
    let only = |text: &str| manifest.replace(BASELINES, text);
    plan(
        &only("\n[[baselines]]\nmethod = \"nerf\"\n"),
        &["unknown baseline `nerf`", "movies, 4dgt, som"],
    );
    plan(
        &only("\n[[baselines]]\nmethod = \"movies\"\nlift = { anchoring = true }\n"),
        &["`anchoring` is part of what makes MoVieS a baseline"],
    );
    plan(
        &only("\n[[baselines]]\nmethod = \"movies\"\n\n[[baselines]]\nmethod = \"movies\"\n"),
        &["another baseline, variant or prediction is named `movies`"],
    );
    plan(
        &only("\n[[baselines]]\nmethod = \"movies\"\nlift = { frames = \"all\" }\n"),
        &["unknown parameter `frames`"],
    );
}

/// Few updates of small clusters, for images of 56x42.
const SOM: &str = r#"
[sidecars]
root = "data/sidecars"

[[baselines]]
method = "som"
lift = { erode_px = 1, dilate_px = 2, smallest_cluster = 3, clusters = 3, track_updates = 5, epochs = 2 }
"#;

#[test]
fn shape_of_motion_needs_sidecars_and_what_fails_is_counted() {
    let workspace = Workspace::small(2);
    let synth = [
        "synth",
        "--out",
        "data",
        "--episodes",
        "2",
        "--seed",
        "11",
        "--frames",
        "17",
        "--size",
        "56x42",
    ];
    let output = workspace.rogs(&[&synth[..], &["--sidecars", "--sidecar-noise"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    workspace.manifest("plain.toml", "run");
    let plain = std::fs::read_to_string(workspace.path("plain.toml")).unwrap();
    // The manifest that synth wrote names the folder as it lies beside it.
    let plain = plain.replace("\n[sidecars]\nroot = \"sidecars\"\n", "");
    assert!(!plain.contains("[sidecars]"), "{plain}");
    let without = SOM.replace("[sidecars]\nroot = \"data/sidecars\"\n", "");
    workspace.write("som.toml", &(plain.clone() + &without));
    let refused = workspace.rogs(&["plan", "som.toml"]);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(2), "{message}");
    assert!(
        message.contains("names no folder of them") && message.contains("[sidecars]"),
        "{message}"
    );
    // One of the two clips has none: it fails by name, the other has scores, and the row says so.
    let mut clips: Vec<_> = (std::fs::read_dir(workspace.path("data/sidecars")).unwrap())
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    clips.sort();
    let away = workspace.path("data/away");
    std::fs::rename(workspace.path("data/sidecars").join(&clips[1]), &away).unwrap();
    workspace.write("som.toml", &(plain + SOM));
    let (code, made) = workspace.rogs_json(&["run", "som.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(3), "{made:#}");
    let failure = made["failures"].to_string();
    let expected = format!("there are no sidecars of clip `{}`", clips[1]);
    assert!(failure.contains(&expected), "{failure}");
    let (_, main) = workspace.rogs_json(&["table", "run", "--table", "main", "--json"]);
    assert_eq!(row(&main, "som")["clips"], 1, "{main:#}");
    assert_eq!(row(&main, "stage1")["clips"], 2, "{main:#}");
    assert!(notes(&main).contains("SoM: 1 of 2 clips"), "{main:#}");
    // Once they are there, that clip alone is made.
    std::fs::rename(away, workspace.path("data/sidecars").join(&clips[1])).unwrap();
    let (code, made) = workspace.rogs_json(&["run", "som.toml", "--no-report", "--json"]);
    assert_eq!((code, &made["units"]["made"]), (Some(0), &Value::from(2)), "{made:#}");
    assert_played(&workspace, &["Shape of Motion"]);
    let (_, inputs) = workspace.rogs_json(&["table", "run", "--table", "inputs", "--json"]);
    let text = row(&inputs, "som")["cells"].to_string();
    assert!(text.contains("FK masks only"), "{text}");
}
