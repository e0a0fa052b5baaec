//! The check of calibrations through the whole program: on by default, switched off by a key, and `rogs audit`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use serde_json::Value;
use support::Workspace;

/// The verdict and the mistake of a camera of the only clip.
fn verdict<'a>(audit: &'a Value, camera: &str) -> (&'a str, Option<&'a str>) {
    let cameras = audit["clips"][0]["cameras"].as_array().unwrap();
    let own = cameras.iter().find(|own| own["camera"] == camera).unwrap();
    (own["verdict"].as_str().unwrap(), own["mistake"]["name"].as_str())
}

#[test]
fn a_run_checks_calibrations_unless_it_is_told_not_to() {
    let workspace = Workspace::with_episodes(1);
    let text = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let stages = |manifest: &str| -> Vec<String> {
        workspace.write("plan.toml", manifest);
        let (code, plan) = workspace.rogs_json(&["plan", "plan.toml", "--json"]);
        assert_eq!(code, Some(0), "{plan:#}");
        let nodes = plan["nodes"].as_array().unwrap();
        nodes
            .iter()
            .map(|node| node["node"].as_str().unwrap().to_owned())
            .collect()
    };
    let has = |stages: &[String]| stages.iter().any(|stage| stage == "agreement");
    assert!(!has(&stages(&text)), "`agreement = false`");
    let plain = text.replace("agreement = false\n", "");
    assert!(has(&stages(&plain)), "by default");
    let lift = |key: &str| plain.replacen("[run]\n", &format!("[run]\nstages = [\"lift\"]\n{key}"), 1);
    assert!(!has(&stages(&lift(""))), "other stages are named");
    assert!(
        has(&stages(&lift("agreement = true\n"))),
        "asked for beside other stages"
    );
}

#[test]
fn rogs_audit_names_a_planted_mistake_and_resumes() {
    let workspace = Workspace::with_episodes(1);
    let (code, right) = workspace.rogs_json(&["audit", "manifest.toml", "--out", "right", "--json"]);
    assert_eq!(
        (code, right["format"].as_str()),
        (Some(0), Some("rogs.audit/1")),
        "{right:#}"
    );
    for camera in ["ext1", "ext2"] {
        assert_eq!(verdict(&right, camera), ("good", None), "{right:#}");
    }
    // The external cameras change places.
    let episodes = workspace.path("data/episodes");
    let episode = std::fs::read_dir(&episodes)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.is_dir());
    let file = episode.unwrap().join("episode.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let mut description: Value = serde_json::from_str(&text).unwrap();
    let cameras = description["cameras"].as_array_mut().unwrap();
    let place = |cameras: &[Value], id: &str| cameras.iter().position(|own| own["id"] == id).unwrap();
    let (a, b) = (place(cameras, "ext1"), place(cameras, "ext2"));
    let (first, second) = (cameras[a]["mount"].clone(), cameras[b]["mount"].clone());
    assert!(first.is_object() && first != second);
    (cameras[a]["mount"], cameras[b]["mount"]) = (second, first);
    std::fs::write(&file, description.to_string()).unwrap();
    let arguments = [
        "audit",
        "manifest.toml",
        "--out",
        "wrong",
        "--html",
        "wrong.html",
        "--json",
    ];
    let (code, wrong) = workspace.rogs_json(&arguments);
    assert_eq!(code, Some(0), "{wrong:#}");
    assert_eq!(verdict(&wrong, "ext1"), ("wrong", Some("swapped-cameras")), "{wrong:#}");
    let page = std::fs::read_to_string(workspace.path("wrong.html")).unwrap();
    assert!(page.contains("swap them") && page.contains("data:image/jpeg;base64,") && !page.contains("<script"));
    let before = workspace.outputs("wrong/synth/run");
    let (_, again) = workspace.rogs_json(&arguments);
    assert_eq!(again, wrong);
    assert_eq!(workspace.outputs("wrong/synth/run"), before);

    let lines = String::from_utf8(workspace.rogs(&["audit", "manifest.toml", "--out", "wrong"]).stdout).unwrap();
    assert!(
        lines.contains("3 cameras of 1 clips: ") && lines.contains(" wrong, "),
        "{lines}"
    );
    let missing = workspace.rogs(&["audit", "manifst.toml"]);
    let said = String::from_utf8(missing.stderr).unwrap();
    assert!(
        !missing.status.success() && said.contains("did you mean `manifest.toml`?"),
        "{said}"
    );
}

/// The cell of a column in the row of all cameras of a group.
fn following(table: &Value, group: &str, column: &str) -> Option<f64> {
    let columns = table["columns"].as_array().unwrap();
    let place = columns.iter().position(|own| own["name"] == column).unwrap();
    let rows = table["rows"].as_array().unwrap();
    let row = rows
        .iter()
        .find(|row| row["group"] == group && row["label"] == "all cameras");
    row.unwrap_or_else(|| panic!("no `{group}`: {table:#}"))["cells"][place]["mean"]["value"].as_f64()
}

#[test]
fn a_rollout_whose_robot_lags_is_told_beside_the_recorded_floor() {
    let workspace = Workspace::empty();
    let mut arguments = vec![
        "synth",
        "--episodes",
        "1",
        "--seed",
        "3",
        "--size",
        "280x154",
        "--frames",
        "24",
    ];
    arguments.extend(["--out", "data", "--rollouts", "--lag", "2"]);
    let made = workspace.rogs(&arguments);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let manifest = "data/manifest.toml";
    let text = std::fs::read_to_string(workspace.path(manifest)).unwrap();
    let text = text.replacen("[run]\n", "[run]\nstages = [\"agreement\"]\n", 1);
    workspace.write(manifest, &text);
    let (code, summary) = workspace.rogs_json(&["run", manifest, "--no-report", "--json"]);
    assert_eq!(code, Some(0), "{summary:#}");
    let (_, table) = workspace.rogs_json(&["table", "data/run", "--table", "following", "--json"]);
    let [recorded, rollout] = ["Recorded observations", "World-model rollouts"];
    let lag = |group| following(&table, group, "lag (frames)").unwrap_or_else(|| panic!("no lag: {table:#}"));
    assert!(lag(recorded).abs() < 0.5, "{table:#}");
    assert!((lag(rollout) - 2.0).abs() < 0.5, "{table:#}");
    let error = |group| following(&table, group, "error (px)").unwrap();
    assert!(error(recorded) < error(rollout), "{table:#}");
}
