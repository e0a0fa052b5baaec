//! Filling a table from score sheets and timings.

use std::collections::BTreeSet;

use rogs_schemas::records::scores::ScoreSheet;

use crate::cohort::CohortCounts;
use crate::summary::{Metric, OUTSIDE_SCALED, SheetSet, summarise, summarise_with_interval};
use crate::tables::layout::{Layout, RowKey, Source, layout};
use crate::tables::{Cell, Column, Row, Table, TableError, TableId, fixed, published};
use crate::timing::{ClipTiming, mean_of, peak_memory, reported_seconds};

const GIB: f64 = 1024.0 * 1024.0 * 1024.0;

/// What tables are made of.
#[derive(Debug, Clone, Copy, Default)]
pub struct TableInput<'a> {
    /// Score sheets of every method, setting and clip.
    pub sheets: &'a [ScoreSheet],
    /// Times and memory, where they are known.
    pub timings: &'a [ClipTiming],
    /// Counts of the cohort's construction, where they are known.
    pub cohort: Option<&'a CohortCounts>,
}

/// How tables are printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TableOptions {
    /// Put the paper's values beside ours.
    pub published: bool,
    /// Give every mean its bootstrap interval.
    pub intervals: bool,
    /// Leave out rows of methods without scores.
    pub hide_empty_rows: bool,
}

/// Makes a table. Methods without scores have dashes.
///
/// # Errors
/// When two sheets have the same method, setting and clip.
pub fn table(id: TableId, input: &TableInput<'_>, options: TableOptions) -> Result<Table, TableError> {
    let set = SheetSet::new(input.sheets)?;
    let Some(layout) = layout(id) else {
        return Ok(fixed::table(id, &set, input, options));
    };
    let builder = Builder {
        id,
        set: &set,
        input,
        options,
        layout: &layout,
    };
    let mut rows = Vec::new();
    for setting in builder.settings() {
        rows.extend(builder.rows(setting));
    }
    let footnotes = builder.footnotes(&rows);
    Ok(Table {
        id,
        title: layout.title.to_owned(),
        columns: layout.columns.iter().map(|(column, _)| column.clone()).collect(),
        rows,
        footnotes,
        counted: true,
    })
}

