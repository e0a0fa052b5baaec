//! Every command prints one JSON value on standard output when it is asked with `--json`, as `rogs schema` says.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

#[path = "support/schema.rs"]
mod schema;
mod support;

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use rogs_needs::needs;
use serde_json::{Value, json};
use support::{ROGS, Workspace};

/// The commands of each test here, as manual pages name them; together they are all.
const RUNS: [&str; 13] = [
    "rogs-audit",
    "rogs-plan",
    "rogs-config-show",
    "rogs-submit",
    "rogs-run",
    "rogs-status",
    "rogs-verify",
    "rogs-report",
    "rogs-table",
    "rogs-logs",
    "rogs-diff",
    "rogs-gc",
    "rogs-inspect",
];
const PICTURES: [&str; 5] = [
    "rogs-render",
    "rogs-query",
    "rogs-metrics",
    "rogs-export-field",
    "rogs-export-clip",
];
const DATA: [&str; 6] = [
    "rogs-fk",
    "rogs-cohort",
    "rogs-synth",
    "rogs-init",
    "rogs-list",
    "rogs-calibrate",
];
const WEIGHTS: [&str; 7] = [
    "rogs-weights-list",
    "rogs-weights-verify",
    "rogs-weights-fetch",
    "rogs-weights-generate",
    "rogs-weights-import",
    "rogs-weights-merge",
    "rogs-weights-average",
];
const PROGRAM: [&str; 4] = ["rogs-doctor", "rogs-schema", "rogs-completions", "rogs-man"];
const DEMO: [&str; 1] = ["rogs-demo"];

/// Asked in `tests/rollouts.rs`, which has what it needs.
const ROLLOUTS: [&str; 1] = ["rogs-export-rollout-inputs"];

/// The formats that each test here sees, as `rogs schema` names them; together they are all.
const FORMATS: [(&[&str], &[&str]); 7] = [
    (
        &RUNS,
        &[
            "audit",
            "config",
            "diff",
            "gc",
            "inspect",
            "logs",
            "plan",
            "plan-emit",
            "plan-explain",
            "report",
            "run",
            "status",
            "submit",
            "table",
            "verify",
        ],
    ),
    (&PICTURES, &["export-clip", "export-field", "film", "metrics", "render"]),
    (&DATA, &["calibrate", "fk", "init", "list", "selection", "synth"]),
    (
        &WEIGHTS,
        &[
            "weights-average",
            "weights-files",
            "weights-generate",
            "weights-import",
            "weights-list",
            "weights-merge",
            "weights-verify",
        ],
    ),
    (&PROGRAM, &["completions", "doctor", "man", "schemas"]),
    (&DEMO, &["demo"]),
    // The second needs a network.
    (&ROLLOUTS, &["export-rollout-inputs", "weights-fetch"]),
];

/// What ends with Ctrl-C alone, and prints an address.
const ENDLESS: [&str; 1] = ["rogs-view"];
/// The commands that only group others.
const GROUPS: [&str; 4] = ["rogs", "rogs-config", "rogs-export", "rogs-weights"];

/// Camera file with one view in the base frame.
const CAMERA: &str = r#"{"name": "view", "width": 56, "height": 42, "intrinsics": {"fx": 30, "fy": 30, "cx": 28, "cy": 21},
    "recon_from_camera": [[1,0,0,0], [0,1,0,0], [0,0,1,0], [0,0,0,1]]}"#;

/// The bundled Stage-1 weights in a workspace.
const LIFT_WEIGHTS: &str = "compact-stage1.safetensors";

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Asks commands for JSON and remembers which.
struct Asking<'a> {
    workspace: &'a Workspace,
    seen: BTreeSet<String>,
    formats: BTreeSet<String>,
}

impl<'a> Asking<'a> {
    fn new(workspace: &'a Workspace) -> Self {
        Self {
            workspace,
            seen: BTreeSet::new(),
            formats: BTreeSet::new(),
        }
    }

