//! Which rows and columns every measured table has, as data: a new table is one [`Layout`] and its line in [`layout`].

use crate::summary::ImageMetric::{AbsRel, AbsRelScaled, Delta1, FarAbsRel, Lpips, Psnr, Rmse, Ssim};
use crate::summary::Metric::{self, CrossView, CrossViewShown, Novel, RobotDepth, RobotEpe, Source};
use crate::tables::id::TableId;
use crate::tables::input::{RECORDED, ROLLOUT};
use crate::tables::table::{Better, Column};

/// Where a column's numbers come from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Origin {
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
    pub(crate) columns: &'static [(Column, Origin)],
    pub(crate) rows: &'static [RowKey<'static>],
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
pub(crate) struct RowKey<'a> {
    pub(crate) label: &'a str,
    pub(crate) method: &'a str,
    pub(crate) minus: Option<&'a str>,
    /// Restricts the row to one setting.
    pub(crate) only: Option<&'a str>,
}

/// The scores of a method as they are.
pub(crate) const fn row<'a>(label: &'a str, method: &'a str) -> RowKey<'a> {
    RowKey {
        label,
        method,
        minus: None,
        only: None,
    }
}

/// The layout of a measured table; `None` for the tables of words, counts and times.
pub(crate) fn layout(id: TableId) -> Option<&'static Layout> {
    match id {
        TableId::Main => Some(&MAIN),
        TableId::Joint => Some(&JOINT),
        TableId::Robot => Some(&ROBOT),
        TableId::RobotStage1 => Some(&ROBOT_STAGE1),
        TableId::Additional => Some(&ADDITIONAL),
        TableId::Ci => Some(&CI),
        TableId::Frames4dgt => Some(&FRAMES_4DGT),
        TableId::Scale => Some(&SCALE),
        TableId::FkTransport => Some(&FK_TRANSPORT),
        TableId::Recurrence => Some(&RECURRENCE),
        TableId::Latent => Some(&LATENT),
        TableId::LatentResolution => Some(&LATENT_RESOLUTION),
        TableId::CrossView => Some(&CROSS_VIEW),
        TableId::Cohort | TableId::Inputs | TableId::Timing | TableId::Following => None,
    }
}

/// What most tables have in common.
const PLAIN: Layout = Layout {
    title: "",
    columns: &[],
    rows: &[],
    settings: &[RECORDED, ROLLOUT],
    first_clips: None,
    intervals: false,
    others: false,
};

/// Rows of the main comparison.
pub(crate) const METHODS: &[RowKey<'static>] = &[
    row("MoVieS", "movies"),
    row("4DGT", "4dgt"),
    row("SoM", "som"),
    row("Ours (Stage 1)", "stage1"),
    row("Ours (Stage 1+2)", "stage1+2"),
];

static MAIN: Layout = Layout {
    title: "Reconstruction",
    columns: &[
        metric("source PSNR", Source(Psnr), 2),
        metric("source LPIPS", Source(Lpips), 3),
        metric("source AbsRel", Source(AbsRel), 3),
        metric("novel PSNR", Novel(Psnr), 2),
        metric("novel LPIPS", Novel(Lpips), 3),
        metric("novel AbsRel", Novel(AbsRel), 3),
        metric("robot EPE (mm)", RobotEpe, 1),
        cost("time (s)", Origin::Seconds),
        cost("memory (GiB)", Origin::Memory),
    ],
    rows: METHODS,
    others: true,
    ..PLAIN
};

static ADDITIONAL: Layout = Layout {
    title: "Complementary metrics",
    columns: &[
        metric("source SSIM", Source(Ssim), 3),
        metric("source RMSE (m)", Source(Rmse), 3),
        metric("novel delta1 (%)", Novel(Delta1), 1),
    ],
    rows: METHODS,
    others: true,
    ..PLAIN
};

static CI: Layout = Layout {
    title: "Means with 95 % clip-bootstrap intervals",
    columns: &[
        metric("novel PSNR", Novel(Psnr), 2),
        metric("novel AbsRel", Novel(AbsRel), 3),
        metric("robot EPE (mm)", RobotEpe, 1),
    ],
    rows: METHODS,
    others: true,
    intervals: true,
    ..PLAIN
};

/// Columns of the tables that leave out parts of the method.
const ABLATION: &[(Column, Origin)] = &[
    metric("source PSNR", Source(Psnr), 2),
    metric("novel PSNR", Novel(Psnr), 2),
    metric("novel AbsRel", Novel(AbsRel), 3),
    metric("robot EPE (mm)", RobotEpe, 2),
    metric("robot depth (mm)", RobotDepth, 1),
];

static JOINT: Layout = Layout {
    title: "Joint multi-camera lifting and refinement",
    columns: ABLATION,
    rows: &[
        row("cross-camera, Stage 2", "stage1+2"),
        row("cross-camera", "stage1"),
        row("Stage 2", "stage1+2/no-cross-camera"),
        row("neither", "stage1/no-cross-camera"),
    ],
    ..PLAIN
};

static ROBOT: Layout = Layout {
    title: "Robot geometry and motion (Stage 1+2)",
    columns: ABLATION,
    rows: &[
        row("mesh anchoring, FK conditioning", "stage1+2"),
        row("mesh anchoring", "stage1+2/no-fk"),
        row("FK conditioning", "stage1+2/no-mesh"),
        row("neither", "stage1+2/no-mesh/no-fk"),
    ],
    ..PLAIN
};

