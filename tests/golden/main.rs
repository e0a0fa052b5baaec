//! Every stage alone on committed inputs against its committed output. `README.md` beside this file says how and why.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

#[path = "../support/golden.rs"]
mod golden;

mod compare;
mod machine;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use compare::{Rule, compare};
use golden::{CLIP, ROGS, folder, outputs};

/// One run of one stage.
struct Case {
    stage: &'static str,
    /// The output below `outputs/`.
    output: &'static str,
    /// Upstream outputs by role.
    upstream: &'static [(&'static str, &'static str)],
    /// Sources by role, below the folder of the goldens.
    sources: &'static [(&'static str, &'static str)],
    /// The bundled weights, where the stage has some: name and content, which both are told in the output.
    weights: Option<(&'static str, &'static [u8])>,
    rule: Rule,
}

const INGEST: Case = Case {
    stage: "ingest",
    output: "clip.r4c",
    upstream: &[],
    sources: &[("episode", "data/episodes/synth-00000011")],
    weights: None,
    rule: Rule::IMAGES,
};

const ROBOT_MAPS: Case = Case {
    stage: "robot-maps",
    output: "robot.r4c",
    upstream: &[("clip", "clip.r4c")],
    sources: &[("robot-model", "data/robot/panda_synth.urdf")],
    weights: None,
    rule: Rule::GEOMETRY,
};

const CONDITIONING: Case = Case {
    stage: "conditioning",
    output: "conditioning.r4c",
    upstream: &[("clip", "clip.r4c"), ("robot", "robot.r4c")],
    sources: &[],
    weights: None,
    rule: Rule::GEOMETRY,
};

/// No run of the goldens asks for this stage, because the episode has exact references: its output lies beside the others.
const REFERENCES: Case = Case {
    stage: "references",
    output: "../asked/references.r4c",
    upstream: &[("clip", "clip.r4c"), ("robot", "robot.r4c")],
    sources: &[],
    weights: None,
    rule: Rule::GEOMETRY,
};

/// Parameters of [`REFERENCES`]: made in spite of what the clip has, for images so small that no patch is a speck.
const REFERENCES_PARAMS: &str =
    r#"{"depth": "always", "tracks": "always", "stereo": {"speckle_px": 8}, "robot": {"spacing_px": 2}}"#;

/// The manifest of the goldens leaves this stage out, as the tests of the whole program do: its output lies beside the
/// others.
const AGREEMENT: Case = Case {
    stage: "agreement",
    output: "../asked/agreement.r4c",
    upstream: &[("clip", "clip.r4c"), ("robot", "robot.r4c")],
    sources: &[("robot-model", "data/robot/panda_synth.urdf")],
    weights: None,
    rule: Rule::GEOMETRY,
};

/// Parameters of [`AGREEMENT`]: the robot as the manifest describes it.
const AGREEMENT_PARAMS: &str = r#"{"robot": {"tool_link": "gripper_base_link", "tool_offset_m": [0.0, 0.0, 0.15],
    "exclude_links": [], "collision_links": []}}"#;

const LIFT: Case = Case {
    stage: "lift",
    output: "field-1.r4c",
    upstream: &[
        ("clip", "clip.r4c"),
        ("robot", "robot.r4c"),
        ("conditioning", "conditioning.r4c"),
    ],
    sources: &[],
    weights: Some(golden::LIFT_WEIGHTS),
    rule: Rule::NETWORK,
};

const REFINE: Case = Case {
    stage: "refine",
    output: "field-2.r4c",
    upstream: &[("clip", "clip.r4c"), ("robot", "robot.r4c"), ("field", "field-1.r4c")],
    sources: &[],
    weights: Some(golden::REFINE_WEIGHTS),
    rule: Rule::NETWORK,
};

/// The manifest of the goldens does not ask for this stage: its output lies beside the others.
const FIT: Case = Case {
    stage: "fit",
    output: "../asked/field-fit.r4c",
    upstream: &[
        ("clip", "clip.r4c"),
        ("robot", "robot.r4c"),
        ("field", "field-1.r4c"),
        ("refinement", "field-2.r4c"),
    ],
    sources: &[],
    weights: None,
    rule: Rule::NETWORK,
};

/// Parameters of [`FIT`].
const FIT_PARAMS: &str = r#"{"updates": 4}"#;

/// No manifest of the goldens names this baseline: sidecars and output lie beside the others.
const LIFT_SOM: Case = Case {
    stage: "lift-som",
    output: "../asked/field-som.r4c",
    upstream: &[("clip", "clip.r4c"), ("robot", "robot.r4c")],
    sources: &[("sidecars", "asked/sidecars")],
    weights: None,
    rule: Rule::NETWORK,
};

/// Parameters of [`LIFT_SOM`]: few updates of few Gaussians, for images of 42x28; two batches an epoch.
const LIFT_SOM_PARAMS: &str = r#"{"erode_px": 1, "dilate_px": 2, "tracks": 300, "background": 300, "clusters": 3,
    "smallest_cluster": 3, "track_updates": 10, "epochs": 2, "batch": 5}"#;

const SCORE_STAGE_1: Case = Case {
    stage: "score",
    output: "scores-1.r4c",
    upstream: &[("clip", "clip.r4c"), ("robot", "robot.r4c"), ("field", "field-1.r4c")],
    sources: &[],
    weights: None,
    rule: Rule::SCORES,
};

