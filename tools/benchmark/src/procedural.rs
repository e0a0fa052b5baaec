//! Procedural clips that training never saw.

use rogs_score::summary::{ImageMetric, Metric, clip_value};

use crate::run::ScoredClip;
use crate::table::{Cell, Table};

/// Seed of the first clip; 9000000 to 9999999 are for this benchmark.
pub(crate) const FIRST_SEED: u64 = 9_000_000;
/// Clips.
pub(crate) const CLIPS: u32 = 64;

/// Scores of both stages.
pub(crate) fn table(clips: &[ScoredClip]) -> Table {
    let metrics = [
        ("source PSNR, dB", Metric::Source(ImageMetric::Psnr), 2),
        ("novel PSNR, dB", Metric::Novel(ImageMetric::Psnr), 2),
        ("source AbsRel", Metric::Source(ImageMetric::AbsRel), 3),
        ("novel AbsRel", Metric::Novel(ImageMetric::AbsRel), 3),
        ("robot EPE, mm", Metric::RobotEpe, 2),
        ("robot depth, mm", Metric::RobotDepth, 1),
    ];
    let mut table = Table::new("method", &metrics.map(|(name, ..)| name));
    for method in ["stage1", "stage1+2"] {
        let cell = |(_, metric, digits): (&str, Metric, usize)| {
            let scores = clips.iter().filter_map(|clip| clip.of(method));
            let values: Vec<f64> = scores
                .filter_map(|scores| clip_value(&scores.summary, metric))
                .collect();
            Cell::over_clips(&values, digits)
        };
        table.row(method, metrics.map(cell));
    }
    table
}
