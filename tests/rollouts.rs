//! Rollouts through the whole program: both settings from one manifest, their order, and what a world model is given.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use rogs_needs::needs;
use rogs_r4c::read_record;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, FrameIndex};
use serde_json::Value;
use support::Workspace;

/// Writes rollouts of the workspace's episodes with these distortions to `data/NAME`.
fn make_rollouts(workspace: &Workspace, size: &str, frames: &str, name: &str, distortions: &[&str]) {
    let mut arguments = vec![
        "synth",
        "--episodes",
        "1",
        "--seed",
        "11",
        "--size",
        size,
        "--frames",
        frames,
    ];
    arguments.extend(["--out", "data", "--rollouts"]);
    arguments.extend(distortions);
    let made = workspace.rogs(&arguments);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    if name != "rollouts" {
        std::fs::rename(workspace.path("data/rollouts"), workspace.path(&format!("data/{name}"))).unwrap();
    }
}

/// A manifest of the workspace with `more` in `[run]` and the rollouts of a folder, if any.
fn manifest(workspace: &Workspace, name: &str, out: &str, more: &str, rollouts: Option<&str>) {
    workspace.manifest(name, out);
    let text = std::fs::read_to_string(workspace.path(name)).unwrap();
    let text = text
        .split("\n[rollouts]")
        .next()
        .unwrap()
        .replacen("[run]\n", &format!("[run]\n{more}\n"), 1);
    let rollouts = rollouts.map_or(String::new(), |folder| {
        format!("\n[rollouts]\nroot = \"data/{folder}\"\nmodel = \"m\"\n")
    });
    workspace.write(name, &(text + &rollouts));
}

/// The mean in a column of a method's row in a group of the table `main`.
fn mean(table: &Value, group: &str, method: &str, column: &str) -> Option<f64> {
    let columns = table["columns"].as_array().unwrap();
    let place = columns.iter().position(|own| own["name"] == column).unwrap();
    let rows = table["rows"].as_array().unwrap();
    let row = rows.iter().find(|row| row["group"] == group && row["method"] == method);
    let row = row.unwrap_or_else(|| panic!("no `{method}` in `{group}`: {table:#}"));
    row["cells"][place]["mean"]["value"].as_f64()
}

const RECORDED: &str = "Recorded observations";
const ROLLOUTS: &str = "World-model rollouts";

#[test]
fn one_manifest_gives_both_blocks_on_the_same_clips_and_references() {
    let workspace = Workspace::small(1);
    make_rollouts(&workspace, "56x42", "17", "rollouts", &[]);
    manifest(&workspace, "both.toml", "both", "", Some("rollouts"));
    let (code, summary) = workspace.rogs_json(&["run", "both.toml", "--json"]);
    assert_eq!(code, Some(0), "{summary:#}");
    // Robot maps and conditioning do not depend on what is seen: the rollout takes those of the recording.
    assert_eq!(summary["units"]["made"], 7 + 5, "{summary:#}");

    let (_, table) = workspace.rogs_json(&["table", "both", "--json"]);
    for method in ["stage1", "stage1+2"] {
        for column in ["source PSNR", "novel PSNR", "source AbsRel", "robot EPE (mm)"] {
            // A rollout without distortions is the recording: every score is the same.
            let [recorded, rollout] = [RECORDED, ROLLOUTS].map(|group| mean(&table, group, method, column));
            assert_eq!(recorded, rollout, "{method} {column}");
            assert!(recorded.is_some() || !column.ends_with("PSNR"), "{method} {column}");
        }
    }
    let clips: Vec<Clip> = workspace
        .outputs("both")
        .keys()
        .filter(|path| path.ends_with("clip.r4c"))
        .map(|path| read_record::<Clip>(&workspace.path("both").join(path)).unwrap().0)
        .collect();
    let [recorded, rollout] =
        [false, true].map(|rollout| clips.iter().find(|own| own.rollout.is_some() == rollout).unwrap());
    assert_eq!(
        (&recorded.query_frames, &recorded.tracks),
        (&rollout.query_frames, &rollout.tracks)
    );
    for (a, b) in recorded.cameras.iter().zip(&rollout.cameras) {
        assert!(
            a.recorded == b.recorded && a.mount == b.mount && a.intrinsics == b.intrinsics,
            "{}",
            a.id
        );
    }

    let report = std::fs::read_to_string(summary["report"].as_str().unwrap()).unwrap();
    for part in [
        RECORDED,
        ROLLOUTS,
        "Recorded, predicted, generated",
        "Methods: novel PSNR, dB",
        "frames of m (views on disk)",
    ] {
        assert!(report.contains(part), "the report lacks `{part}`");
    }
    let (_, across) = workspace.rogs_json(&["table", "both", "--table", "cross_view", "--json"]);
    for group in [RECORDED, ROLLOUTS] {
        let psnr = mean(&across, group, "stage1", "PSNR from the other cameras");
        assert!(psnr.is_some_and(|psnr| psnr > 5.0), "{group}: {across}");
    }
    let inputs = String::from_utf8(workspace.rogs(&["table", "both", "--table", "inputs"]).stdout).unwrap();
    for part in [
        "generated (m)",
        "recorded",
        "5 times x 3 views",
        "anchoring, FK",
        "geometry prior",
    ] {
        assert!(inputs.contains(part), "{inputs}");
    }

    // The two settings in runs of their own give the same table together, and one run twice is no table.
    for setting in ["recorded", "rollout"] {
        let name = format!("{setting}.toml");
        manifest(
            &workspace,
            &name,
            setting,
            &format!("setting = \"{setting}\""),
            Some("rollouts"),
        );
        let (code, summary) = workspace.rogs_json(&["run", &name, "--json"]);
        assert_eq!(
            (code, summary["units"]["made"].as_u64()),
            (Some(0), Some(7)),
            "{summary:#}"
        );
    }
    let (_, together) = workspace.rogs_json(&["table", "recorded", "rollout", "--table", "ci", "--json"]);
    let (_, one) = workspace.rogs_json(&["table", "both", "--table", "ci", "--json"]);
    assert_eq!(together, one);
    let twice = workspace.rogs(&["table", "recorded", "both"]);
    let error = String::from_utf8(twice.stderr).unwrap();
    assert!(
        error.contains("two score sheets of method `stage1`, setting `recorded`"),
        "{error}"
    );
}

