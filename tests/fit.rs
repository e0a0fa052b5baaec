//! A run with `[fit]`: the fitted field is a file of its own and a row of the tables, and it keeps the robot's motion.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

#[path = "support/golden.rs"]
mod golden;

use std::process::Command;

use golden::GoldenRun;
use rogs_r4c::read_record;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::scores::Scores;

#[test]
fn a_fit_is_made_and_scored_where_the_manifest_asks_for_it() {
    let run = GoldenRun::new();
    let plan = |run: &GoldenRun| run.rogs(&["plan", "manifest.toml", "--explain"]);
    assert!(!plan(&run).contains("fit"), "it runs only where it is asked for");
    let path = run.path().join("manifest.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, format!("{text}\n[fit]\nupdates = 8\n")).unwrap();
    run.rogs(&["run", "manifest.toml", "--no-report"]);
    let read = |file: &str| read_record::<Scores>(&run.clip_folder().join(file)).unwrap().0;
    let (refined, fitted) = (read("scores-2.r4c"), read("scores-fit.r4c"));
    assert_eq!(fitted.summary.method, "fit");
    assert_eq!(fitted.summary.images.len(), refined.summary.images.len());
    let field = |file: &str| read_record::<Field>(&run.clip_folder().join(file)).unwrap().0;
    let (lifted, made) = (field("field-1.r4c"), field("field-fit.r4c"));
    for (before, after) in lifted.slices.iter().zip(&made.slices) {
        for index in (0..lifted.len()).filter(|&index| lifted.support[index] != 0) {
            let bits = |values: &[f32]| [0, 1, 2].map(|axis| values[3 * index + axis].to_bits());
            assert_eq!(bits(&before.displacement_m), bits(&after.displacement_m));
        }
    }
    let table = run.rogs(&["table", "run", "--table", "main"]);
    assert!(table.lines().any(|line| line.starts_with("fit")), "{table}");
    assert!(!plan(&run).contains("will"), "everything is up to date");

    // The report plays the fit beside the stages, and its bars come in the order in which the methods are made.
    run.rogs(&["report", "run"]);
    let page = std::fs::read_to_string(run.path().join("run/report/index.html")).unwrap();
    for (number, name) in [(1, "Stage 1"), (2, "Stage 1+2"), (3, "Fit")] {
        let script = format!("scenes/0001-{number}.js");
        assert!(
            page.contains(&format!(
                "{{&quot;name&quot;:&quot;{name}&quot;,&quot;script&quot;:&quot;{script}&quot;}}"
            )),
            "{name}"
        );
        assert!(run.path().join("run/report").join(script).is_file(), "{name}");
    }
    let bars = &page[page.find("Methods: source PSNR").unwrap()..];
    let at = |method: &str| bars.find(&format!(">{method}<")).unwrap();
    assert!(at("stage1") < at("stage1+2") && at("stage1+2") < at("fit"));

    // Corrections of the lifted field are not those of the fitted one, though both have as many Gaussians.
    let folder = run.clip_folder();
    let render = |field: &str| {
        let mut command = Command::new(golden::ROGS);
        command
            .arg("render")
            .arg(folder.join(field))
            .arg("--refinement")
            .arg(folder.join("field-2.r4c"));
        command
            .args(["--camera", "ext1", "--time", "0", "--out"])
            .arg(folder.join("pictures"));
        command.output().unwrap()
    };
    assert!(render("field-1.r4c").status.success());
    let refused = render("field-fit.r4c");
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        !refused.status.success() && said.contains("holds corrections of field"),
        "{said}"
    );
}
