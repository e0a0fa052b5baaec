//! Aggregation against golden values, and every table from a made-up run with all variants. The tests of `rogs-report`
//! print them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "support/made_up.rs"]
mod made_up;

use rogs_schemas::FrameIndex;
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::scores::{ScoreSheet, TrackScore};
use rogs_score::metrics::bootstrap_interval;
use rogs_score::summary::{ImageMetric, Metric, SheetSet, clip_value, summarise};
use rogs_score::tables::{Cell, Column, Table, TableError, TableId, TableInput, TableOptions, table};
use rogs_score::timing::ClipTiming;
use serde_json::Value;

use made_up::{CLIPS, COHORT, empty_sheet, image, run};

#[test]
fn aggregation_agrees_with_the_golden_clips() {
    let golden: Value = serde_json::from_str(include_str!("golden/aggregation.json")).unwrap();
    let sheets: Vec<ScoreSheet> = golden["clips"].as_array().unwrap().iter().map(golden_sheet).collect();
    let mut worst = 0.0f64;
    let mut close = |found: Option<f64>, expected: &Value| match (found, expected.as_f64()) {
        (Some(found), Some(expected)) => worst = worst.max((found - expected).abs()),
        (found, expected) => assert_eq!(found, expected),
    };
    let set = SheetSet::new(&sheets).unwrap();
    let among = set.clips("recorded", None);
    for (metric, per_clip, mean) in [
        (Metric::Novel(ImageMetric::Psnr), "per_clip_psnr", "mean_psnr"),
        (Metric::RobotEpe, "per_clip_epe", "mean_epe"),
    ] {
        for (sheet, expected) in sheets.iter().zip(golden[per_clip].as_array().unwrap()) {
            close(clip_value(sheet, metric), expected);
        }
        let values: Vec<f64> = set.values("recorded", "m", metric, &among).into_values().collect();
        let summary = summarise(&values).unwrap();
        close(Some(summary.mean), &golden[mean]);
        let clips = if metric == Metric::RobotEpe {
            golden["epe_clips"].as_u64().unwrap()
        } else {
            5
        };
        assert_eq!(summary.clips as u64, clips);
    }
    println!("aggregation: worst absolute error {worst:.3e}");
    assert!(worst < 1e-12);
}

fn golden_sheet(clip: &Value) -> ScoreSheet {
    let mut sheet = empty_sheet("m", "recorded", clip["id"].as_str().unwrap());
    for (time, values) in clip["psnr"].as_object().unwrap() {
        let frame: u32 = time.parse().unwrap();
        sheet.images.extend(
            values
                .as_array()
                .unwrap()
                .iter()
                .map(|v| image(false, frame, v.as_f64().unwrap())),
        );
        let epe_mm = clip["robot_epe_mm"][time].as_f64();
        sheet.tracks.push(TrackScore {
            anchor: FrameIndex(0),
            frame: FrameIndex(frame),
            epe_mm,
            n_tracks: u64::from(epe_mm.is_some()),
        });
    }
    sheet
}

fn make(id: TableId, sheets: &[ScoreSheet], timings: &[ClipTiming], options: TableOptions) -> Table {
    table(
        id,
        &TableInput {
            sheets,
            timings,
            cohort: Some(&COHORT),
            ..TableInput::default()
        },
        options,
    )
    .unwrap()
}

#[test]
fn every_table_is_filled_and_without_scores_empty() {
    let (sheets, timings) = run();
    for id in TableId::ALL {
        assert_eq!(id.name().parse::<TableId>().unwrap(), id);
        let options = TableOptions {
            published: true,
            ..TableOptions::default()
        };
        let full = make(id, &sheets, &timings, options);
        // That table is of agreements, not of scores: `tests/agreement.rs` fills it.
        assert!(!full.rows.is_empty() || id == TableId::Following, "{id}");
        for row in &full.rows {
            assert_eq!(row.cells.len(), full.columns.len(), "{id} {}", row.label);
            assert!(
                row.published.is_empty() || row.published.len() == full.columns.len(),
                "{id} {}",
                row.label
            );
            for (cell, column) in row.cells.iter().zip(&full.columns) {
                assert!(
                    *cell != Cell::Missing || column.name.contains("LPIPS") || may_lack(id, column.name),
                    "{id} {}",
                    column.name
                );
            }
        }
        let empty = table(id, &TableInput::default(), TableOptions::default()).unwrap();
        for cell in empty.rows.iter().flat_map(|row| &row.cells) {
            assert!(matches!(cell, Cell::Missing | Cell::Text(_)), "{id}: {cell:?}");
        }
    }
}

