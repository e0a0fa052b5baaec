//! What a person sees when a manifest is wrong.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::Workspace;
use rogs_orchestrator::{Error, Exit};

/// The message and hint for a manifest with this at its end.
fn refusal(more: &str) -> (String, String) {
    let workspace = Workspace::new();
    workspace.manifest(more);
    told(&workspace)
}

fn told(workspace: &Workspace) -> (String, String) {
    let error = workspace.try_prepare().unwrap_err();
    assert_eq!(error.exit(), Exit::Usage, "{error}");
    let place = workspace.path("").display().to_string();
    (error.to_string().replace(&place, ""), error.hint().unwrap_or_default())
}

#[test]
fn unknown_names_have_line_column_and_a_suggestion() {
    let (message, hint) = refusal("[lifft]\nseed = 1\n");
    assert!(message.starts_with("toy.toml:11:2: unknown field `lifft`"), "{message}");
    assert_eq!(hint, "did you mean `lift`?");
    let (message, hint) = refusal("[lift]\nseed = 1\nno_anchr = true\n");
    assert!(
        message.starts_with("toy.toml:13:1: unknown parameter `no_anchr` of `lift`"),
        "{message}"
    );
    assert_eq!(hint, "did you mean `no_anchor`?");
    let (message, hint) = refusal("[robot.spec]\ngriper_joint = \"x\"\n");
    assert!(
        message.starts_with("toy.toml:12:1: unknown field `griper_joint`"),
        "{message}"
    );
    assert_eq!(hint, "did you mean `gripper_joint`?");
    let (message, hint) = refusal("[executor.deadline]\nlft = 3.0\n");
    assert!(message.starts_with("toy.toml:12:1: unknown stage `lft`"), "{message}");
    assert_eq!(hint, "did you mean `lift`?");
}

#[test]
fn numbers_that_no_machine_has_are_refused_at_their_place() {
    for (line, word) in [
        ("workers = 9223372036854775807", "`executor.workers`"),
        ("workers = 0", "`executor.workers`"),
        ("threads = 100000000", "`executor.threads`"),
        ("grace = nan", "`executor.grace`"),
        ("grace = inf", "`executor.grace`"),
        ("grace = -1.0", "`executor.grace`"),
        ("deadline = { lift = nan }", "`executor.deadline.lift`"),
        ("deadline = { lift = 0.0 }", "`executor.deadline.lift`"),
    ] {
        let (message, _) = refusal(&format!("[executor]\n{line}\n"));
        assert!(message.starts_with("toy.toml:12:"), "{line}: {message}");
        assert!(
            message.contains(word) && message.contains("expected "),
            "{line}: {message}"
        );
    }
    for line in ["shards = 0", "at-once = 0", "cpus = { lift = 0 }"] {
        let (message, _) = refusal(&format!("[slurm]\n{line}\n"));
        assert!(message.contains("expected 1 to "), "{line}: {message}");
    }
}

#[test]
fn wrong_values_say_where_and_what() {
    let (message, _) = refusal("[lift]\nseed = \"one\"\n");
    assert!(
        message.starts_with("toy.toml:11:2: lift: wrong parameters: invalid type: string"),
        "{message}"
    );
    let (message, _) = refusal("[executor]\nmemory = \"lots\"\n");
    assert!(
        message.contains("invalid size `lots`: expected e.g. `12 GiB`"),
        "{message}"
    );
    let (message, _) = refusal("[executor]\nworkers = 0\n");
    assert!(
        message.contains("invalid `executor.workers` 0: expected 1 to "),
        "{message}"
    );
    let (message, _) = refusal("[[variants]]\nname = \"../x\"\n");
    assert!(message.contains("invalid variant name"), "{message}");
    let (message, _) = refusal("[[variants]]\nname = \"x\"\n[[variants]]\nname = \"X\"\n");
    assert!(message.contains("two variants are named"), "{message}");
    let (message, _) = refusal("broken = [1,\n");
    assert!(message.starts_with("toy.toml:1"), "{message}");
}

