//! A run that makes its own references: `[references]` in the manifest, and what tables and report say of them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

#[path = "support/golden.rs"]
mod golden;

use golden::GoldenRun;
use rogs_r4c::read_record;
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::scores::Scores;

/// Adds text to the manifest of a run.
fn extend(run: &GoldenRun, more: &str) {
    let path = run.path().join("manifest.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(path, format!("{text}\n{more}\n")).unwrap();
}

/// Whether the plan has a unit that makes references.
fn makes_references(run: &GoldenRun) -> bool {
    run.rogs(&["plan", "manifest.toml", "--explain"])
        .lines()
        .any(|line| line.contains(" references: "))
}

#[test]
fn references_are_made_where_the_manifest_asks_for_them() {
    let run = GoldenRun::new();
    assert!(!makes_references(&run));
    extend(
        &run,
        "[references]\ndepth = \"always\"\ntracks = \"always\"\nstereo = { speckle_px = 8 }\nrobot = { spacing_px = 2 }",
    );
    assert!(makes_references(&run));
    run.rogs(&["run", "manifest.toml"]);
    let (scores, _) = read_record::<Scores>(&run.clip_folder().join("scores-1.r4c")).unwrap();
    let origins: Vec<ReferenceOrigin> = scores.summary.references.iter().map(|used| used.origin).collect();
    let mut expected = vec![ReferenceOrigin::ClassicalStereo; 6];
    expected.push(ReferenceOrigin::Kinematics);
    assert_eq!(origins, expected);

    let table = run.rogs(&["table", "run", "--table", "main"]);
    assert!(table.contains("depth references: classical stereo (n=1)"), "{table}");
    assert!(table.contains("track references: kinematics (n=1)"), "{table}");
    let page = std::fs::read_to_string(run.path().join("run/report/index.html")).unwrap();
    assert!(
        page.contains("depth references: classical stereo"),
        "the report names the origins"
    );
}

#[test]
fn exact_references_are_named_in_tables_of_a_run_without() {
    let run = GoldenRun::new();
    run.rogs(&["run", "manifest.toml"]);
    let table = run.rogs(&["table", "run", "--table", "main"]);
    assert!(table.contains("depth references: exact (n=1)"), "{table}");
    assert!(table.contains("track references: exact (n=1)"), "{table}");
}