/// Columns that the made-up run rightly leaves empty.
fn may_lack(id: TableId, column: &str) -> bool {
    id == TableId::Timing || (id == TableId::Recurrence && column == "refinement (s)")
}

#[test]
fn means_coverage_and_footnotes_of_the_main_table() {
    let (sheets, timings) = run();
    let main = make(TableId::Main, &sheets, &timings, TableOptions::default());
    let row = |method: &str| main.rows.iter().find(|row| row.method == method).unwrap();
    let own: Vec<f64> = sheets
        .iter()
        .filter(|sheet| sheet.method == "stage1+2" && sheet.setting == "recorded")
        .map(|sheet| (sheet.images[0].psnr.unwrap() + sheet.images[1].psnr.unwrap()) / 2.0)
        .collect();
    let expected = own.iter().sum::<f64>() / own.len() as f64;
    let Cell::Mean { value, clips, .. } = row("stage1+2").cells[0] else {
        panic!("a mean")
    };
    assert!((value - expected).abs() < 1e-12 && clips == CLIPS);
    assert_eq!(row("som").clips, CLIPS - 3);
    let Cell::Mean { clips, .. } = row("stage1").cells[6] else {
        panic!("a mean")
    };
    assert_eq!(clips, CLIPS - 1, "the clip without tracks is left out of the mean");
    let notes = [
        "Recorded observations: 40 clips, except SoM 37",
        "World-model rollouts: 40 clips, except SoM 37",
        "LPIPS: no LPIPS weights were given",
        "depth references: FoundationStereo cache (n=30), classical stereo (n=10)",
        "track references: point tracker (n=30), kinematics (n=10)",
        "memory is the peak resident memory of the process (CPU), not device memory",
    ];
    assert_eq!(main.footnotes, notes);
    let Cell::Mean { value, clips, .. } = row("stage1+2").cells[7] else {
        panic!("a time")
    };
    assert_eq!((value, clips), (3.75, CLIPS - 1), "without the warm-up clip");
    let json = serde_json::to_value(&main).unwrap();
    assert_eq!(json["rows"][0]["cells"][1], "missing");
}

#[test]
fn fields_that_are_not_finite_are_said_below_the_table() {
    let (mut sheets, timings) = run();
    let of_som = sheets.iter_mut().filter(|sheet| sheet.method == "som");
    for (sheet, count) in of_som.zip([0, 7, 900]) {
        sheet.invalid_gaussians = count;
    }
    let main = make(TableId::Main, &sheets, &timings, TableOptions::default());
    let note = main
        .footnotes
        .iter()
        .find(|note| note.starts_with("NOT FINITE"))
        .unwrap();
    assert_eq!(
        note,
        &format!(
            "NOT FINITE: SoM (up to 900 of a clip, in 2 of {} clips); such Gaussians are scored as if they were not there",
            2 * (CLIPS - 3)
        )
    );
}

#[test]
fn intervals_are_those_of_the_bootstrap() {
    let (sheets, _) = run();
    let ci = make(TableId::Ci, &sheets, &[], TableOptions::default());
    let row = ci.rows.iter().find(|row| row.method == "som").unwrap();
    let set = SheetSet::new(&sheets).unwrap();
    let among = set.clips("recorded", None);
    let values: Vec<f64> = set
        .values("recorded", "som", Metric::Novel(ImageMetric::Psnr), &among)
        .into_values()
        .collect();
    let expected = bootstrap_interval(&values).unwrap();
    let Cell::Mean {
        interval: Some(interval),
        ..
    } = row.cells[0]
    else {
        panic!("an interval")
    };
    assert_eq!(interval, [expected.low, expected.high]);
}

