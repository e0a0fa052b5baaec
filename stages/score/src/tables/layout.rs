//! Which rows and columns every measured table has.

use crate::summary::{ImageMetric, Metric};
use crate::tables::{Better, Column, TableId};

/// Where a column's numbers come from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Source {
    /// A metric of the score sheets.
    Metric(Metric),
    /// Reported seconds a clip.
    Seconds,
    /// Seconds of refinement alone.
    RefineSeconds,
    /// Peak memory, GiB.
    Memory,
}

/// A table as a grid of methods and metrics.
pub(crate) struct Layout {
    pub(crate) title: &'static str,
    pub(crate) columns: Vec<(Column, Source)>,
    pub(crate) rows: Vec<RowKey>,
    /// Settings the paper prints.
    pub(crate) settings: &'static [&'static str],
    /// Only the first clips of the cohort.
    pub(crate) first_clips: Option<usize>,
    /// Means carry their interval.
    pub(crate) intervals: bool,
    /// Methods with other labels follow below.
    pub(crate) others: bool,
}

/// A row: print label, method, and the method to subtract in difference tables.
pub(crate) struct RowKey {
    pub(crate) label: &'static str,
    pub(crate) method: &'static str,
    pub(crate) minus: Option<&'static str>,
    /// Restricts the row to one setting.
    pub(crate) only: Option<&'static str>,
}

const BOTH: &[&str] = &["recorded", "rollout"];
const RECORDED: &[&str] = &["recorded"];

/// The layout of a measured table; `None` for the tables of words and counts.
pub(crate) fn layout(id: TableId) -> Option<Layout> {
    use ImageMetric::{AbsRel, AbsRelScaled, Delta1, FarAbsRel, Lpips, Psnr, Rmse, Ssim};
    let source = |name: &str, metric, digits| metric_column(&format!("source {name}"), Metric::Source(metric), digits);
    let novel = |name: &str, metric, digits| metric_column(&format!("novel {name}"), Metric::Novel(metric), digits);
    let epe = |digits| metric_column("robot EPE (mm)", Metric::RobotEpe, digits);
    let depth = |digits| metric_column("robot depth (mm)", Metric::RobotDepth, digits);
    let ablation = |epe_digits| {
        vec![
            source("PSNR", Psnr, 2),
            novel("PSNR", Psnr, 2),
            novel("AbsRel", AbsRel, 3),
            epe(epe_digits),
            depth(1),
        ]
    };
    let plain = |title, columns, rows| Layout {
        title,
        columns,
        rows,
        settings: BOTH,
        first_clips: None,
        intervals: false,
        others: false,
    };
    Some(match id {
        TableId::Main => {
            let columns = vec![
                source("PSNR", Psnr, 2),
                source("LPIPS", Lpips, 3),
                source("AbsRel", AbsRel, 3),
                novel("PSNR", Psnr, 2),
                novel("LPIPS", Lpips, 3),
                novel("AbsRel", AbsRel, 3),
                epe(1),
                cost_column("time (s)", Source::Seconds),
                cost_column("memory (GiB)", Source::Memory),
            ];
            Layout {
                others: true,
                ..plain("Reconstruction", columns, methods())
            }
        }
        TableId::Additional => {
            let columns = vec![
                source("SSIM", Ssim, 3),
                source("RMSE (m)", Rmse, 3),
                novel("delta1 (%)", Delta1, 1),
            ];
            Layout {
                others: true,
                ..plain("Complementary metrics", columns, methods())
            }
        }
        TableId::Ci => {
            let columns = vec![novel("PSNR", Psnr, 2), novel("AbsRel", AbsRel, 3), epe(1)];
            let title = "Means with 95 % clip-bootstrap intervals";
            Layout {
                others: true,
                intervals: true,
                ..plain(title, columns, methods())
            }
        }
        TableId::Joint => {
            let rows = vec![
                row("cross-camera, Stage 2", "stage1+2"),
                row("cross-camera", "stage1"),
                row("Stage 2", "stage1+2/no-cross-camera"),
                row("neither", "stage1/no-cross-camera"),
            ];
            plain("Joint multi-camera lifting and refinement", ablation(2), rows)
        }
        TableId::Robot => plain(
            "Robot geometry and motion (Stage 1+2)",
            ablation(2),
            interventions("stage1+2"),
        ),
        TableId::RobotStage1 => {
            let columns = vec![epe(2), depth(1)];
            let title = "Robot geometry and motion (Stage 1)";
            Layout {
                settings: RECORDED,
                ..plain(title, columns, interventions("stage1"))
            }
        }
        TableId::Frames4dgt => {
            let columns = vec![
                source("PSNR", Psnr, 2),
                novel("PSNR", Psnr, 2),
                novel("LPIPS", Lpips, 3),
                novel("AbsRel", AbsRel, 3),
            ];
            plain(
                "4DGT by input frames",
                columns,
                vec![row("5 frames", "4dgt/5-frames"), row("17 frames", "4dgt")],
            )
        }
        TableId::Scale => {
            let columns = vec![
                source("AbsRel, scaled", AbsRelScaled, 3),
                novel("AbsRel, scaled", AbsRelScaled, 3),
            ];
            plain(
                "Median-scaled depth diagnostic",
                columns,
                vec![row("4DGT", "4dgt"), row("SoM", "som")],
            )
        }
        TableId::FkTransport => {
            let signed = |mut column: (Column, Source)| {
                column.0.signed = true;
                column
            };
            let columns = vec![novel("PSNR", Psnr, 2), novel("AbsRel", AbsRel, 3), epe(2), depth(1)]
                .into_iter()
                .map(signed)
                .collect();
            let difference = |label, method, minus, only| RowKey {
                label,
                method,
                minus: Some(minus),
                only,
            };
            let rows = vec![
                difference("Stage 1", "stage1/analytic-fk", "stage1", Some("recorded")),
                difference("Stage 1+2", "stage1+2/analytic-fk", "stage1+2", None),
            ];
            plain("Analytic FK transport minus learned motion", columns, rows)
        }
        TableId::Recurrence => {
            let columns = vec![
                source("PSNR", Psnr, 2),
                novel("PSNR", Psnr, 2),
                source("LPIPS", Lpips, 3),
                source("AbsRel", AbsRel, 3),
                epe(2),
                cost_column("refinement (s)", Source::RefineSeconds),
            ];
            let rows = vec![
                row("0", "stage1+2/r0"),
                row("1", "stage1+2/r1"),
                row("2", "stage1+2/r2"),
                row("3", "stage1+2/r3"),
                row("4", "stage1+2/r4"),
            ];
            Layout {
                settings: RECORDED,
                first_clips: Some(32),
                ..plain("Refinement updates", columns, rows)
            }
        }
        TableId::Latent => {
            let columns = vec![novel("PSNR", Psnr, 2), novel("AbsRel", AbsRel, 3), epe(1), depth(1)];
            plain(
                "Latent-token interface",
                columns,
                vec![row("Stage 1+2, latent tokens", "stage1+2/latent")],
            )
        }
        TableId::LatentResolution => {
            let columns = vec![
                source("PSNR", Psnr, 2),
                source("AbsRel", AbsRel, 3),
                source("delta1 (%)", Delta1, 1),
                source("far AbsRel", FarAbsRel, 3),
            ];
            let rows = vec![
                row("original RGB", "stage1"),
                row("8x down/up RGB", "stage1/down8"),
                row("latent adapter", "stage1/latent"),
            ];
            let title = "Spatial-resolution diagnostic (Stage 1)";
            Layout {
                settings: RECORDED,
                first_clips: Some(16),
                ..plain(title, columns, rows)
            }
        }
        TableId::Cohort | TableId::Inputs | TableId::Timing => return None,
    })
}

