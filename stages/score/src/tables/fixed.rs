//! The tables that are not means of score sheets: cohort, inputs, timing.

use crate::cohort::CohortCounts;
use crate::summary::SheetSet;
use crate::tables::build::heading;
use crate::tables::layout::methods;
use crate::tables::{Cell, Column, Row, Table, TableId, TableInput, TableOptions, published};
use crate::timing::{ClipTiming, mean_of, peak_memory, reported_seconds};

const GIB: f64 = 1024.0 * 1024.0 * 1024.0;

pub(crate) fn table(id: TableId, set: &SheetSet<'_>, input: &TableInput<'_>, options: TableOptions) -> Table {
    match id {
        TableId::Cohort => cohort(input.cohort, options),
        TableId::Timing => timing(set, input, options),
        _ => inputs(),
    }
}

fn cohort(counts: Option<&CohortCounts>, options: TableOptions) -> Table {
    type Stage = (&'static str, fn(&CohortCounts) -> usize);
    let stages: [Stage; 5] = [
        ("reserved episodes of ILIAD and PennPAL", |counts| counts.reserved),
        ("with a prepared clip and stereo references", |counts| counts.cached),
        ("represented in the PointWorld test manifest", |counts| {
            counts.candidates
        }),
        ("eligible", |counts| counts.eligible),
        ("fixed-seed sample", |counts| counts.selected),
    ];
    let row = |(label, count): Stage| Row {
        group: String::new(),
        label: label.to_owned(),
        method: String::new(),
        clips: 0,
        cells: vec![counts.map_or(Cell::Missing, |counts| Cell::Count(count(counts) as u64))],
        published: if options.published {
            texts(published::cohort(label))
        } else {
            Vec::new()
        },
    };
    let footnotes = if counts.is_none() {
        vec!["no selection was given".to_owned()]
    } else {
        Vec::new()
    };
    Table {
        id: TableId::Cohort,
        title: "Construction of the evaluation cohort".to_owned(),
        columns: vec![words("episodes")],
        rows: stages.into_iter().map(row).collect(),
        footnotes,
        counted: false,
    }
}

fn inputs() -> Table {
    let signals: [(&str, [&str; 4]); 8] = [
        (
            "left-eye visual input",
            ["5 times x 3 views", "5 / camera", "17 / camera", "17 / camera"],
        ),
        ("calibrated cameras", ["yes"; 4]),
        (
            "joint and gripper states",
            ["anchoring, FK", "no", "no", "FK masks only"],
        ),
        ("robot mesh", ["geometry prior", "no", "no", "foreground mask"]),
        ("source-time stereo depth", ["no", "scale only", "no", "scale only"]),
        ("right-eye RGB and depth", ["evaluation only"; 4]),
        ("3D track references", ["evaluation only"; 4]),
        ("fitting to target depth", ["no"; 4]),
    ];
    let row = |(label, cells): (&str, [&str; 4])| Row {
        group: String::new(),
        label: label.to_owned(),
        method: String::new(),
        clips: 0,
        cells: cells.iter().map(|text| Cell::Text((*text).to_owned())).collect(),
        published: Vec::new(),
    };
    Table {
        id: TableId::Inputs,
        title: "Signals used in the main comparison".to_owned(),
        columns: ["ours", "MoVieS", "4DGT", "SoM"].map(words).to_vec(),
        rows: signals.into_iter().map(row).collect(),
        footnotes: vec![
            "scale only: one factor per camera from recorded left-eye stereo depth at the five source times, for rollouts too"
                .to_owned(),
            "every method receives calibrated camera poses, including the wrist trajectory".to_owned(),
        ],
        counted: false,
    }
}

fn timing(set: &SheetSet<'_>, input: &TableInput<'_>, options: TableOptions) -> Table {
    type Part = fn(&ClipTiming) -> Option<f64>;
    let parts: [(&str, Part); 7] = [
        ("preprocess (s)", |t| t.preprocess_s),
        ("lift (s)", |t| t.lift_s),
        ("refine (s)", |t| t.refine_s),
        ("render queries (s)", |t| t.render_query_s),
        ("render displacements (s)", |t| t.render_displacement_s),
        ("transform and merge (s)", |t| t.transform_merge_s),
        ("reported (s)", reported_seconds),
    ];
    let mut settings: Vec<&str> = input.timings.iter().map(|timing| timing.setting.as_str()).collect();
    settings.extend(set.settings());
    settings.sort_unstable();
    settings.dedup();
    if settings.is_empty() {
        settings.push("recorded");
    }
    let mut rows = Vec::new();
    for setting in settings {
        let known = methods();
        let mut labels: Vec<(&str, &str)> = known.iter().map(|key| (key.label, key.method)).collect();
        let mut others: Vec<&str> = input
            .timings
            .iter()
            .filter(|t| t.setting == setting)
            .map(|t| t.method.as_str())
            .collect();
        others.sort_unstable();
        others.dedup();
        let others = others
            .into_iter()
            .filter(|method| !known.iter().any(|key| key.method == *method));
        labels.extend(others.map(|method| (method, method)));
        for (label, method) in labels {
            let own = input
                .timings
                .iter()
                .filter(|t| t.setting == setting && t.method == method);
            let clips = own.clone().filter(|timing| !timing.warmup).count();
            if clips == 0 && options.hide_empty_rows {
                continue;
            }
            let seconds = |part: Part| match mean_of(input.timings, setting, method, part) {
                Some((value, clips)) => Cell::Mean {
                    value,
                    clips,
                    interval: None,
                    digits: None,
                },
                None => Cell::Missing,
            };
            let mut cells: Vec<Cell> = parts.iter().map(|(_, part)| seconds(*part)).collect();
            let memory = peak_memory(input.timings, setting, method).map_or(Cell::Missing, |(bytes, resident)| {
                let kind = if resident { "resident" } else { "device" };
                Cell::Text(format!("{:.2} {kind}", bytes as f64 / GIB))
            });
            cells.push(memory);
            let devices: Vec<String> = own
                .clone()
                .map(device)
                .collect::<std::collections::BTreeSet<_>>()
                .into_iter()
                .collect();
            cells.push(if devices.is_empty() {
                Cell::Missing
            } else {
                Cell::Text(devices.join("; "))
            });
            rows.push(Row {
                group: heading(setting),
                label: label.to_owned(),
                method: method.to_owned(),
                clips,
                cells,
                published: Vec::new(),
            });
        }
    }
    let mut columns: Vec<Column> = parts.iter().map(|(name, _)| words(name)).collect();
    columns.extend([words("peak memory (GiB)"), words("device")]);
    Table {
        id: TableId::Timing,
        title: "Time and memory a clip".to_owned(),
        columns,
        rows,
        footnotes: vec![
            "means over clips without the first one of each process, where there are others; model loading and world-model generation excluded"
                .to_owned(),
        ],
        counted: true,
    }
}

fn device(timing: &ClipTiming) -> String {
    match timing.threads {
        Some(threads) => format!("{}, {threads} threads", timing.device),
        None => timing.device.clone(),
    }
}

fn words(name: &str) -> Column {
    Column {
        name: name.to_owned(),
        digits: 2,
        signed: false,
        better: None,
    }
}

fn texts(values: &[&str]) -> Vec<String> {
    values.iter().map(|text| (*text).to_owned()).collect()
}
