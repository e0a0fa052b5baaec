//! The edge cases of `docs/spec/scoring.md` section 12, one test each.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "support/made_up.rs"]
mod made_up;

use rogs_random::{query_plan, query_plan_from_words};
use rogs_schemas::FrameIndex;
use rogs_schemas::records::scores::{ImageScore, RobotDepthScore, ScoreSheet, TrackScore};
use rogs_score::metrics::{Pixels, RgbView, SsimVariant, bootstrap_interval, depth_scores, depth_support, psnr, ssim};
use rogs_score::summary::{ImageMetric, Metric, SheetSet, clip_value};
use rogs_score::tables::{Cell, MissingScores, TableId, TableInput, TableOptions, table};

const RANGE_M: [f32; 2] = [0.1, 5.0];

fn sheet(method: &str, clip: &str) -> ScoreSheet {
    made_up::empty_sheet(method, "recorded", clip)
}

fn image(frame: u32, psnr: Option<f64>) -> ImageScore {
    ImageScore {
        camera: "ext1_right".into(),
        source_view: false,
        frame: FrameIndex(frame),
        psnr,
        ssim: None,
        lpips: None,
        absrel: None,
        rmse_m: None,
        delta1: None,
        absrel_scaled: None,
        far_absrel: None,
        support_n: 0,
    }
}

