//! Aggregation against golden values, and every table from a made-up run with all variants
//! (`cargo test -p rogs-score --test tables -- --nocapture` prints them).

use rogs_random::Pcg64;
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::scores::{ImageScore, RobotDepthScore, ScoreSheet, TrackScore};
use rogs_score::cohort::CohortCounts;
use rogs_score::metrics::bootstrap_interval;
use rogs_score::summary::{ImageMetric, Metric, SheetSet, clip_value, summarise};
use rogs_score::tables::{
    Cell, Table, TableError, TableId, TableInput, TableOptions, table, to_csv, to_latex, to_text,
};
use rogs_score::timing::ClipTiming;
use serde_json::Value;

fn empty_sheet(method: &str, setting: &str, clip: &str) -> ScoreSheet {
    ScoreSheet {
        clip_id: clip.into(),
        method: method.into(),
        setting: setting.into(),
        ssim_variant: "skimage-sample-cov".into(),
        lpips_note: Some("no LPIPS weights were given".into()),
        weights: vec![],
        images: vec![],
        tracks: vec![],
        robot_depth: vec![],
        n_empty_support: 0,
        invalid_gaussians: 0,
    }
}

fn image(source_view: bool, frame: u32, psnr: f64) -> ImageScore {
    ImageScore {
        camera: if source_view { "wrist" } else { "wrist_right" }.into(),
        source_view,
        frame,
        psnr: Some(psnr),
        ssim: Some(psnr / 30.0),
        lpips: None,
        absrel: Some(2.0 / psnr),
        rmse_m: Some(4.0 / psnr),
        delta1: Some(psnr / 30.0),
        absrel_scaled: Some(3.0 / psnr),
        far_absrel: Some(1.0 / psnr),
        support_n: 100,
    }
}

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
            anchor: 0,
            frame,
            epe_mm,
            n_tracks: u64::from(epe_mm.is_some()),
        });
    }
    sheet
}

const VARIANTS: [&str; 24] = [
    "movies",
    "4dgt",
    "4dgt/5-frames",
    "som",
    "stage1",
    "stage1/no-cross-camera",
    "stage1/no-fk",
    "stage1/no-mesh",
    "stage1/no-mesh/no-fk",
    "stage1/analytic-fk",
    "stage1/down8",
    "stage1/latent",
    "stage1+2",
    "stage1+2/no-cross-camera",
    "stage1+2/no-fk",
    "stage1+2/no-mesh",
    "stage1+2/no-mesh/no-fk",
    "stage1+2/analytic-fk",
    "stage1+2/latent",
    "stage1+2/r0",
    "stage1+2/r1",
    "stage1+2/r2",
    "stage1+2/r3",
    "stage1+2/r4",
];
const CLIPS: usize = 40;

/// Forty clips, both settings, all variants; SoM failed on three clips, one clip has no tracks.
fn run() -> (Vec<ScoreSheet>, Vec<ClipTiming>) {
    let mut rng = Pcg64::from_seed(7);
    let (mut sheets, mut timings) = (Vec::new(), Vec::new());
    for setting in ["recorded", "rollout"] {
        for (index, method) in VARIANTS.iter().enumerate() {
            for clip in 0..CLIPS {
                if *method == "som" && clip % 13 == 5 {
                    continue;
                }
                let mut sheet = empty_sheet(method, setting, &format!("clip_{clip:03}"));
                let level = 12.0 + 0.4 * index as f64 + rng.next_double();
                sheet.images = vec![
                    image(true, 0, level + 5.0),
                    image(true, 3, level + 4.0),
                    image(false, 3, level),
                ];
                let epe_mm = (clip != 11).then(|| 8.0 + rng.next_double());
                sheet.tracks = vec![TrackScore {
                    anchor: 0,
                    frame: 3,
                    epe_mm,
                    n_tracks: 4 * u64::from(epe_mm.is_some()),
                }];
                let robot_depth_mm = Some(13.0 + rng.next_double());
                sheet.robot_depth = vec![RobotDepthScore {
                    frame: 3,
                    robot_depth_mm,
                    core_n: 50,
                }];
                sheets.push(sheet);
                timings.push(ClipTiming {
                    method: (*method).into(),
                    setting: setting.into(),
                    clip_id: format!("clip_{clip:03}"),
                    lift_s: Some(1.5),
                    refine_s: method.starts_with("stage1+2").then_some(2.0),
                    render_query_s: Some(0.25),
                    peak_rss_bytes: Some(3 << 30),
                    device: "test machine".into(),
                    threads: Some(2),
                    warmup: clip == 0,
                    ..ClipTiming::default()
                });
            }
        }
    }
    (sheets, timings)
}

fn make(id: TableId, sheets: &[ScoreSheet], timings: &[ClipTiming], options: TableOptions) -> Table {
    let cohort = CohortCounts {
        reserved: 1026,
        cached: 804,
        candidates: 498,
        eligible: 498,
        selected: 256,
    };
    table(
        id,
        &TableInput {
            sheets,
            timings,
            cohort: Some(&cohort),
        },
        options,
    )
    .unwrap()
}