    /// The value that a command prints, with the exit code it must have.
    fn ask(&mut self, code: i32, arguments: &[&str]) -> Value {
        let words = if ["config", "export", "weights"].contains(&arguments[0]) {
            2
        } else {
            1
        };
        self.seen.insert(format!("rogs-{}", arguments[..words].join("-")));
        let output = self.workspace.rogs(&[arguments, &["--json"]].concat());
        let called = arguments.join(" ");
        assert_eq!(output.status.code(), Some(code), "{called}: {}", text(&output.stderr));
        let value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{called}: no JSON ({error}): {}", text(&output.stdout)));
        assert!(!text(&output.stderr).contains("panicked"), "{called}");
        self.is_as_its_schema_says(&value, &called);
        value
    }

    fn is_as_its_schema_says(&mut self, value: &Value, called: &str) {
        let format = value["format"]
            .as_str()
            .unwrap_or_else(|| panic!("{called}: no format"));
        let output = self.workspace.rogs(&["schema", format]);
        assert!(output.status.success(), "{called}: {}", text(&output.stderr));
        let schema: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(schema["$id"], format);
        schema::check(&schema, value).unwrap_or_else(|error| panic!("{called}: {error}"));
        let name = format.strip_prefix("rogs.").and_then(|rest| rest.split('/').next());
        self.formats.insert(name.unwrap().to_owned());
    }

    /// Ends a test: these commands were asked, and gave all formats of [`FORMATS`].
    fn asked(self, commands: &[&str]) {
        let set = |names: &[&str]| -> BTreeSet<String> { names.iter().map(|name| (*name).to_owned()).collect() };
        assert_eq!(self.seen, set(commands));
        let (_, formats) = FORMATS.iter().find(|(of, _)| *of == commands).unwrap();
        assert_eq!(self.formats, set(formats));
    }
}

fn length(value: &Value) -> usize {
    value.as_array().unwrap().len()
}

/// The only clip of a run.
fn clip_of(workspace: &Workspace, run: &str) -> String {
    let clips = std::fs::read_dir(workspace.path(run).join("clips")).unwrap();
    let names: Vec<String> = clips
        .map(|clip| clip.unwrap().file_name().into_string().unwrap())
        .collect();
    assert_eq!(names.len(), 1);
    names[0].clone()
}

#[test]
fn every_command_has_a_check_of_its_json() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("man");
    let output = Command::new(ROGS)
        .args(["man", "--json", "--out"])
        .arg(&out)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let pages: Value = serde_json::from_slice(&output.stdout).unwrap();
    let files: Vec<std::path::PathBuf> = serde_json::from_value(pages["files"].clone()).unwrap();
    let mut names: BTreeSet<String> = BTreeSet::new();
    for file in &files {
        let page = std::fs::read_to_string(file).unwrap();
        assert!(page.contains(".TH ") && page.contains(".SH NAME"), "{}", file.display());
        names.insert(file.file_stem().unwrap().to_string_lossy().into_owned());
    }
    let page = std::fs::read_to_string(out.join("rogs-run.1")).unwrap();
    assert!(page.contains("same bytes"));
    let here = [
        &RUNS[..],
        &PICTURES,
        &DATA,
        &WEIGHTS,
        &PROGRAM,
        &DEMO,
        &ROLLOUTS,
        &GROUPS,
        &ENDLESS,
    ]
    .concat();
    assert_eq!(names, here.into_iter().map(str::to_owned).collect());
}

#[test]
fn every_format_has_a_check() {
    let output = Command::new(ROGS).args(["schema", "--json"]).output().unwrap();
    let listed: Value = serde_json::from_slice(&output.stdout).unwrap();
    let items = listed["items"].as_array().unwrap();
    let names: BTreeSet<&str> = items.iter().map(|item| item["name"].as_str().unwrap()).collect();
    let here = FORMATS.iter().flat_map(|(_, formats)| *formats).copied();
    assert_eq!(names, here.chain(["manifest"]).collect());
}