#[test]
fn a_label_makes_no_rollout() {
    let workspace = Workspace::small(1);
    let refused = |name: &str, more: &str, rollouts: Option<&str>, text: &str| {
        manifest(&workspace, name, "run", more, rollouts);
        let output = workspace.rogs(&["plan", name]);
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && error.contains(text), "{error}");
    };
    refused("label.toml", "setting = \"rollout\"", None, "recorded images are none");
    refused(
        "both.toml",
        "setting = \"both\"",
        None,
        "a rollout needs frames of a world model",
    );
    refused(
        "other.toml",
        "setting = \"cosmos\"",
        None,
        "must be `recorded`, `rollout` or `both`",
    );
    refused("nowhere.toml", "", Some("nowhere"), "data/nowhere` is not a folder");

    // A clip without a rollout fails in its rollout alone.
    std::fs::create_dir(workspace.path("data/empty")).unwrap();
    manifest(
        &workspace,
        "empty.toml",
        "empty",
        "stages = [\"robot-maps\"]",
        Some("empty"),
    );
    let (code, summary) = workspace.rogs_json(&["run", "empty.toml", "--no-report", "--json"]);
    assert_ne!(code, Some(0));
    assert_eq!(summary["units"]["made"], 2, "{summary:#}");
    let status = String::from_utf8(workspace.rogs(&["status", "empty"]).stdout).unwrap();
    assert!(status.contains("there is no rollout of episode"), "{status}");
}

