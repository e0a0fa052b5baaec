//! The tables of counts and words: how the cohort was made, which signals methods see.

use crate::cohort::CohortCounts;
use crate::tables::id::TableId;
use crate::tables::input::TableOptions;
use crate::tables::table::{Cell, Column, Row, Table};

/// A row of the cohort: print label, count, and the paper's count as printed there.
type Stage = (&'static str, fn(&CohortCounts) -> usize, &'static [&'static str]);

#[rustfmt::skip]
const STAGES: [Stage; 5] = [
    ("reserved episodes of ILIAD and PennPAL", |counts| counts.reserved, &["1,026"]),
    ("with a prepared clip and stereo references", |counts| counts.cached, &["804"]),
    ("represented in the PointWorld test manifest", |counts| counts.candidates, &["498"]),
    ("eligible", |counts| counts.eligible, &["498"]),
    ("fixed-seed sample", |counts| counts.selected, &["256"]),
];

const METHODS: [&str; 4] = ["ours", "MoVieS", "4DGT", "SoM"];

/// What each of [`METHODS`] has of a signal.
#[rustfmt::skip]
const SIGNALS: [(&str, [&str; 4]); 8] = [
    ("left-eye visual input", ["5 times x 3 views", "5 / camera", "17 / camera", "17 / camera"]),
    ("calibrated cameras", ["yes"; 4]),
    ("joint and gripper states", ["anchoring, FK", "no", "no", "FK masks only"]),
    ("robot mesh", ["geometry prior", "no", "no", "foreground mask"]),
    ("source-time stereo depth", ["no", "scale only", "no", "scale only"]),
    ("right-eye RGB and depth", ["evaluation only"; 4]),
    ("3D track references", ["evaluation only"; 4]),
    ("fitting to target depth", ["no"; 4]),
];

const SIGNAL_NOTES: [&str; 2] = [
    "scale only: one factor per camera from recorded left-eye stereo depth at the five source times, for rollouts too",
    "every method receives calibrated camera poses, including the wrist trajectory",
];

/// The construction of the cohort.
pub(crate) fn cohort(counts: Option<&CohortCounts>, options: TableOptions) -> Table {
    let row = |(label, count, published): Stage| Row {
        cells: vec![counts.map_or(Cell::Missing, |counts| Cell::Count(count(counts) as u64))],
        published: if options.published { published } else { &[] },
        ..Row::of_words(label)
    };
    Table {
        id: TableId::Cohort,
        title: "Construction of the evaluation cohort",
        columns: vec![Column::plain("episodes")],
        rows: STAGES.into_iter().map(row).collect(),
        footnotes: if counts.is_none() {
            vec!["no selection was given".to_owned()]
        } else {
            Vec::new()
        },
        counted: false,
    }
}

/// The signals that every method of the main comparison sees.
pub(crate) fn inputs() -> Table {
    let row = |(label, cells): (&str, [&str; 4])| Row {
        cells: cells.map(|text| Cell::Text(text.to_owned())).to_vec(),
        ..Row::of_words(label)
    };
    Table {
        id: TableId::Inputs,
        title: "Signals used in the main comparison",
        columns: METHODS.map(Column::plain).to_vec(),
        rows: SIGNALS.into_iter().map(row).collect(),
        footnotes: SIGNAL_NOTES.map(str::to_owned).to_vec(),
        counted: false,
    }
}
