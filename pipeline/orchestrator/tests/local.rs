//! The local executor over the toy pipeline.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use common::Workspace;
use rogs_orchestrator::plan::{WorkUnit, read_plan};
use rogs_orchestrator::{Exit, status};
use rogs_schemas::interim::{self, Figures, Interim};
use rogs_schemas::protocol::FailureCode;

#[test]
fn a_run_makes_every_output_and_a_second_one_nothing() {
    let workspace = Workspace::new();
    let summary = workspace.run();
    assert_eq!(
        (summary.exit, summary.units.made, summary.clips.done),
        (Exit::Done, 21, 3),
        "{summary:?}"
    );
    assert_eq!(workspace.outputs().len(), 21);
    assert!(
        summary.warnings.iter().any(|warning| warning.starts_with("a lift: ")),
        "{:?}",
        summary.warnings
    );
    let again = workspace.run();
    assert_eq!(
        (again.exit, again.units.made, again.units.up_to_date),
        (Exit::Done, 0, 21)
    );
    let status = status::status(&workspace.run_folder()).unwrap();
    assert_eq!((status.exit, status.clips.done, status.active), (Exit::Done, 3, false));
    assert!(status.table().contains("3 of 3 clips done"), "{}", status.table());
    assert!(
        rogs_orchestrator::verify::verify(&workspace.run_folder())
            .unwrap()
            .bad
            .is_empty()
    );
}

#[test]
fn a_unit_in_work_shows_how_far_it_is() {
    let workspace = Workspace::new();
    workspace.run();
    let run = workspace.run_folder();
    let plan = read_plan(&run).unwrap();
    let (clip, keys) = (1, plan.keys(1));
    let node = plan.nodes.iter().position(|node| node.label == "refine").unwrap();
    let output = plan.output(WorkUnit { clip, node }, &keys);
    let mut shown = Interim {
        key: keys[node].key,
        figures: Figures {
            part: None,
            update: 25,
            updates: 100,
            loss: 0.0512,
            source_psnr_db: Some(25.3),
        },
    };
    let write = |shown: &Interim| {
        let path = interim::beside(&run.join(&output), interim::FIGURES);
        std::fs::write(path, serde_json::to_vec(shown).unwrap()).unwrap();
        status::status(&run).unwrap()
    };
    assert!(write(&shown).interim.is_empty(), "the output is there");
    std::fs::remove_file(run.join(&output)).unwrap();
    let status = write(&shown);
    let [own] = &status.interim[..] else {
        panic!("{:?}", status.interim)
    };
    assert_eq!((own.clip.as_str(), own.node.as_str()), ("b", "refine"));
    assert_eq!(own.figures, shown.figures);
    assert_eq!(own.picture, interim::beside(&output, interim::PICTURE));
    let table = status.table();
    assert!(
        table.contains("b at refine: update 25 of 100, loss 0.0512, source views 25.30 dB\n  picture: "),
        "{table}"
    );
    shown.key.0[0] ^= 1;
    assert!(write(&shown).interim.is_empty(), "of another unit");
}

#[test]
fn bytes_do_not_depend_on_workers_threads_or_place() {
    let (one, two) = (Workspace::new(), Workspace::new());
    let mut prepared = one.prepare();
    prepared.options.workers = 1;
    prepared.run().unwrap();
    let mut prepared = two.prepare();
    (prepared.options.workers, prepared.options.threads) = (3, 2);
    prepared.run().unwrap();
    assert!(one.outputs() == two.outputs());
}

#[test]
fn one_corrupt_episode_among_three_fails_alone() {
    let workspace = Workspace::new();
    workspace.episode("b", "fail@lift");
    let summary = workspace.run();
    assert_eq!(
        (summary.exit, summary.clips.done, summary.clips.failed),
        (Exit::Partial, 2, 1)
    );
    let [failure] = &summary.failures[..] else {
        panic!("{:?}", summary.failures)
    };
    assert_eq!(
        (failure.clip.as_str(), failure.node.as_str(), failure.code),
        ("b", "lift", FailureCode::BadInput)
    );
    assert_eq!(failure.hint.as_deref(), Some("edit the episode"));
    assert_eq!(failure.blocks, ["refine", "score-1", "score-2"]);
    let status = status::status(&workspace.run_folder()).unwrap();
    assert_eq!((status.exit, status.failures.len()), (Exit::Partial, 1));
    assert_eq!(status.nodes[4].blocked, 1);
    // The input is mended: only what depends on it is made.
    workspace.episode("b", "mended");
    let summary = workspace.run();
    assert_eq!(
        (summary.exit, summary.units.made, summary.units.up_to_date),
        (Exit::Done, 7, 14)
    );
}