#[test]
fn every_table_prints_in_every_format() {
    let (sheets, timings) = run();
    for id in TableId::ALL {
        assert_eq!(id.name().parse::<TableId>().unwrap(), id);
        let options = TableOptions {
            published: true,
            ..TableOptions::default()
        };
        let full = make(id, &sheets, &timings, options);
        assert!(!full.rows.is_empty(), "{id}");
        for row in &full.rows {
            assert_eq!(row.cells.len(), full.columns.len(), "{id} {}", row.label);
            assert!(
                row.published.is_empty() || row.published.len() == full.columns.len(),
                "{id} {}",
                row.label
            );
            let lpips = |name: &str| name.contains("LPIPS");
            for (cell, column) in row.cells.iter().zip(&full.columns) {
                assert!(
                    *cell != Cell::Missing || lpips(&column.name) || may_lack(id, &column.name),
                    "{id} {}",
                    column.name
                );
            }
        }
        println!("{}", to_text(&full));
        let json: Value = serde_json::from_str(&serde_json::to_string(&full).unwrap()).unwrap();
        assert_eq!(json["id"], id.name());
        let csv = to_csv(&full);
        assert_eq!(csv.lines().count(), full.rows.len() + 1);
        check_latex(&to_latex(&full), full.columns.len() + usize::from(full.counted), id);
        // Nothing at all still gives a table.
        let empty = table(id, &TableInput::default(), TableOptions::default()).unwrap();
        assert!(!to_text(&empty).contains("NaN") && !to_latex(&empty).is_empty() && !to_csv(&empty).is_empty());
        for cell in empty.rows.iter().flat_map(|row| &row.cells) {
            assert!(matches!(cell, Cell::Missing | Cell::Text(_)), "{id}: {cell:?}");
        }
        // The columns of a spreadsheet do not depend on what was asked for or found.
        let header = |table: &Table| to_csv(table).lines().next().unwrap().to_owned();
        let plain = make(id, &sheets, &timings, TableOptions::default());
        assert_eq!(header(&full), header(&plain));
        assert_eq!(header(&full), header(&empty));
        for line in csv.lines() {
            assert_eq!(csv_fields(line), 4 + 5 * full.columns.len(), "{id}: {line}");
        }
    }
}

/// Fields of a line with quoted ones.
fn csv_fields(line: &str) -> usize {
    let mut quoted = false;
    let commas = line.chars().filter(|&c| {
        quoted ^= c == '"';
        c == ',' && !quoted
    });
    1 + commas.count()
}

/// What a LaTeX run would stop at: unbalanced braces and environments, rows with another number of cells than columns,
/// specials that are not escaped, characters that need a package.
fn check_latex(latex: &str, columns: usize, id: TableId) {
    assert!(latex.is_ascii(), "{id}");
    let mut depth = 0;
    let mut before = ' ';
    for c in latex.chars() {
        depth += match c {
            '{' if before != '\\' => 1,
            '}' if before != '\\' => -1,
            _ => 0,
        };
        assert!(depth >= 0, "{id}");
        assert!(!matches!(c, '#' | '%' | '_') || before == '\\', "{id}: {before}{c}");
        before = c;
    }
    assert_eq!((depth, latex.matches('$').count() % 2), (0, 0), "{id}");
    let places: Vec<usize> = [
        "\\begin{table}",
        "\\begin{tabular}",
        "\\toprule",
        "\\midrule",
        "\\bottomrule",
        "\\end{tabular}",
        "\\end{table}",
    ]
    .iter()
    .map(|part| latex.find(part).unwrap_or_else(|| panic!("{id}: {part}")))
    .collect();
    assert!(places.is_sorted(), "{id}");
    let body = &latex[places[2] + "\\toprule".len()..places[4]];
    for row in body.lines().filter_map(|line| line.strip_suffix(" \\\\")) {
        let cells = row.replace("\\&", "").matches('&').count() + 1;
        assert!(cells == columns + 1 || row.starts_with("\\multicolumn"), "{id}: {row}");
        assert!(
            !row.starts_with('['),
            "{id}: an argument of the line break before: {row}"
        );
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
    let text = to_text(&main);
    assert!(
        text.contains("(n=39)") && text.contains("40 clips, except SoM 37"),
        "{text}"
    );
    assert!(
        text.contains("MoVieS, SoM: by the paper's protocol one scale factor")
            && text.contains("LPIPS: no LPIPS weights"),
        "{text}"
    );
    assert!(text.contains("peak resident memory"), "{text}");
    let Cell::Mean { value, clips, .. } = row("stage1+2").cells[7] else {
        panic!("a time")
    };
    assert_eq!((value, clips), (3.75, CLIPS - 1), "without the warm-up clip");
    let json = serde_json::to_value(&main).unwrap();
    assert_eq!(json["rows"][0]["cells"][1], "missing");
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
    assert!(to_text(&difference).contains('+'));
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
        ["mine"]
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