const SCORE_STAGE_2: Case = Case {
    stage: "score",
    output: "scores-2.r4c",
    upstream: &[
        ("clip", "clip.r4c"),
        ("robot", "robot.r4c"),
        ("field", "field-1.r4c"),
        ("refinement", "field-2.r4c"),
    ],
    sources: &[],
    weights: None,
    rule: Rule::SCORES,
};

const CASES: [Case; 7] = [
    INGEST,
    ROBOT_MAPS,
    CONDITIONING,
    LIFT,
    REFINE,
    SCORE_STAGE_1,
    SCORE_STAGE_2,
];

impl Case {
    fn golden(&self) -> PathBuf {
        outputs().join(self.output)
    }

    /// Runs the stage on the committed inputs, with the parameters that the committed output was made with, and compares.
    fn check(&self) {
        if golden::updating() {
            return update();
        }
        let scratch = tempfile::tempdir().unwrap();
        let made = scratch.path().join("made.r4c");
        let params = rogs_r4c::read_header(&self.golden()).unwrap();
        self.make(&params.info.provenance.material.params, scratch.path(), &made);
        self.assert_same(&made);
    }

    /// Runs the stage on the committed inputs, with a scratch folder for what it reads besides.
    fn make(&self, params: &str, scratch: &Path, made: &Path) {
        let mut command = Command::new(ROGS);
        command.args([
            "stage",
            self.stage,
            "one",
            "--clip-id",
            CLIP,
            "--quiet",
            "--params",
            params,
        ]);
        for (role, file) in self.upstream {
            command.arg(format!("--{role}")).arg(outputs().join(file));
        }
        for (role, path) in self.sources {
            command.arg(format!("--{role}")).arg(folder().join(path));
        }
        if let Some((name, bytes)) = self.weights {
            let file = scratch.join(name);
            std::fs::write(&file, bytes).unwrap();
            command.arg("--weights").arg(file);
        }
        let output = command.arg("--out").arg(made).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    fn assert_same(&self, made: &Path) {
        if let Err(difference) = compare(&self.golden(), made, self.rule, machine::made_the_goldens()) {
            panic!(
                "{}: {difference}\nif this is meant: UPDATE_EXPECT=1 cargo test --workspace --test golden, then look at the \
                 other outputs in `git status` (tests/golden/README.md)",
                self.output
            );
        }
    }
}

/// Makes all outputs anew by one run of the pipeline, and keeps them when any is not as it was.
fn update() {
    static DONE: OnceLock<()> = OnceLock::new();
    DONE.get_or_init(|| {
        let run = golden::GoldenRun::without_outputs();
        run.rogs(&["run", "manifest.toml", "--no-report"]);
        let made = |case: &Case| run.clip_folder().join(case.output);
        let same = |case: &Case| compare(&case.golden(), &made(case), case.rule, machine::made_the_goldens()).is_ok();
        if CASES.iter().all(same) {
            return;
        }
        std::fs::create_dir_all(outputs()).unwrap();
        for case in &CASES {
            std::fs::copy(made(case), case.golden()).unwrap();
        }
        std::fs::write(machine::file(), machine::describe()).unwrap();
    });
    static ASKED: OnceLock<()> = OnceLock::new();
    ASKED.get_or_init(|| {
        for (case, params) in [
            (REFERENCES, REFERENCES_PARAMS),
            (AGREEMENT, AGREEMENT_PARAMS),
            (FIT, FIT_PARAMS),
            (LIFT_SOM, LIFT_SOM_PARAMS),
        ] {
            let scratch = tempfile::tempdir().unwrap();
            let made = scratch.path().join("made.r4c");
            case.make(params, scratch.path(), &made);
            let golden = case.golden();
            if compare(&golden, &made, case.rule, machine::made_the_goldens()).is_err() {
                std::fs::create_dir_all(golden.parent().unwrap()).unwrap();
                std::fs::copy(made, golden).unwrap();
            }
        }
    });
}

#[test]
fn ingest() {
    INGEST.check();
}

#[test]
fn robot_maps() {
    ROBOT_MAPS.check();
}

#[test]
fn conditioning() {
    CONDITIONING.check();
}

#[test]
fn references() {
    REFERENCES.check();
}

#[test]
fn agreement() {
    AGREEMENT.check();
}

#[test]
fn fit() {
    FIT.check();
}

#[test]
fn lift_som() {
    LIFT_SOM.check();
}

#[test]
fn lift() {
    LIFT.check();
}

#[test]
fn refine() {
    REFINE.check();
}

#[test]
fn score_of_stage_1() {
    SCORE_STAGE_1.check();
}

#[test]
fn score_of_stage_2() {
    SCORE_STAGE_2.check();
}

/// The keys of the committed outputs are those that a plan computes today: a run made before stays up to date.
#[test]
fn a_run_over_the_committed_outputs_has_nothing_to_make() {
    if golden::updating() {
        return update();
    }
    let run = golden::GoldenRun::new();
    let explained = run.rogs(&["plan", "manifest.toml", "--explain"]);
    assert_eq!(explained.trim(), "everything is up to date");
    run.rogs(&["run", "manifest.toml", "--no-report"]);
    let verified: serde_json::Value = serde_json::from_str(&run.rogs(&["verify", "run", "--json"])).unwrap();
    assert_eq!(verified["good"], CASES.len(), "{verified:#}");
}