static ROBOT_STAGE1: Layout = Layout {
    title: "Robot geometry and motion (Stage 1)",
    columns: &[
        metric("robot EPE (mm)", RobotEpe, 2),
        metric("robot depth (mm)", RobotDepth, 1),
    ],
    rows: &[
        row("mesh anchoring, FK conditioning", "stage1"),
        row("mesh anchoring", "stage1/no-fk"),
        row("FK conditioning", "stage1/no-mesh"),
        row("neither", "stage1/no-mesh/no-fk"),
    ],
    settings: &[RECORDED],
    ..PLAIN
};

static FRAMES_4DGT: Layout = Layout {
    title: "4DGT by input frames",
    columns: &[
        metric("source PSNR", Source(Psnr), 2),
        metric("novel PSNR", Novel(Psnr), 2),
        metric("novel LPIPS", Novel(Lpips), 3),
        metric("novel AbsRel", Novel(AbsRel), 3),
    ],
    rows: &[row("5 frames", "4dgt/5-frames"), row("17 frames", "4dgt")],
    ..PLAIN
};

static SCALE: Layout = Layout {
    title: "Median-scaled depth diagnostic",
    columns: &[
        metric("source AbsRel, scaled", Source(AbsRelScaled), 3),
        metric("novel AbsRel, scaled", Novel(AbsRelScaled), 3),
    ],
    rows: &[row("4DGT", "4dgt"), row("SoM", "som")],
    ..PLAIN
};

static FK_TRANSPORT: Layout = Layout {
    title: "Analytic FK transport minus learned motion",
    columns: &[
        signed(metric("novel PSNR", Novel(Psnr), 2)),
        signed(metric("novel AbsRel", Novel(AbsRel), 3)),
        signed(metric("robot EPE (mm)", RobotEpe, 2)),
        signed(metric("robot depth (mm)", RobotDepth, 1)),
    ],
    rows: &[
        RowKey {
            minus: Some("stage1"),
            only: Some(RECORDED),
            ..row("Stage 1", "stage1/analytic-fk")
        },
        RowKey {
            minus: Some("stage1+2"),
            ..row("Stage 1+2", "stage1+2/analytic-fk")
        },
    ],
    ..PLAIN
};

static RECURRENCE: Layout = Layout {
    title: "Refinement updates",
    columns: &[
        metric("source PSNR", Source(Psnr), 2),
        metric("novel PSNR", Novel(Psnr), 2),
        metric("source LPIPS", Source(Lpips), 3),
        metric("source AbsRel", Source(AbsRel), 3),
        metric("robot EPE (mm)", RobotEpe, 2),
        cost("refinement (s)", Origin::RefineSeconds),
    ],
    rows: &[
        row("0", "stage1+2/r0"),
        row("1", "stage1+2/r1"),
        row("2", "stage1+2/r2"),
        row("3", "stage1+2/r3"),
        row("4", "stage1+2/r4"),
    ],
    settings: &[RECORDED],
    first_clips: Some(32),
    ..PLAIN
};

static LATENT: Layout = Layout {
    title: "Latent-token interface",
    columns: &[
        metric("novel PSNR", Novel(Psnr), 2),
        metric("novel AbsRel", Novel(AbsRel), 3),
        metric("robot EPE (mm)", RobotEpe, 1),
        metric("robot depth (mm)", RobotDepth, 1),
    ],
    rows: &[row("Stage 1+2, latent tokens", "stage1+2/latent")],
    ..PLAIN
};

static LATENT_RESOLUTION: Layout = Layout {
    title: "Spatial-resolution diagnostic (Stage 1)",
    columns: &[
        metric("source PSNR", Source(Psnr), 2),
        metric("source AbsRel", Source(AbsRel), 3),
        metric("source delta1 (%)", Source(Delta1), 1),
        metric("source far AbsRel", Source(FarAbsRel), 3),
    ],
    rows: &[
        row("original RGB", "stage1"),
        row("8x down/up RGB", "stage1/down8"),
        row("latent adapter", "stage1/latent"),
    ],
    settings: &[RECORDED],
    first_clips: Some(16),
    ..PLAIN
};

static CROSS_VIEW: Layout = Layout {
    title: "Cross-view consistency of the observations",
    columns: &[
        metric("PSNR from the other cameras", CrossView, 2),
        metric("shown by them (%)", CrossViewShown, 1),
    ],
    rows: &[
        row("Ours (Stage 1)", "stage1"),
        row("Ours (Stage 1+2)", "stage1+2"),
        row("Stage 1, no cross-camera", "stage1/no-cross-camera"),
        row("Stage 1+2, no cross-camera", "stage1+2/no-cross-camera"),
    ],
    others: true,
    intervals: true,
    ..PLAIN
};

const fn metric(name: &'static str, metric: Metric, digits: usize) -> (Column, Origin) {
    let better = match metric {
        Source(Psnr | Ssim | Delta1) | Novel(Psnr | Ssim | Delta1) | CrossView | CrossViewShown => Better::Higher,
        _ => Better::Lower,
    };
    let column = Column {
        digits,
        better: Some(better),
        ..Column::plain(name)
    };
    (column, Origin::Metric(metric))
}

const fn cost(name: &'static str, origin: Origin) -> (Column, Origin) {
    let column = Column {
        better: Some(Better::Lower),
        ..Column::plain(name)
    };
    (column, origin)
}

/// The same column with the sign of positive numbers.
const fn signed((column, origin): (Column, Origin)) -> (Column, Origin) {
    (Column { signed: true, ..column }, origin)
}