#[test]
fn what_is_observed_is_asked_for_in_one_place() {
    for table in ["ingest", "input.ingest"] {
        let (message, hint) = refusal(&format!("[{table}]\nobservations = \"rollout\"\n"));
        assert!(
            message.starts_with("toy.toml:12:1: `observations` is not set here"),
            "{message}"
        );
        assert!(hint.contains("[rollouts]"), "{hint}");
    }
    let (message, _) = refusal("[[variants]]\nname = \"x\"\ningest = { rollout = {} }\n");
    assert!(message.contains("`rollout` is not set here"), "{message}");
    let (message, hint) = refusal("[[predictions]]\nname = \"x\"\nroot = \"r\"\nsetting = \"rollout\"\n");
    assert!(
        message.contains("the run has no setting `rollout`, it has recorded"),
        "{message}"
    );
    assert!(hint.contains("[rollouts]"), "{hint}");
}

#[test]
fn mistakes_in_a_variant_or_episode_are_marked_there() {
    // The first variant is right, the second is not.
    let first = "[[variants]]\nname = \"a\"\nlift.seed = 1\n";
    let (message, hint) = refusal(&format!("{first}[[variants]]\nname = \"b\"\nlift.sed = 1\n"));
    assert!(
        message.starts_with("toy.toml:16:6: unknown parameter `sed` of `variants.lift`"),
        "{message}"
    );
    assert_eq!(hint, "did you mean `seed`?");
    let (message, _) = refusal(&format!(
        "{first}[[variants]]\nname = \"b\"\n[variants.lift]\nseed = \"x\"\n"
    ));
    assert!(
        message.starts_with("toy.toml:16:11: lift: wrong parameters"),
        "{message}"
    );
    let (message, _) = refusal(&format!("{first}[[variants]]\nname = \"b\"\nweights.lift = \"gone\"\n"));
    assert!(message.starts_with("toy.toml:16:9: `gone` is not there"), "{message}");
    let (message, _) = refusal(&format!("{first}[[variants]]\nname = \"a\"\n"));
    assert!(message.starts_with("toy.toml:15:1: two variants"), "{message}");
    let episode =
        |select: &str| format!("[[episodes]]\nroot = \"episodes\"\nselect = \"{select}\"\nid = \"{select}1\"\n");
    let (message, _) = refusal(&(episode("a") + &episode("bb")));
    assert!(
        message.starts_with("toy.toml:17:1: `episodes` has no episode `bb`"),
        "{message}"
    );
    let (message, _) = refusal("[run.x]\n");
    assert!(message.starts_with("toy.toml:11:6: unknown field `x`"), "{message}");
}

#[test]
fn missing_files_are_named() {
    let (message, hint) = refusal("[weights]\nlift = \"gone.safetensors\"\n");
    assert!(
        message.starts_with("toy.toml:12:1: `gone.safetensors` is not there"),
        "{message}"
    );
    assert!(hint.contains("relative to the manifest"), "{hint}");
    let workspace = Workspace::new();
    std::fs::remove_dir_all(workspace.path("episodes")).unwrap();
    assert!(told(&workspace).0.contains("is not a folder"));
    std::fs::create_dir(workspace.path("episodes")).unwrap();
    assert!(told(&workspace).0.contains("holds no episode"));
}

#[test]
fn single_episodes_are_picked_by_id_and_named_safely() {
    let workspace = Workspace::new();
    let base = "[run]\nname = \"toy\"\nout = \"run\"\nagreement = false\n[robot]\nurdf = \"robot/robot.urdf\"\n";
    let with = |episodes: &str| workspace.write("toy.toml", &format!("{base}{episodes}"));
    with("[[episodes]]\nroot = \"episodes\"\nselect = \"bb\"\n");
    let (message, hint) = told(&workspace);
    assert!(message.contains("has no episode `bb`"), "{message}");
    assert_eq!(hint, "did you mean `b`?");
    with("[[episodes]]\nroot = \"episodes\"\n");
    assert!(told(&workspace).1.contains("set `select` to one of: a, b, c"));
    with("[[episodes]]\nroot = \"episodes\"\nselect = \"a\"\nid = \"../../etc\"\n");
    assert!(told(&workspace).0.contains("invalid clip name"));
    with("[[episodes]]\nroot = \"episodes\"\nselect = \"a\"\n[[episodes]]\nroot = \"episodes\"\nselect = \"a\"\n");
    assert!(told(&workspace).1.contains("each its own") || told(&workspace).0.contains("twice"));
    with(
        "[[episodes]]\nroot = \"episodes\"\nselect = \"a\"\nid = \"x\"\ningest.faster = 0.3\n[[episodes]]\nroot = \"episodes\"\nselect = \"a\"\n",
    );
    let summary = workspace.run();
    assert_eq!((summary.exit, summary.clips.total), (Exit::Done, 2));
    with("");
    assert!(told(&workspace).0.contains("names no episodes"));
}