#[test]
fn workers_that_panic_or_die_cost_only_their_clip() {
    let workspace = Workspace::new();
    workspace.episode("a", "panic@robot-maps");
    workspace.episode("b", "abort@lift");
    let summary = workspace.run();
    assert_eq!(
        (summary.exit, summary.clips.done, summary.clips.failed),
        (Exit::Partial, 1, 2)
    );
    let [a, b] = &summary.failures[..] else {
        panic!("{:?}", summary.failures)
    };
    assert!(a.message.contains("a panic in robot-maps"), "{a:?}");
    assert!(b.message.contains("signal 6") && b.message.contains("`b`"), "{b:?}");
    assert_eq!((a.code, b.code), (FailureCode::Internal, FailureCode::Internal));
    workspace.assert_no_temporaries();
}

#[test]
fn passing_troubles_are_tried_again_and_lack_of_memory_once_alone() {
    let workspace = Workspace::new();
    workspace.episode("a", "io@conditioning");
    workspace.episode("b", "kill@lift");
    let summary = workspace.run();
    assert_eq!(
        (summary.clips.done, summary.clips.failed),
        (2, 1),
        "{:?}",
        summary.failures
    );
    assert_eq!(
        (summary.failures[0].clip.as_str(), summary.failures[0].code),
        ("b", FailureCode::Resource)
    );
    let attempts = rogs_orchestrator::ledger::read_all(&workspace.run_folder()).unwrap();
    let tries = |clip: &str, stage: &str| {
        attempts
            .iter()
            .filter(|attempt| attempt.clip_id == clip && attempt.stage == stage)
            .count()
    };
    assert_eq!(
        (tries("a", "conditioning"), tries("b", "lift"), tries("c", "lift")),
        (2, 2, 1)
    );
}

#[test]
fn a_clip_that_hangs_is_given_up_at_its_deadline() {
    let workspace = Workspace::new();
    workspace.episode("c", "hang@refine");
    workspace.manifest("[executor]\ngrace = 0.0\n[executor.deadline]\nrefine = 0.3\n");
    // The others would be too slow as well on a machine that is busy enough.
    let mut prepared = workspace.prepare();
    prepared.options.only = Some(vec![2]);
    let summary = prepared.run().unwrap();
    assert_eq!(
        (summary.units.made, summary.clips.failed),
        (5, 1),
        "{:?}",
        summary.failures
    );
    let failure = &summary.failures[0];
    assert_eq!(failure.code, FailureCode::Deadline);
    assert!(failure.message.contains("took longer than 0.3 s"), "{failure:?}");
    let attempts = rogs_orchestrator::ledger::read_all(&workspace.run_folder()).unwrap();
    let tries = attempts.iter().filter(|attempt| attempt.stage == "refine").count();
    assert_eq!(tries, 1, "it would take as long again");
}

#[test]
fn deleted_and_damaged_outputs_are_made_again_with_the_same_bytes() {
    let workspace = Workspace::new();
    workspace.run();
    let before = workspace.outputs();
    let run = workspace.run_folder();
    std::fs::remove_file(run.join("clips/a/field-1.r4c")).unwrap();
    let damaged = run.join("clips/b/robot.r4c");
    let bytes = std::fs::read(&damaged).unwrap();
    std::fs::write(&damaged, &bytes[..bytes.len() / 2]).unwrap();
    // A file of another clip at this place is whole but has another key.
    std::fs::copy(run.join("clips/a/clip.r4c"), run.join("clips/c/clip.r4c")).unwrap();
    let status = status::status(&run).unwrap();
    assert_eq!(status.clips.done, 0);
    let summary = workspace.run();
    assert_eq!((summary.exit, summary.units.made), (Exit::Done, 3), "{summary:?}");
    assert!(workspace.outputs() == before);
}

#[test]
fn verify_reads_every_byte() {
    let workspace = Workspace::new();
    workspace.run();
    let file = workspace.run_folder().join("clips/a/field-1.r4c");
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[100] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    let found = rogs_orchestrator::verify::verify(&workspace.run_folder()).unwrap();
    assert_eq!((found.good, found.bad.len(), found.exit()), (20, 1, Exit::Failed));
    assert_eq!(found.bad[0].output, std::path::Path::new("clips/a/field-1.r4c"));
}

