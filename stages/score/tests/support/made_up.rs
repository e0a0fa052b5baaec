//! A made-up run with all variants of the paper: forty clips, both settings; SoM failed on three clips, one clip has no tracks.

#![allow(dead_code)] // Every test program uses a part.

use rogs_random::Pcg64;
use rogs_schemas::FrameIndex;
use rogs_schemas::records::origin::{ReferenceKind, ReferenceOrigin, ReferenceUse};
use rogs_schemas::records::scores::{CrossViewScore, ImageScore, RobotDepthScore, ScoreSheet, TrackScore};
use rogs_score::cohort::CohortCounts;
use rogs_score::timing::ClipTiming;

/// A sheet without scores.
pub(crate) fn empty_sheet(method: &str, setting: &str, clip: &str) -> ScoreSheet {
    ScoreSheet {
        clip_id: clip.parse().unwrap(),
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
        references: Vec::new(),
        cross_view: Vec::new(),
    }
}

/// Scores of an image that follow from its PSNR.
pub(crate) fn image(source_view: bool, frame: u32, psnr: f64) -> ImageScore {
    ImageScore {
        camera: if source_view { "wrist" } else { "wrist_right" }.into(),
        source_view,
        frame: FrameIndex(frame),
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
/// Clips of a setting.
pub(crate) const CLIPS: usize = 40;

/// Sheets and times of the run.
pub(crate) fn run() -> (Vec<ScoreSheet>, Vec<ClipTiming>) {
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
                    anchor: FrameIndex(0),
                    frame: FrameIndex(3),
                    epe_mm,
                    n_tracks: 4 * u64::from(epe_mm.is_some()),
                }];
                let robot_depth_mm = Some(13.0 + rng.next_double());
                sheet.robot_depth = vec![RobotDepthScore {
                    frame: FrameIndex(3),
                    robot_depth_mm,
                    core_n: 50,
                }];
                sheet.references = references(clip);
                let against = |camera: &str, psnr: Option<f64>, shown| CrossViewScore {
                    camera: camera.into(),
                    frame: FrameIndex(3),
                    psnr,
                    shown,
                };
                if method.starts_with("stage1") {
                    sheet.cross_view = vec![against("ext1", Some(level - 1.0), 0.5), against("wrist", None, 0.0)];
                }
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

/// Every fourth clip has the references that the pipeline makes, the others those of caches.
fn references(clip: usize) -> Vec<ReferenceUse> {
    let (depth, tracks) = if clip.is_multiple_of(4) {
        (ReferenceOrigin::ClassicalStereo, ReferenceOrigin::Kinematics)
    } else {
        (ReferenceOrigin::FoundationStereo, ReferenceOrigin::PointTracker)
    };
    let used = |kind, camera: &str, origin| ReferenceUse {
        kind,
        camera: camera.to_owned(),
        origin,
    };
    vec![
        used(ReferenceKind::Depth, "wrist", depth),
        used(ReferenceKind::Depth, "wrist_right", depth),
        used(ReferenceKind::Tracks, "", tracks),
    ]
}

/// Counts of a cohort.
pub(crate) const COHORT: CohortCounts = CohortCounts {
    reserved: 1026,
    cached: 804,
    candidates: 498,
    eligible: 498,
    selected: 256,
};
