//! The tables of counts and words: how the cohort was made, which signals methods see.

use crate::cohort::CohortCounts;
use crate::tables::id::TableId;
use crate::tables::input::{MethodSignals, NOT_TOLD, SCALE_ONLY, SIGNALS, TableOptions, heading};
use crate::tables::layout::METHODS;
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

/// What the paper's methods were given, by [`SIGNALS`].
#[rustfmt::skip]
const PUBLISHED: [(&str, [&str; SIGNALS.len()]); 4] = [
    ("Ours", ["either", "5 times x 3 views", "yes", "anchoring, FK", "geometry prior", "no", "evaluation only", "evaluation only", "no"]),
    ("MoVieS", ["either", "5 / camera", "yes", "no", "no", "scale only", "evaluation only", "evaluation only", "no"]),
    ("4DGT", ["either", "17 / camera", "yes", "no", "no", "no", "evaluation only", "evaluation only", "no"]),
    ("SoM", ["either", "17 / camera", "yes", "FK masks only", "foreground mask", "scale only", "evaluation only", "evaluation only", "no"]),
];

const SCALE_NOTE: &str =
    "scale only: one factor per camera from recorded left-eye stereo depth at the source times, for rollouts too";

/// Whether a cell says that a scale alone is taken, whatever made the depth that it is taken from.
fn is_scale_only(cell: &Cell) -> bool {
    matches!(cell, Cell::Text(text) if text.starts_with(SCALE_ONLY))
}

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

/// What every method of the run was given; beside it, where asked for or nothing is known of a run, what the paper's were.
pub(crate) fn inputs(signals: &[MethodSignals], options: TableOptions) -> Table {
    let row = |group: String, label: &str, method: &str, cells: Vec<String>| Row {
        group,
        method: method.to_owned(),
        cells: cells.into_iter().map(Cell::Text).collect(),
        ..Row::of_words(label)
    };
    let name = |method: &str| {
        let known = METHODS.iter().find(|known| known.method == method);
        known.map_or(method.to_owned(), |known| known.label.to_owned())
    };
    let mut rows: Vec<Row> = signals
        .iter()
        .map(|own| {
            row(
                heading(&own.setting),
                &name(&own.method),
                &own.method,
                own.given.to_vec(),
            )
        })
        .collect();
    if options.published || signals.is_empty() {
        let published = PUBLISHED.iter().map(|(label, cells)| {
            row(
                "The paper's evaluation".to_owned(),
                label,
                "",
                cells.map(str::to_owned).to_vec(),
            )
        });
        rows.extend(published);
    }
    let mut footnotes = Vec::new();
    if rows.iter().any(|row| row.cells.iter().any(is_scale_only)) {
        footnotes.push(SCALE_NOTE.to_owned());
    }
    if signals.iter().any(|own| own.given.iter().any(|text| text == NOT_TOLD)) {
        footnotes.push(format!(
            "{NOT_TOLD}: the method's files do not say; see what its makers state"
        ));
    }
    footnotes.push("every method receives calibrated camera poses, including the wrist trajectory".to_owned());
    Table {
        id: TableId::Inputs,
        title: if signals.is_empty() {
            "Signals used in the paper's evaluation"
        } else {
            "Signals that this run used"
        },
        columns: SIGNALS.map(Column::plain).to_vec(),
        rows,
        footnotes,
        counted: false,
    }
}