/// The chunk, followed from its first pose, gives the recorded poses: with arithmetic of its own.
#[test]
fn what_a_world_model_is_given_leads_back_to_the_recording() {
    let workspace = Workspace::small(1);
    let text = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    workspace.write(
        "manifest.toml",
        &text.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1),
    );
    let (code, summary) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(0), "{summary:#}");
    let arguments = [
        "export",
        "rollout-inputs",
        "run",
        "--out",
        "inputs",
        "--size",
        "56x42",
        "--json",
    ];
    let link = "panda_link8";
    let unknown: Vec<&str> = arguments.iter().copied().chain(["--link", "panda_link9"]).collect();
    let error = String::from_utf8(workspace.rogs(&unknown).stderr).unwrap();
    assert!(
        error.contains("no link `panda_link9`; ") && error.contains("--link names one"),
        "{error}"
    );
    let (code, written) = workspace.rogs_json(&arguments);
    assert_eq!(code, Some(0), "{written:#}");
    let folder = workspace.path(written["folders"][0].as_str().unwrap());

    let image = image::open(folder.join("observation.png")).unwrap().into_rgb8();
    assert_eq!(image.dimensions(), (56, 63));
    let outputs = workspace.outputs("run");
    let file = |name: &str| {
        workspace
            .path("run")
            .join(outputs.keys().find(|path| path.ends_with(name)).unwrap())
    };
    let (clip, _) = read_record::<Clip>(&file("clip.r4c")).unwrap();
    let wrist = clip.target(CameraIndex(0), FrameIndex(0)).unwrap().rgb();
    assert!(image.as_raw()[..56 * 42 * 3] == *wrist, "the wrist view is on top");

    let (maps, _) = read_record::<RobotMaps>(&file("robot.r4c")).unwrap();
    let told: Value = serde_json::from_slice(&std::fs::read(folder.join("actions.json")).unwrap()).unwrap();
    let numbers =
        |value: &Value| -> Vec<f64> { value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect() };
    let rows: Vec<Vec<f64>> = told["actions"].as_array().unwrap().iter().map(numbers).collect();
    assert_eq!((rows.len(), rows[0].len()), (16, 10));
    let product = |a: &[f64], b: &[f64]| -> Vec<f64> {
        let entry = |at: usize| (0..4).map(|k| a[at / 4 * 4 + k] * b[k * 4 + at % 4]).sum();
        (0..16).map(entry).collect()
    };
    let place = maps.link_names.iter().position(|name| name == link).unwrap();
    let turn = [
        0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
    ];
    let mut pose = numbers(&told["initial_pose"]);
    for frame in 0..17 {
        let stored = &maps.base_from_link[frame * maps.link_names.len() + place];
        let ([a, b, c, d, e, f, g, h, i], [x, y, z]) = (stored.rotation, stored.translation);
        let recorded = product(&[a, b, c, x, d, e, f, y, g, h, i, z, 0.0, 0.0, 0.0, 1.0], &turn);
        let worst = pose
            .iter()
            .zip(&recorded)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(worst < 1e-9, "frame {frame}: {worst}");
        if let Some([x, y, z, a, b, c, d, e, f, gripper]) = rows.get(frame).map(|row| &row[..]) {
            let third = [b * f - c * e, c * d - a * f, a * e - b * d];
            let delta = [
                *a, *d, third[0], *x, *b, *e, third[1], *y, *c, *f, third[2], *z, 0.0, 0.0, 0.0, 1.0,
            ];
            pose = product(&pose, &delta);
            assert!((gripper - (1.0 - clip.robot.gripper[frame + 1])).abs() < 1e-12);
        }
    }
    let npy = std::fs::read(folder.join("actions.npy")).unwrap();
    let values = &npy[npy.len() - 16 * 10 * 4..];
    for (bytes, value) in values.chunks_exact(4).zip(rows.iter().flatten()) {
        assert_eq!(f32::from_le_bytes(bytes.try_into().unwrap()), *value as f32);
    }
    let again = workspace.rogs(&arguments);
    assert!(!again.status.success(), "a folder that is there is not written over");
    let few: Vec<&str> = arguments.iter().copied().chain(["--steps", "17"]).collect();
    let error = String::from_utf8(workspace.rogs(&few).stderr).unwrap();
    assert!(error.contains("17 steps need 18 frames, the clip has 17"), "{error}");
}

#[needs(long = "an episode lifted from five rollouts")]
#[test]
fn scores_fall_in_the_order_of_the_distortions() {
    let workspace = Workspace::with_episodes(1);
    let stages = "stages = [\"lift\", \"score\"]";
    manifest(&workspace, "recorded.toml", "recorded", stages, None);
    let (code, summary) = workspace.rogs_json(&["run", "recorded.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(0), "{summary:#}");
    let (_, table) = workspace.rogs_json(&["table", "recorded", "--json"]);
    let recorded = mean(&table, RECORDED, "stage1", "source PSNR").unwrap();
    let psnr = |name: &str, distortions: &[&str]| {
        make_rollouts(&workspace, "140x84", "33", name, distortions);
        let file = format!("{name}.toml");
        manifest(
            &workspace,
            &file,
            name,
            &format!("{stages}\nsetting = \"rollout\""),
            Some(name),
        );
        let (code, summary) = workspace.rogs_json(&["run", &file, "--no-report", "--json"]);
        assert_eq!(code, Some(0), "{summary:#}");
        // Both blocks from two runs.
        let (_, table) = workspace.rogs_json(&["table", "recorded", name, "--json"]);
        assert_eq!(mean(&table, RECORDED, "stage1", "source PSNR"), Some(recorded));
        mean(&table, ROLLOUTS, "stage1", "source PSNR").unwrap()
    };
    let blur = [psnr("blur-1", &["--blur", "1"]), psnr("blur-3", &["--blur", "3"])];
    let drift = psnr("drift", &["--drift", "0.06"]);
    let lag = psnr("lag", &["--lag", "2"]);
    let all = psnr("all", &["--blur", "3", "--drift", "0.06", "--lag", "2"]);
    println!("recorded {recorded}, blur {blur:?}, drift {drift}, lag {lag}, all {all}");
    assert!(
        recorded > blur[0] && blur[0] > blur[1],
        "recorded {recorded}, blur {blur:?}"
    );
    assert!(
        recorded > drift && recorded > lag,
        "recorded {recorded}, drift {drift}, lag {lag}"
    );
    assert!(
        all < blur[1].min(drift).min(lag),
        "all {all}, blur {blur:?}, drift {drift}, lag {lag}"
    );
}