#[test]
fn identical_images() {
    let bytes: Vec<u8> = (0..24 * 32 * 3).map(|k| (k * 7 % 256) as u8).collect();
    let view = RgbView::new(24, 32, Pixels::Bytes(&bytes)).unwrap();
    assert_eq!(psnr(&view, &view).unwrap(), 100.0);
    for variant in [
        SsimVariant::SkimageSampleCov,
        SsimVariant::Skimage,
        SsimVariant::Torchmetrics,
    ] {
        assert!((ssim(&view, &view, variant).unwrap() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn a_prediction_with_nan_pixels() {
    let reference = vec![0.5f32; 24 * 32 * 3];
    let mut own = reference.clone();
    own[..3].fill(f32::NAN);
    let view = |values| RgbView::new(24, 32, Pixels::Unit(values)).unwrap();
    // One black pixel of 768 is off by a half.
    let expected = -10.0 * (0.25f64 / 768.0).log10();
    assert!((psnr(&view(&own), &view(&reference)).unwrap() - expected).abs() < 1e-9);
    assert!(
        ssim(&view(&own), &view(&reference), SsimVariant::SkimageSampleCov)
            .unwrap()
            .is_finite()
    );
    let depth = depth_scores(&[f32::NAN, f32::INFINITY, 2.0], &[2.0; 3], &[true; 3], 1.0).unwrap();
    assert!((depth.absrel - 2.0 / 3.0).abs() < 1e-12, "not a number counts as 0");
}

#[test]
fn all_zero_depth() {
    let scores = depth_scores(&[0.0; 4], &[1.0, 2.0, 3.0, 4.0], &[true; 4], 1.0).unwrap();
    assert_eq!((scores.absrel, scores.delta1, scores.count), (1.0, 0.0, 4));
}

#[test]
fn support_of_zero_pixels() {
    assert!(depth_scores(&[1.0], &[1.0], &[false], 1.0).is_none());
}

#[test]
fn references_at_the_ends_of_the_range_are_left_out() {
    let reference = [0.1, 0.100_001, 4.999_999, 5.0, f32::NAN, 0.0, f32::INFINITY];
    assert_eq!(
        depth_support(&reference, RANGE_M),
        [false, true, true, false, false, false, false]
    );
}

#[test]
fn delta1_does_not_count_its_bounds() {
    // 1.25 and its quotient are exact here.
    let scores = depth_scores(&[0.8 * 1.25, 1.25 * 1.25, 1.2], &[1.25, 1.25, 1.25], &[true; 3], 1.0).unwrap();
    assert!((scores.delta1 - 1.0 / 3.0).abs() < 1e-12, "{scores:?}");
}

#[test]
fn a_clip_with_a_single_distinct_time() {
    let mut own = sheet("stage1", "a");
    own.images = vec![image(0, Some(17.0))];
    // The anchor is that time: no displacement remains, and the mean over nothing is NaN.
    assert_eq!(clip_value(&own, Metric::Novel(ImageMetric::Psnr)), Some(17.0));
    assert_eq!(clip_value(&own, Metric::RobotEpe), None);
    let plan = query_plan("one", 1, &[0]);
    assert_eq!(plan.distinct, [0]);
}

#[test]
fn a_clip_without_tracks_is_left_out_of_the_displacement_mean_and_counted() {
    let mut with = sheet("stage1", "a");
    let track = |epe_mm| TrackScore {
        anchor: FrameIndex(0),
        frame: FrameIndex(4),
        epe_mm,
        n_tracks: u64::from(epe_mm.is_some()),
    };
    with.tracks = vec![track(Some(8.0)), track(None)];
    with.images = vec![image(0, Some(17.0))];
    with.robot_depth = vec![RobotDepthScore {
        frame: FrameIndex(0),
        robot_depth_mm: None,
        core_n: 0,
    }];
    let mut without = sheet("stage1", "b");
    without.images = vec![image(0, Some(19.0))];
    without.tracks = vec![track(None)];
    let sheets = [with, without];
    let input = TableInput {
        sheets: &sheets,
        ..TableInput::default()
    };
    let main = table(TableId::Main, &input, TableOptions::default()).unwrap();
    let row = main.rows.iter().find(|row| row.method == "stage1").unwrap();
    assert_eq!(row.clips, 2);
    let Cell::Mean { value, clips, .. } = row.cells[6] else {
        panic!("a mean: {:?}", row.cells)
    };
    assert_eq!((value, clips), (8.0, 1));
}

#[test]
fn a_method_with_missing_clips_says_how_many_it_has() {
    let mut sheets = Vec::new();
    for (method, clips) in [("stage1", ["a", "b", "c"].as_slice()), ("som", &["a", "c"])] {
        sheets.extend(clips.iter().map(|clip| {
            let mut own = sheet(method, clip);
            own.images = vec![image(0, Some(20.0))];
            own
        }));
    }
    let set = SheetSet::new(&sheets).unwrap();
    let among = set.clips("recorded", None);
    assert_eq!(
        set.values("recorded", "som", Metric::Novel(ImageMetric::Psnr), &among)
            .len(),
        2
    );
    let input = TableInput {
        sheets: &sheets,
        ..TableInput::default()
    };
    let main = table(TableId::Main, &input, TableOptions::default()).unwrap();
    assert!(
        main.footnotes.iter().any(|note| note.contains("3 clips, except SoM 2")),
        "{:?}",
        main.footnotes
    );
}

#[test]
fn a_method_says_why_it_lacks_clips_even_where_it_lacks_all() {
    let mut sheets = Vec::new();
    for (method, clips) in [("stage1", ["a", "b", "c"].as_slice()), ("movies", &["a"])] {
        sheets.extend(clips.iter().map(|clip| sheet(method, clip)));
    }
    let missing = |method: &str, clip: &str, reason: &str| MissingScores {
        setting: "recorded".into(),
        method: method.into(),
        clip: clip.into(),
        reason: reason.into(),
    };
    let missing = [
        missing("movies", "b", "no stereo depth"),
        missing("movies", "c", "no stereo depth"),
        missing("4dgt", "a", "out of memory"),
        missing("mine", "a", "nothing there"),
    ];
    let input = TableInput {
        sheets: &sheets,
        missing: &missing,
        ..TableInput::default()
    };
    let options = TableOptions {
        hide_empty_rows: true,
        ..TableOptions::default()
    };
    let main = table(TableId::Main, &input, options).unwrap();
    let rows: Vec<_> = main.rows.iter().map(|row| (row.label.as_str(), row.clips)).collect();
    assert_eq!(rows, [("MoVieS", 1), ("4DGT", 0), ("Ours (Stage 1)", 3), ("mine", 0)]);
    for expected in [
        "Recorded observations, MoVieS: 1 of 3 clips; 2 clips such as b: no stereo depth",
        "Recorded observations, 4DGT: 0 of 1 clips; a: out of memory",
    ] {
        assert!(
            main.footnotes.iter().any(|note| note == expected),
            "{:?}",
            main.footnotes
        );
    }
}

#[test]
fn a_bootstrap_of_one_clip_has_no_width() {
    let interval = bootstrap_interval(&[3.25]).unwrap();
    assert_eq!((interval.low, interval.high), (3.25, 3.25));
    assert!(bootstrap_interval(&[]).is_none());
}

#[test]
fn duplicate_requests_are_evaluated_once() {
    let repeated = (0..200u32)
        .map(|word| query_plan_from_words([word, 1], 17, &[0, 4, 8, 12, 16]))
        .find(|plan| plan.distinct.len() < plan.requests.len())
        .expect("a quarter of the plans include the sources");
    let mut distinct = repeated.requests.clone();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(repeated.distinct, distinct);
}

#[test]
fn a_seed_word_of_zero_takes_part() {
    let plan = |words| query_plan_from_words(words, 17, &[0, 4, 8, 12, 16]).requests;
    let plans = [plan([0, 0]), plan([0, 5]), plan([5, 0])];
    assert!(plans[0] != plans[1] && plans[1] != plans[2] && plans[0] != plans[2]);
}