#[test]
fn names_that_collide_without_regard_to_case_get_a_suffix() {
    let workspace = Workspace::new();
    workspace.episode("A", "capital");
    workspace.episode("x:y", "colon");
    let plan = workspace.prepare().plan;
    let ids: Vec<&str> = plan.clips.iter().map(|clip| clip.id.as_str()).collect();
    assert_eq!(ids.len(), 5);
    assert!(
        ids.contains(&"A") && ids.iter().any(|id| id.starts_with("a-")) && ids.contains(&"x_y"),
        "{ids:?}"
    );
}

#[test]
fn filters_take_and_leave_out() {
    let workspace = Workspace::new();
    let base = "[run]\nname = \"toy\"\nout = \"run\"\nagreement = false\n[robot]\nurdf = \"robot/robot.urdf\"\n[input]\nroot = \"episodes\"\n";
    let ids = |more: &str| {
        workspace.write("toy.toml", &format!("{base}{more}"));
        workspace
            .prepare()
            .plan
            .clips
            .iter()
            .map(|clip| clip.id.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(ids("exclude = [\"b\"]\n"), ["a", "c"]);
    assert_eq!(ids("include = [\"?\"]\nlimit = 2\n"), ["a", "b"]);
    workspace.write("toy.toml", &format!("{base}include = [\"z*\"]\n"));
    assert!(told(&workspace).0.contains("no episode in"));
    workspace.write("toy.toml", &format!("{base}include = [\"a\", \"bb\", \"zebra\"]\n"));
    let message = told(&workspace).0;
    assert!(
        message.contains("has no episode `bb` (did you mean `b`?), `zebra`"),
        "{message}"
    );
}

#[test]
fn stages_can_be_left_out() {
    let workspace = Workspace::new();
    let text = std::fs::read_to_string(workspace.path("toy.toml")).unwrap();
    workspace.write(
        "toy.toml",
        &text.replace("out = \"run\"", "out = \"run\"\nstages = [\"score\"]"),
    );
    let labels: Vec<_> = workspace
        .prepare()
        .plan
        .nodes
        .into_iter()
        .map(|node| node.label)
        .collect();
    assert_eq!(labels, ["ingest", "robot-maps", "conditioning", "lift", "score-1"]);
    workspace.write(
        "toy.toml",
        &text.replace("out = \"run\"", "out = \"run\"\nstages = [\"robot-maps\"]"),
    );
    assert_eq!(workspace.run().units.total, 6);
    // A misspelt name in the table of a stage that the run does not reach is one nevertheless.
    let text = text.replace("out = \"run\"", "out = \"run\"\nstages = [\"robot-maps\"]");
    workspace.write("toy.toml", &format!("{text}\n[lift]\nno_anchr = true\n"));
    let (message, hint) = told(&workspace);
    assert!(message.contains("unknown parameter `no_anchr` of `lift`"), "{message}");
    assert_eq!(hint, "did you mean `no_anchor`?");
}

#[test]
fn the_schema_for_editors_names_every_table() {
    let schema = rogs_orchestrator::manifest::Manifest::json_schema();
    for table in [
        "run",
        "input",
        "episodes",
        "robot",
        "weights",
        "lift",
        "robot-maps",
        "variants",
        "executor",
        "slurm",
    ] {
        assert!(schema["properties"][table].is_object(), "{table}");
    }
}

#[test]
fn a_stage_program_that_is_not_there_is_named() {
    let workspace = Workspace::new();
    workspace.manifest("[executor]\nprograms = \"nowhere\"\n");
    let error = workspace.try_prepare().unwrap_err();
    assert!(
        matches!(error, Error::Program { .. }) && error.exit() == Exit::Environment,
        "{error}"
    );
    assert!(
        error.to_string().contains("rogs-ingest") && error.hint().unwrap().contains("nowhere"),
        "{error}"
    );
}