#[test]
fn commands_about_runs() {
    let workspace = Workspace::small(1);
    workspace.manifest("other.toml", "other");
    let mut asking = Asking::new(&workspace);
    let mut ask = |code: i32, arguments: &[&str]| asking.ask(code, arguments);
    let estimate = ask(0, &["plan", "manifest.toml"]);
    assert_eq!(
        (&estimate["clips"], &estimate["nodes"][0]["measured"]),
        (&json!(1), &json!(false))
    );
    assert!(estimate["seconds"].as_f64().unwrap() > 0.0);
    let shown = ask(0, &["config", "show", "manifest.toml", "--only", "run."]);
    let values = shown["values"].as_array().unwrap();
    assert!(values.iter().any(|value| value["key"] == "run.name"), "{shown:#}");
    let dry = ask(0, &["submit", "manifest.toml", "--dry-run"]);
    assert_eq!((&dry["ids"], length(&dry["scripts"])), (&json!([]), 7));
    assert!(!workspace.path("run").exists(), "a dry run writes nothing");
    assert_eq!(length(&ask(0, &["plan", "manifest.toml", "--explain"])["items"]), 7);
    assert_eq!(ask(0, &["run", "manifest.toml"])["units"]["made"], 7);
    let audited = ask(0, &["audit", "manifest.toml", "--out", "audited"]);
    assert_eq!(length(&audited["clips"][0]["cameras"]), 3, "{audited:#}");
    assert_eq!(ask(0, &["plan", "manifest.toml", "--explain"])["items"], json!([]));
    let exported = ask(0, &["plan", "other.toml", "--emit", "jsonl"]);
    assert_eq!((&exported["units"], length(&exported["commands"])), (&json!(7), 6));
    assert_eq!(ask(0, &["status", "run"])["clips"]["done"], 1);
    assert_eq!(ask(75, &["status", "other"])["clips"]["done"], 0);
    assert_eq!(ask(0, &["verify", "run"])["good"], 7);
    assert!(ask(0, &["report", "run"])["report"].is_string());
    assert!(ask(0, &["report", "run", "--table", "main"]).is_object());
    assert!(ask(0, &["table", "run"]).is_object());
    let clip = clip_of(&workspace, "run");
    assert_eq!(length(&ask(0, &["logs", "run", &clip])["items"]), 7);
    assert_eq!(ask(0, &["diff", "run", "run"])["same"], 7);
    assert_eq!(length(&ask(1, &["diff", "run", "other"])["only_a"]), 7);
    assert_eq!(ask(0, &["gc", "run", "--dry-run"])["files"], json!([]));
    let field = format!("run/clips/{clip}/field-1.r4c");
    assert_eq!(ask(0, &["inspect", &field])["schema"], "rogs.field");
    asking.asked(&RUNS);
}

#[test]
fn commands_that_draw_and_compare_pictures() {
    let workspace = Workspace::small(1);
    workspace.write("camera.json", CAMERA);
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let manifest = manifest.replacen("[run]\n", "[run]\nstages = [\"lift\"]\n", 1);
    workspace.write("manifest.toml", &manifest);
    assert!(
        workspace
            .rogs(&["run", "manifest.toml", "--no-report"])
            .status
            .success()
    );
    let clip = clip_of(&workspace, "run");
    let field = format!("run/clips/{clip}/field-1.r4c");
    let view = ["--camera", "camera.json", "--out", "pictures"];
    let mut asking = Asking::new(&workspace);
    let render = [&["render", &field], &view[..]].concat();
    assert_eq!(length(&asking.ask(0, &render)["items"]), 1);
    let film = [
        "render", &field, "--camera", "orbit", "--frames", "2", "--time", "0", "--video", "film.gif",
    ];
    assert_eq!(asking.ask(0, &film)["frames"], 2);
    // The built-in weights need no file.
    let query = [&["query", &field, "--time", "0.37"], &view[..]].concat();
    assert_eq!(length(&asking.ask(0, &query)["items"]), 1);
    let export = [
        "export",
        "field",
        &field,
        "--times",
        "0",
        "--format",
        "ply-compressed",
        "--out",
        "field.ply",
    ];
    assert_eq!(asking.ask(0, &export)["times"], json!([0.0]));
    let clip_file = format!("run/clips/{clip}/clip.r4c");
    let set = [
        "export",
        "clip",
        &clip_file,
        "--format",
        "nerfstudio",
        "--frames",
        "0",
        "--cameras",
        "source",
        "--out",
        "set",
    ];
    assert_eq!(asking.ask(0, &set)["held_out"], 0);
    let images = format!("data/episodes/{clip}/wrist");
    assert_eq!(length(&asking.ask(0, &["metrics", &images, &images])["pairs"]), 17);
    asking.asked(&PICTURES);
}

