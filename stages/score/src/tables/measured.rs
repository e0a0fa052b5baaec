//! Tables of means over score sheets: a layout filled from sheets and times.

use std::collections::BTreeSet;

use crate::summary::{Metric, SheetSet, summarise, summarise_with_interval};
use crate::tables::id::TableId;
use crate::tables::input::{TableInput, TableOptions, heading};
use crate::tables::layout::{Layout, Origin, RowKey, layout, row};
use crate::tables::table::{Cell, Row, Table};
use crate::tables::{footnotes, published};
use crate::timing::{GIB, mean_of, peak_memory, reported_seconds};

/// Fills the layout of a table.
pub(crate) fn table(
    id: TableId,
    layout: &Layout,
    set: &SheetSet<'_>,
    input: &TableInput<'_>,
    options: TableOptions,
) -> Table {
    let builder = Builder {
        id,
        set,
        input,
        options,
        layout,
    };
    let settings = builder.settings();
    let rows: Vec<Row> = settings.iter().flat_map(|setting| builder.rows(setting)).collect();
    let footnotes = footnotes::of(id, layout, set, input.timings, input.missing, &settings, &rows);
    Table {
        id,
        title: layout.title,
        columns: layout.columns.iter().map(|(column, _)| *column).collect(),
        rows,
        footnotes,
        counted: true,
    }
}

struct Builder<'a> {
    id: TableId,
    set: &'a SheetSet<'a>,
    input: &'a TableInput<'a>,
    options: TableOptions,
    layout: &'a Layout,
}

impl<'a> Builder<'a> {
    /// The paper's settings that have scores (all of them beside published values, the first one at least), then others.
    fn settings(&self) -> Vec<&'a str> {
        let present = self.set.settings();
        let wanted = |setting: &&str| self.options.published || present.contains(*setting);
        let mut settings: Vec<&str> = self.layout.settings.iter().copied().filter(wanted).collect();
        if self.layout.others {
            settings.extend(
                present
                    .iter()
                    .filter(|setting| !self.layout.settings.contains(*setting)),
            );
        }
        if settings.is_empty() {
            settings.extend(self.layout.settings.first());
        }
        settings
    }

    fn rows(&self, setting: &str) -> Vec<Row> {
        let among = self.set.clips(setting, self.layout.first_clips);
        let keys = self
            .layout
            .rows
            .iter()
            .filter(|key| key.only.is_none_or(|only| only == setting));
        let mut rows: Vec<Row> = keys.map(|key| self.row(setting, key, &among)).collect();
        if self.layout.others {
            // The paper's variants have tables of their own.
            let layouts = TableId::ALL.into_iter().filter_map(layout);
            let known: BTreeSet<&str> = layouts.flat_map(|layout| layout.rows).map(|key| key.method).collect();
            let mut methods: BTreeSet<&str> = self.set.methods(setting).into_iter().collect();
            methods.extend(self.missing(setting));
            let others = methods.into_iter().filter(|method| !known.contains(method));
            rows.extend(others.map(|method| self.row(setting, &row(method, method), &among)));
        }
        if self.options.hide_empty_rows {
            // A method that failed on every clip is told, not hidden.
            let failed: BTreeSet<&str> = self.missing(setting).collect();
            rows.retain(|row| row.clips > 0 || failed.contains(row.method.as_str()));
        }
        rows
    }

    /// Methods that some clip of the setting has no scores of.
    fn missing(&self, setting: &str) -> impl Iterator<Item = &'a str> {
        let of_setting = self.input.missing.iter().filter(move |one| one.setting == setting);
        of_setting.map(|one| one.method.as_str())
    }

    fn row(&self, setting: &str, key: &RowKey<'_>, among: &BTreeSet<&str>) -> Row {
        let clips = |method: &str| -> BTreeSet<&str> {
            let sheets = self.set.sheets(setting, method);
            sheets.map(|sheet| sheet.clip_id.as_str()).collect()
        };
        let mut own = clips(key.method);
        own.retain(|clip| among.contains(clip));
        if let Some(minus) = key.minus {
            let other = clips(minus);
            own.retain(|clip| other.contains(clip));
        }
        let columns = self.layout.columns.iter();
        let mut sheets = self.set.sheets(setting, key.method);
        let untrained = sheets.any(|sheet| sheet.weights.iter().any(|weights| !weights.trained));
        let label = match untrained {
            true => format!("{} (seeded weights)", key.label),
            false => key.label.to_owned(),
        };
        Row {
            group: heading(setting),
            label,
            method: key.method.to_owned(),
            clips: own.len(),
            untrained,
            cells: columns
                .map(|(_, origin)| self.cell(setting, key, *origin, among))
                .collect(),
            published: if self.options.published {
                published::row(self.id, setting, key.method)
            } else {
                &[]
            },
        }
    }

    fn cell(&self, setting: &str, key: &RowKey<'_>, origin: Origin, among: &BTreeSet<&str>) -> Cell {
        let timings = self.input.timings;
        let method = key.method;
        match origin {
            Origin::Metric(metric) => self.metric_cell(setting, key, metric, among),
            Origin::Seconds => seconds(method, mean_of(timings, setting, method, reported_seconds)),
            Origin::RefineSeconds => seconds(method, mean_of(timings, setting, method, |timing| timing.refine_s)),
            Origin::Memory => {
                let of_row = timings.iter().filter(|t| t.setting == setting && t.method == method);
                let peak = peak_memory(timings, setting, method);
                Cell::mean(peak.map(|(bytes, _)| (bytes as f64 / GIB, of_row.count())))
            }
        }
    }

    fn metric_cell(&self, setting: &str, key: &RowKey<'_>, metric: Metric, among: &BTreeSet<&str>) -> Cell {
        let mut values = self.set.values(setting, key.method, metric, among);
        if let Some(minus) = key.minus {
            let base = self.set.values(setting, minus, metric, among);
            values.retain(|clip, _| base.contains_key(clip));
            values.iter_mut().for_each(|(clip, value)| *value -= base[clip]);
        }
        let values: Vec<f64> = values.into_values().collect();
        if self.layout.intervals || self.options.intervals {
            summarise_with_interval(&values).map_or(Cell::Missing, |(own, interval)| Cell::Mean {
                value: own.mean,
                clips: own.clips,
                interval: Some([interval.low, interval.high]),
                digits: None,
            })
        } else {
            Cell::mean(summarise(&values).map(|own| (own.mean, own.clips)))
        }
    }
}

/// A time in seconds. Optimisation takes half an hour: no fractions of a second there.
fn seconds(method: &str, found: Option<(f64, usize)>) -> Cell {
    let whole = (method.split('/').next() == Some("som")).then_some(0);
    match Cell::mean(found) {
        Cell::Mean {
            value, clips, interval, ..
        } => Cell::Mean {
            value,
            clips,
            interval,
            digits: whole,
        },
        other => other,
    }
}