/// Rows of the main comparison.
pub(crate) fn methods() -> Vec<RowKey> {
    vec![
        row("MoVieS", "movies"),
        row("4DGT", "4dgt"),
        row("SoM", "som"),
        row("Ours (Stage 1)", "stage1"),
        row("Ours (Stage 1+2)", "stage1+2"),
    ]
}

fn interventions(base: &'static str) -> Vec<RowKey> {
    let [no_fk, no_mesh, neither] = if base == "stage1" {
        ["stage1/no-fk", "stage1/no-mesh", "stage1/no-mesh/no-fk"]
    } else {
        ["stage1+2/no-fk", "stage1+2/no-mesh", "stage1+2/no-mesh/no-fk"]
    };
    vec![
        row("mesh anchoring, FK conditioning", base),
        row("mesh anchoring", no_fk),
        row("FK conditioning", no_mesh),
        row("neither", neither),
    ]
}

const fn row(label: &'static str, method: &'static str) -> RowKey {
    RowKey {
        label,
        method,
        minus: None,
        only: None,
    }
}

fn metric_column(name: &str, metric: Metric, digits: usize) -> (Column, Source) {
    use ImageMetric::{Delta1, Psnr, Ssim};
    let higher = matches!(
        metric,
        Metric::Source(Psnr | Ssim | Delta1) | Metric::Novel(Psnr | Ssim | Delta1)
    );
    let better = Some(if higher { Better::Higher } else { Better::Lower });
    (
        Column {
            name: name.to_owned(),
            digits,
            signed: false,
            better,
        },
        Source::Metric(metric),
    )
}

fn cost_column(name: &str, source: Source) -> (Column, Source) {
    (
        Column {
            name: name.to_owned(),
            digits: 2,
            signed: false,
            better: Some(Better::Lower),
        },
        source,
    )
}