#[test]
fn commands_about_data() {
    let workspace = Workspace::small(1);
    workspace.write("joints.csv", "panda_joint1\n0.1\n");
    let episode = json!({"episode_id": "ILIAD+abc+2023-01-01-10h-00m-00s", "lab": null, "scene": "s", "clip_name": "clip_001",
        "train_or_val": false, "stereo": true, "frames": 33, "calibration": true, "gripper_range": [0.0, 1.0]});
    workspace.write("episodes.json", &json!([episode]).to_string());
    let split = json!({"domain": "droid", "seed": 42, "test_percentage": 0.1,
        "test_clip_keys": ["ILIAD+abc+2023-01-01-10h-00m-00s-0:33"]});
    workspace.write("split.json", &split.to_string());
    let mut asking = Asking::new(&workspace);
    let fk = ["fk", "data/robot/panda_synth.urdf", "--joints", "joints.csv"];
    assert_eq!(length(&asking.ask(0, &fk)["items"]), 1);
    let files = ["--episodes", "episodes.json", "--manifest", "split.json"];
    let cohort = [&["cohort"], &files[..], &["--take", "1"]].concat();
    assert_eq!(asking.ask(0, &cohort)["counts"]["selected"], 1);
    // What is there already: nothing is written.
    let made_with = ["--episodes", "1", "--seed", "11", "--size", "56x42", "--frames", "17"];
    let synth = [&["synth", "--out", "data"], &made_with[..]].concat();
    assert_eq!(asking.ask(0, &synth)["dataset"]["written"], 0);
    let list = asking.ask(0, &["list", "data/episodes"]);
    assert_eq!(
        (length(&list["episodes"]), &list["episodes"][0]["frames"]),
        (1, &json!(17))
    );
    let init = asking.ask(0, &["init", "data/episodes", "--out", "own.toml"]);
    assert_eq!(
        (&init["urdf"], &init["missing"]),
        (&json!("data/robot/panda_synth.urdf"), &json!([]))
    );
    let calibrate = ["calibrate", "data/episodes", "--camera", "ext1", "--size", "224x168"];
    let calibrated = asking.ask(0, &[&calibrate[..], &["--out", "cameras.json"]].concat());
    assert_eq!(calibrated["cameras"][0]["camera"], "ext1");
    let written = std::fs::read_to_string(workspace.path("cameras.json")).unwrap();
    let written: Value = serde_json::from_str(&written).unwrap();
    assert_eq!(length(&written["cameras"]["ext1"]["camera_to_base"]), 3);
    // Those that were not asked for are kept.
    assert!(written["cameras"]["wrist"]["camera_to_link"].is_array());
    asking.asked(&DATA);
}

