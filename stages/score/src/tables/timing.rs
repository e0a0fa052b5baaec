//! The table of times and memory.

use std::collections::BTreeSet;

use crate::summary::SheetSet;
use crate::tables::id::TableId;
use crate::tables::input::{RECORDED, TableInput, TableOptions, heading};
use crate::tables::layout::METHODS;
use crate::tables::table::{Cell, Column, Row, Table};
use crate::timing::{ClipTiming, GIB, mean_of, peak_memory, reported_seconds};

/// A part of a method's time, seconds.
type Part = fn(&ClipTiming) -> Option<f64>;

const PARTS: [(&str, Part); 7] = [
    ("preprocess (s)", |t| t.preprocess_s),
    ("lift (s)", |t| t.lift_s),
    ("refine (s)", |t| t.refine_s),
    ("render queries (s)", |t| t.render_query_s),
    ("render displacements (s)", |t| t.render_displacement_s),
    ("transform and merge (s)", |t| t.transform_merge_s),
    ("reported (s)", reported_seconds),
];

const NOTE: &str = "means over clips without the first one of each process, where there are others; \
                    model loading and world-model generation excluded";

/// What every method cost a clip, in every setting that has scores or times.
pub(crate) fn table(set: &SheetSet<'_>, input: &TableInput<'_>, options: TableOptions) -> Table {
    let mut settings = set.settings();
    settings.extend(input.timings.iter().map(|timing| timing.setting.as_str()));
    if settings.is_empty() {
        settings.insert(RECORDED);
    }
    let mut rows: Vec<Row> = settings
        .into_iter()
        .flat_map(|setting| {
            let methods = methods(input.timings, setting).into_iter();
            methods.map(move |(label, method)| row(input.timings, setting, label, method))
        })
        .collect();
    if options.hide_empty_rows {
        rows.retain(|row| row.clips > 0);
    }
    let mut columns = PARTS.map(|(name, _)| Column::plain(name)).to_vec();
    columns.extend(["peak memory (GiB)", "device"].map(Column::plain));
    Table {
        id: TableId::Timing,
        title: "Time and memory a clip",
        columns,
        rows,
        footnotes: vec![NOTE.to_owned()],
        counted: true,
    }
}

/// Print label and method: those of the main comparison, then others that have times.
fn methods<'a>(timings: &'a [ClipTiming], setting: &str) -> Vec<(&'a str, &'a str)> {
    let known = METHODS.iter().map(|key| (key.label, key.method));
    let of_setting = timings.iter().filter(|timing| timing.setting == setting);
    let others: BTreeSet<&str> = of_setting
        .map(|timing| timing.method.as_str())
        .filter(|method| METHODS.iter().all(|key| key.method != *method))
        .collect();
    known.chain(others.into_iter().map(|method| (method, method))).collect()
}

fn row(timings: &[ClipTiming], setting: &str, label: &str, method: &str) -> Row {
    let own = || timings.iter().filter(|t| t.setting == setting && t.method == method);
    let mut cells: Vec<Cell> = PARTS
        .map(|(_, part)| Cell::mean(mean_of(timings, setting, method, part)))
        .to_vec();
    let memory = peak_memory(timings, setting, method).map(|(bytes, resident)| {
        let kind = if resident { "resident" } else { "device" };
        format!("{:.2} {kind}", bytes as f64 / GIB)
    });
    let devices: BTreeSet<String> = own().map(device).collect();
    let devices = (!devices.is_empty()).then(|| devices.into_iter().collect::<Vec<_>>().join("; "));
    cells.extend([memory, devices].map(|text| text.map_or(Cell::Missing, Cell::Text)));
    Row {
        group: heading(setting),
        label: label.to_owned(),
        method: method.to_owned(),
        clips: own().filter(|timing| !timing.warmup).count(),
        untrained: false,
        cells,
        published: &[],
    }
}

fn device(timing: &ClipTiming) -> String {
    match timing.threads {
        Some(threads) => format!("{}, {threads} threads", timing.device),
        None => timing.device.clone(),
    }
}