/// What a setting is called in print.
pub(crate) fn heading(setting: &str) -> String {
    match setting {
        "recorded" => "Recorded observations".to_owned(),
        "rollout" => "World-model rollouts".to_owned(),
        other => other.to_owned(),
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

    fn rows(&self, setting: &'a str) -> Vec<Row> {
        let among = self.set.clips(setting, self.layout.first_clips);
        let keys = self
            .layout
            .rows
            .iter()
            .filter(|key| key.only.is_none_or(|only| only == setting));
        let mut rows: Vec<Row> = keys
            .map(|key| self.row(setting, key.label, key.method, Some(key), &among))
            .collect();
        if self.layout.others {
            // The paper's variants have tables of their own.
            let layouts = TableId::ALL.into_iter().filter_map(layout);
            let known: BTreeSet<&str> = layouts.flat_map(|layout| layout.rows).map(|key| key.method).collect();
            let others = self
                .set
                .methods(setting)
                .into_iter()
                .filter(|method| !known.contains(method));
            rows.extend(others.map(|method| self.row(setting, method, method, None, &among)));
        }
        if self.options.hide_empty_rows {
            rows.retain(|row| row.clips > 0);
        }
        rows
    }

    fn row(&self, setting: &str, label: &str, method: &str, key: Option<&RowKey>, among: &BTreeSet<&str>) -> Row {
        let sheets = || {
            self.set
                .sheets(setting, method)
                .filter(|sheet| among.contains(sheet.clip_id.as_str()))
        };
        let minus = key.and_then(|key| key.minus);
        let clips = match minus {
            None => sheets().count(),
            Some(minus) => {
                let other: BTreeSet<&str> = self
                    .set
                    .sheets(setting, minus)
                    .map(|sheet| sheet.clip_id.as_str())
                    .collect();
                sheets().filter(|sheet| other.contains(sheet.clip_id.as_str())).count()
            }
        };
        let cells = self
            .layout
            .columns
            .iter()
            .map(|(_, source)| self.cell(setting, method, minus, *source, among));
        let published = if self.options.published {
            published::row(self.id, setting, method)
        } else {
            &[]
        };
        Row {
            group: heading(setting),
            label: label.to_owned(),
            method: method.to_owned(),
            clips,
            cells: cells.collect(),
            published: published.iter().map(|text| (*text).to_owned()).collect(),
        }
    }

    fn cell(&self, setting: &str, method: &str, minus: Option<&str>, source: Source, among: &BTreeSet<&str>) -> Cell {
        let timings = self.input.timings;
        let seconds = |found: Option<(f64, usize)>| {
            // Optimisation takes half an hour: no fractions of a second.
            let digits = (method.split('/').next() == Some("som")).then_some(0);
            found.map_or(Cell::Missing, |(value, clips)| Cell::Mean {
                value,
                clips,
                interval: None,
                digits,
            })
        };
        match source {
            Source::Metric(metric) => self.metric_cell(setting, method, minus, metric, among),
            Source::Seconds => seconds(mean_of(timings, setting, method, reported_seconds)),
            Source::RefineSeconds => seconds(mean_of(timings, setting, method, |timing| timing.refine_s)),
            Source::Memory => peak_memory(timings, setting, method).map_or(Cell::Missing, |(bytes, _)| {
                let clips = timings
                    .iter()
                    .filter(|t| t.setting == setting && t.method == method)
                    .count();
                Cell::Mean {
                    value: bytes as f64 / GIB,
                    clips,
                    interval: None,
                    digits: None,
                }
            }),
        }
    }

    fn metric_cell(
        &self,
        setting: &str,
        method: &str,
        minus: Option<&str>,
        metric: Metric,
        among: &BTreeSet<&str>,
    ) -> Cell {
        let mut values = self.set.values(setting, method, metric, among);
        if let Some(minus) = minus {
            let base = self.set.values(setting, minus, metric, among);
            values.retain(|clip, _| base.contains_key(clip));
            values.iter_mut().for_each(|(clip, value)| *value -= base[clip]);
        }
        let values: Vec<f64> = values.into_values().collect();
        let filled = |value, clips, interval| Cell::Mean {
            value,
            clips,
            interval,
            digits: None,
        };
        if self.layout.intervals || self.options.intervals {
            summarise_with_interval(&values).map_or(Cell::Missing, |(own, interval)| {
                filled(own.mean, own.clips, Some([interval.low, interval.high]))
            })
        } else {
            summarise(&values).map_or(Cell::Missing, |own| filled(own.mean, own.clips, None))
        }
    }

    fn footnotes(&self, rows: &[Row]) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some(count) = self.layout.first_clips {
            notes.push(format!("the first {count} clips of the cohort at most"));
        }
        let shown = |method: &str| rows.iter().any(|row| row.method.split('/').next() == Some(method));
        let scaled: Vec<&str> = [("movies", "MoVieS"), ("som", "SoM")]
            .into_iter()
            .filter(|(method, _)| shown(method))
            .map(|(_, label)| label)
            .collect();
        if !scaled.is_empty() {
            notes.push(format!(
                "{}: by the paper's protocol one scale factor per camera from recorded source stereo depth",
                scaled.join(", ")
            ));
        }
        if self.id == TableId::Scale {
            notes
                .push("every depth image is scaled by the median ratio to its target; this diagnostic only".to_owned());
        }
        let scaled = |row: &Row| {
            let settings = self.settings();
            let mut sheets = settings
                .iter()
                .flat_map(|setting| self.set.sheets(setting, &row.method));
            sheets.any(|sheet| sheet.weights.iter().any(|info| info.configuration == OUTSIDE_SCALED))
        };
        let scaled: BTreeSet<&str> = rows
            .iter()
            .filter(|row| scaled(row))
            .map(|row| row.label.as_str())
            .collect();
        if !scaled.is_empty() {
            let list = scaled.into_iter().collect::<Vec<_>>().join(", ");
            notes.push(format!(
                "{list}: fields brought to metres here, by one source-depth factor per camera"
            ));
        }
        notes.extend(coverage(rows));
        notes.extend(self.sheet_notes(rows));
        if self.layout.columns.iter().any(|(_, source)| *source == Source::Memory) && self.any_resident(rows) {
            notes.push("memory is the peak resident memory of the process (CPU), not device memory".to_owned());
        }
        notes
    }

    fn any_resident(&self, rows: &[Row]) -> bool {
        let resident = |row: &Row| {
            let settings = self
                .input
                .timings
                .iter()
                .filter(|t| t.method == row.method)
                .map(|t| t.setting.as_str());
            settings.collect::<BTreeSet<_>>().into_iter().any(|setting| {
                peak_memory(self.input.timings, setting, &row.method).is_some_and(|(_, resident)| resident)
            })
        };
        rows.iter().any(resident)
    }

    /// What the sheets behind the rows say about themselves.
    fn sheet_notes(&self, rows: &[Row]) -> Vec<String> {
        let methods: BTreeSet<&str> = rows.iter().map(|row| row.method.as_str()).collect();
        let settings = self.settings();
        let sheets = || {
            let keys = settings
                .iter()
                .flat_map(|setting| methods.iter().map(move |method| (*setting, *method)));
            keys.flat_map(|(setting, method)| self.set.sheets(setting, method))
        };
        let mut notes = Vec::new();
        let has = |word: &str| {
            self.layout
                .columns
                .iter()
                .any(|(Column { name, .. }, _)| name.contains(word))
        };
        if has("LPIPS") {
            let reasons: BTreeSet<&str> = sheets().filter_map(|sheet| sheet.lpips_note.as_deref()).collect();
            notes.extend(reasons.into_iter().map(|reason| format!("LPIPS: {reason}")));
        }
        if has("SSIM") {
            let variants: BTreeSet<&str> = sheets().map(|sheet| sheet.ssim_variant.as_str()).collect();
            if !variants.is_empty() {
                notes.push(format!(
                    "SSIM variant: {}",
                    variants.into_iter().collect::<Vec<_>>().join(", ")
                ));
            }
        }
        let empty: u64 = sheets().map(|sheet| u64::from(sheet.n_empty_support)).sum();
        if empty > 0 && (has("AbsRel") || has("RMSE") || has("delta1")) {
            notes.push(format!(
                "{empty} images have reference depth but none of it in range; they are left out"
            ));
        }
        let untrained: BTreeSet<&str> = sheets()
            .filter(|sheet| sheet.weights.iter().any(|weights| !weights.trained))
            .map(|sheet| sheet.method.as_str())
            .collect();
        if !untrained.is_empty() {
            let list = untrained.into_iter().collect::<Vec<_>>().join(", ");
            notes.push(format!(
                "UNTRAINED WEIGHTS: {list} ran with seeded random weights; these numbers say nothing about the method"
            ));
        }
        notes
    }
}

/// Names the rows that lack clips which others have.
fn coverage(rows: &[Row]) -> Vec<String> {
    let groups: BTreeSet<&str> = rows.iter().map(|row| row.group.as_str()).collect();
    let mut notes = Vec::new();
    for group in groups {
        let own = || rows.iter().filter(|row| row.group == group);
        let most = own().map(|row| row.clips).max().unwrap_or(0);
        let short = own().filter(|row| row.clips > 0 && row.clips < most);
        let list: Vec<String> = short.map(|row| format!("{} {}", row.label, row.clips)).collect();
        if !list.is_empty() {
            notes.push(format!("{group}: {most} clips, except {}", list.join(", ")));
        }
    }
    notes
}