#[test]
fn variants_share_what_they_have_in_common() {
    let workspace = Workspace::new();
    workspace.manifest("[[variants]]\nname = \"no-anchor\"\nlift.no_anchor = true\n\n[[variants]]\nname = \"same\"\n");
    let prepared = workspace.prepare();
    let labels: Vec<&str> = prepared.plan.nodes.iter().map(|node| node.label.as_str()).collect();
    let main = [
        "ingest",
        "robot-maps",
        "conditioning",
        "lift",
        "refine",
        "score-1",
        "score-2",
    ];
    let variant = [
        "lift@no-anchor",
        "refine@no-anchor",
        "score-1@no-anchor",
        "score-2@no-anchor",
        // The field is shared; its scores are rows of their own in the tables.
        "score-1@same",
        "score-2@same",
    ];
    assert_eq!(labels, [&main[..], &variant[..]].concat());
    assert_eq!(prepared.plan.nodes[0].variants, [0, 1, 2]);
    assert_eq!(prepared.plan.nodes[3].variants, [0, 2]);
    let summary = prepared.run().unwrap();
    assert_eq!((summary.exit, summary.units.made), (Exit::Done, 39));
    // Adding a variant to a finished run makes only what is new.
    workspace.manifest(
        "[[variants]]\nname = \"no-anchor\"\nlift.no_anchor = true\n[[variants]]\nname = \"seed-1\"\nlift.seed = 1\n",
    );
    assert_eq!(workspace.run().units.made, 12);
}

#[test]
fn explain_tells_old_and_new_and_the_chain_of_causes() {
    let workspace = Workspace::new();
    workspace.run();
    assert!(workspace.prepare().plan.explain_clip(0).is_empty());
    workspace.manifest("[conditioning]\nsigma_m = 0.25\n");
    let prepared = workspace.prepare();
    let lines: Vec<String> = prepared.plan.explain_clip(0).iter().map(ToString::to_string).collect();
    assert_eq!(lines.len(), 5, "{lines:?}");
    assert!(
        lines[0].starts_with("a conditioning: params.sigma_m 0.1") && lines[0].contains("→ 0.25"),
        "{}",
        lines[0]
    );
    assert!(
        lines[1].starts_with("a lift: input conditioning ") && lines[1].ends_with("(because of conditioning)"),
        "{}",
        lines[1]
    );
    workspace.episode("a", "another");
    let lines: Vec<String> = workspace
        .prepare()
        .plan
        .explain_clip(0)
        .iter()
        .map(ToString::to_string)
        .collect();
    assert!(lines[0].starts_with("a ingest: input episode "), "{}", lines[0]);
    assert_eq!(workspace.prepare().run().unwrap().units.made, 7 + 5 + 5);
}

#[test]
fn a_plan_is_deterministic_and_reads_back() {
    let workspace = Workspace::new();
    workspace.manifest("[ingest]\nfaster = 0.1\n[[variants]]\nname = \"v\"\nlift.seed = 3\n");
    let (one, two) = (workspace.prepare(), workspace.prepare());
    assert_eq!(one.plan, two.plan);
    one.plan.freeze().unwrap();
    let first = std::fs::read(workspace.run_folder().join("plan.jsonl")).unwrap();
    two.plan.freeze().unwrap();
    assert_eq!(first, std::fs::read(workspace.run_folder().join("plan.jsonl")).unwrap());
    let read = rogs_orchestrator::plan::read_plan(&workspace.run_folder()).unwrap();
    assert_eq!(read, one.plan);
    // Numbers are as the stage holds them (0.1 as f32), so that worker and plan agree.
    assert_eq!(workspace.run().exit, Exit::Done);
}

#[test]
fn two_orchestrators_do_not_work_in_one_folder() {
    let workspace = Workspace::new();
    let prepared = workspace.prepare();
    let lock = rogs_orchestrator::lock::RunLock::acquire(&workspace.run_folder()).unwrap();
    let error = prepared.run().unwrap_err();
    assert_eq!(error.exit(), Exit::Locked);
    assert!(error.to_string().contains("is in use by process"), "{error}");
    drop(lock);
    assert_eq!(prepared.run().unwrap().exit, Exit::Done);
}

#[test]
fn an_estimate_follows_from_earlier_attempts() {
    let workspace = Workspace::new();
    let prepared = workspace.prepare();
    let before = rogs_orchestrator::estimate::estimate(&prepared.plan, &prepared.options).unwrap();
    assert_eq!((before.seconds, before.nodes[0].todo), (None, 3));
    prepared.run().unwrap();
    let idle = rogs_orchestrator::estimate::estimate(&prepared.plan, &prepared.options).unwrap();
    assert!(idle.table().contains("\nabout 0.0 s with "), "{}", idle.table());
    workspace.episode("d", "four");
    let prepared = workspace.prepare();
    let after = rogs_orchestrator::estimate::estimate(&prepared.plan, &prepared.options).unwrap();
    assert!(
        after.seconds.unwrap() > 0.0 && after.disk_bytes.unwrap() > 1000,
        "{after:?}"
    );
    assert_eq!((after.nodes[0].todo, after.nodes[0].up_to_date), (1, 3));
    assert!(after.table().contains("ingest"), "{}", after.table());
}