#[test]
fn commands_about_weights() {
    let workspace = Workspace::small(1);
    let mut asking = Asking::new(&workspace);
    let mut ask = |arguments: &[&str]| asking.ask(0, &[&["weights"], arguments].concat());
    std::fs::write(workspace.path(LIFT_WEIGHTS), rogs_lift::COMPACT_WEIGHTS).unwrap();
    let listed = ask(&["list", LIFT_WEIGHTS]);
    assert!(listed["elements"].as_u64().unwrap() > 1_000_000);
    assert!(ask(&["verify", LIFT_WEIGHTS]).is_object());
    assert!(length(&ask(&["fetch"])["items"]) > 0);
    let generate = ["generate", "--out", "seeded.safetensors", "--numbers", "f16"];
    assert_eq!(ask(&generate)["seed"], 73);
    let import = ["import", LIFT_WEIGHTS, "--out", "imported.safetensors"];
    let import = [&import[..], &["--configuration", "compact-sweep"]].concat();
    assert!(ask(&import)["tensors"].as_u64().unwrap() > 100);
    with_low_rank_updates(&workspace.path(LIFT_WEIGHTS), &workspace.path("updated.safetensors"));
    let updated = ask(&["list", "updated.safetensors"]);
    assert!(length(&updated["tensors"]) > length(&listed["tensors"]));
    let merge = ["merge", "updated.safetensors", "--out", "merged.safetensors"];
    assert_eq!(ask(&merge)["out"], "merged.safetensors");
    // Folded in: the tensors of a plain checkpoint again, with its provenance told.
    let merged = ask(&["list", "merged.safetensors"]);
    assert_eq!(merged["tensors"], listed["tensors"]);
    let provenance = merged["metadata"]["rogs.provenance"].as_str().unwrap();
    assert!(provenance.ends_with("low-rank updates merged"), "{provenance}");
    assert_eq!(ask(&["verify", "merged.safetensors"])["good"], true);
    let average = ["average", "merged.safetensors", LIFT_WEIGHTS, "--shares", "3,1"];
    let average = [&average[..], &["--out", "average.safetensors"]].concat();
    let inputs = json!([["merged.safetensors", 3.0], [LIFT_WEIGHTS, 1.0]]);
    assert_eq!(ask(&average)["inputs"], inputs);
    assert_eq!(ask(&["verify", "average.safetensors"])["good"], true);
    asking.asked(&WEIGHTS);
}

#[test]
fn commands_about_the_program() {
    let workspace = Workspace::empty();
    let mut asking = Asking::new(&workspace);
    assert!(length(&asking.ask(0, &["doctor"])["items"]) >= 5);
    assert!(length(&asking.ask(0, &["schema"])["items"]) > 30);
    let script = asking.ask(0, &["completions", "bash"]);
    assert!(script["script"].as_str().unwrap().contains("complete"));
    assert!(length(&asking.ask(0, &["man", "--out", "man"])["files"]) > 20);
    asking.asked(&PROGRAM);
}

#[needs(long = "the demo")]
#[test]
fn the_demo() {
    let workspace = Workspace::empty();
    let mut asking = Asking::new(&workspace);
    let value = asking.ask(0, &["demo", "--out", "demo", "--episodes", "1"]);
    assert!(value["table"].is_object() && Path::new(value["report"].as_str().unwrap()).exists());
    asking.asked(&DEMO);
}

/// Copies a Stage-1 checkpoint and gives its attention layers low-rank updates of rank 1.
fn with_low_rank_updates(from: &Path, to: &Path) {
    let bytes = std::fs::read(from).unwrap();
    let (length, rest) = bytes.split_first_chunk::<8>().unwrap();
    let (header, data) = rest.split_at(u64::from_le_bytes(*length) as usize);
    let mut header: serde_json::Map<String, Value> = serde_json::from_slice(header).unwrap();
    let mut data = data.to_vec();
    let layers: Vec<(String, Value)> = header
        .iter()
        .filter(|(name, _)| name.contains("_blocks.") && name.starts_with("backbone.backbone."))
        .filter_map(|(name, tensor)| Some((name.strip_suffix(".weight")?.to_owned(), tensor["shape"].clone())))
        .filter(|(layer, _)| layer.ends_with(".attn.qkv") || layer.ends_with(".attn.proj"))
        .collect();
    assert!(!layers.is_empty());
    for (layer, shape) in layers {
        for (name, shape) in [("lora_A", json!([1, shape[1]])), ("lora_B", json!([shape[0], 1]))] {
            let begin = data.len();
            let count = shape[0].as_u64().unwrap() * shape[1].as_u64().unwrap();
            data.extend((0..count).flat_map(|_| 0.01_f32.to_le_bytes()));
            header.insert(
                format!("{layer}.{name}.weight"),
                json!({"dtype": "F32", "shape": shape, "data_offsets": [begin, data.len()]}),
            );
        }
    }
    let header = serde_json::to_vec(&header).unwrap();
    let length = (header.len() as u64).to_le_bytes();
    std::fs::write(to, [&length[..], &header, &data].concat()).unwrap();
}