#[test]
fn differences_are_paired_and_subsets_are_the_first_clips() {
    let (mut sheets, _) = run();
    sheets.retain(|sheet| sheet.method != "stage1" || sheet.clip_id != "clip_000");
    let difference = make(TableId::FkTransport, &sheets, &[], TableOptions::default());
    let row = &difference.rows[0];
    let Cell::Mean { value, clips, .. } = row.cells[0] else {
        panic!("a mean")
    };
    assert_eq!((row.clips, clips), (CLIPS - 1, CLIPS - 1));
    let of = |method: &str, clip: &str| {
        let own = |sheet: &&ScoreSheet| sheet.method == method && sheet.clip_id == clip && sheet.setting == "recorded";
        clip_value(sheets.iter().find(own).unwrap(), Metric::Novel(ImageMetric::Psnr)).unwrap()
    };
    let names: Vec<String> = (1..CLIPS).map(|clip| format!("clip_{clip:03}")).collect();
    let expected: f64 = names
        .iter()
        .map(|clip| of("stage1/analytic-fk", clip) - of("stage1", clip))
        .sum();
    assert!((value - expected / names.len() as f64).abs() < 1e-12);
    assert!(difference.columns.iter().all(|column| column.signed));
    let recurrence = make(TableId::Recurrence, &sheets, &[], TableOptions::default());
    assert!(recurrence.rows.iter().all(|row| row.clips == 32));
    let resolution = make(TableId::LatentResolution, &sheets, &[], TableOptions::default());
    assert_eq!(
        resolution.rows.iter().map(|row| row.clips).collect::<Vec<_>>(),
        [15, 16, 16]
    );
}

#[test]
fn duplicates_are_refused_and_unknown_methods_shown() {
    let sheets = vec![
        empty_sheet("mine", "recorded", "a"),
        empty_sheet("mine", "recorded", "a"),
    ];
    let result = table(
        TableId::Main,
        &TableInput {
            sheets: &sheets,
            ..TableInput::default()
        },
        TableOptions::default(),
    );
    assert!(matches!(result, Err(TableError::Duplicate(_))));
    let mut one = empty_sheet("mine", "recorded", "a");
    one.weights = vec![WeightsInfo {
        trained: false,
        configuration: String::new(),
        description: String::new(),
        hash: String::new(),
    }];
    let options = TableOptions {
        hide_empty_rows: true,
        ..TableOptions::default()
    };
    let main = make(TableId::Main, &[one], &[], options);
    assert_eq!(
        main.rows.iter().map(|row| row.label.as_str()).collect::<Vec<_>>(),
        ["mine (seeded weights)"]
    );
    assert!(
        main.footnotes
            .iter()
            .any(|note| note.contains("UNTRAINED WEIGHTS: mine"))
    );
    assert!(
        "nonsense"
            .parse::<TableId>()
            .unwrap_err()
            .to_string()
            .contains("fk_transport")
    );
}

/// Nobody can take one reference for another: every table with depth or displacement errors names what made them.
#[test]
fn tables_name_the_origin_of_every_reference() {
    let (mut sheets, _) = run();
    let made = |id: TableId, sheets: &[ScoreSheet]| {
        let input = TableInput {
            sheets,
            ..TableInput::default()
        };
        table(id, &input, TableOptions::default()).unwrap()
    };
    let depth = "depth references: FoundationStereo cache (n=30), classical stereo (n=10)".to_owned();
    let tracks = "track references: point tracker (n=30), kinematics (n=10)".to_owned();
    for id in TableId::ALL {
        let table = made(id, &sheets);
        let has = |words: &[&str]| {
            let named = |column: &Column| words.iter().any(|word| column.name.contains(word));
            table.columns.iter().any(named)
        };
        let expected = [
            (&depth, has(&["AbsRel", "RMSE", "delta1", "robot depth"])),
            (&tracks, has(&["EPE"])),
        ];
        for (note, shown) in expected {
            assert_eq!(table.footnotes.contains(note), shown, "{id}: {:?}", table.footnotes);
        }
    }
    sheets.iter_mut().for_each(|sheet| sheet.references.clear());
    let notes = made(TableId::Main, &sheets).footnotes;
    let unstated = "depth references: origin not stated (n=40)".to_owned();
    assert!(notes.contains(&unstated), "{notes:?}");
}
