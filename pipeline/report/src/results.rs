//! From a run folder to its report: outputs, ledger and score tables put together.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use rogs_orchestrator::ledger::{last_by_output, read_all};
use rogs_orchestrator::plan::{Plan, WorkUnit, read_plan};
use rogs_orchestrator::stage::StageId;
use rogs_orchestrator::state::OutputState;
use rogs_orchestrator::status::status_of;
use rogs_pages::{Plot, PlotPoint, Series};
use rogs_schemas::ledger::Attempt;
use rogs_schemas::read_record;
use rogs_schemas::records::scores::{ScoreSheet, Scores};
use rogs_score::cohort::CohortCounts;
use rogs_score::summary::{ImageMetric, Metric, clip_value};
use rogs_score::tables::{Table, TableId, TableInput, TableOptions, table, to_csv, to_latex, to_text};
use rogs_score::timing::ClipTiming;

use crate::costs::{keep_some_timings, timing};
use crate::page::{ClipReport, FailureReport, ReportInput, ReportTable, TimingReport, write_report};

/// Clips with pictures when the manifest does not say.
const DEFAULT_PICTURE_CLIPS: usize = 24;

/// What a run folder holds for tables and reports.
#[derive(Debug)]
pub struct RunResults {
    plan: Plan,
    clips: Vec<ClipReport>,
    /// Score sheets of all methods and clips that are up to date.
    sheets: Vec<ScoreSheet>,
    /// What the units cost, for the `timing` and `main` tables.
    timings: Vec<ClipTiming>,
}

impl RunResults {
    /// Reads the plan, the ledgers and the scores of a run folder.
    ///
    /// # Errors
    /// When it is none, or cannot be read.
    pub fn read(run: &Path) -> anyhow::Result<Self> {
        let plan = read_plan(run)?;
        let (status, states) = status_of(&plan)?;
        let attempts = last_by_output(read_all(&plan.run)?);
        let mut results = Self {
            clips: Vec::new(),
            sheets: Vec::new(),
            timings: Vec::new(),
            plan,
        };
        for index in 0..results.plan.clips.len() {
            results.add_clip(index, &states[index], &attempts);
        }
        for failure in status.failures {
            if let Some(clip) = results.clips.iter_mut().find(|clip| clip.clip_id == failure.clip) {
                let FailureReport { stage, message, hint } = FailureReport {
                    stage: failure.node,
                    message: failure.failure.message,
                    hint: failure.failure.hint,
                };
                clip.failures.push(FailureReport { stage, message, hint });
            }
        }
        keep_some_timings(&mut results.timings);
        Ok(results)
    }

    fn add_clip(
        &mut self,
        index: usize,
        states: &[OutputState],
        attempts: &std::collections::HashMap<(PathBuf, rogs_schemas::CacheKey), Attempt>,
    ) {
        let plan = &self.plan;
        let keys = plan.keys(index);
        let mut report = ClipReport {
            clip_id: plan.clips[index].id.clone(),
            ..ClipReport::default()
        };
        // Attempts by node, for the timing of methods.
        let mut costs: BTreeMap<usize, &Attempt> = BTreeMap::new();
        for (node_index, node) in plan.nodes.iter().enumerate() {
            let output = plan.output(
                WorkUnit {
                    clip: index,
                    node: node_index,
                },
                &keys,
            );
            if let Some(attempt) = attempts.get(&(output.clone(), keys[node_index].key)) {
                let seconds = attempt.seconds.get("total").copied().unwrap_or_default();
                report.timings.push(TimingReport {
                    stage: node.label.clone(),
                    seconds,
                    peak_rss_bytes: attempt.peak_rss_bytes,
                });
                report.warnings.extend(
                    attempt
                        .warnings
                        .iter()
                        .map(|warning| (node.label.clone(), warning.clone())),
                );
                costs.insert(node_index, attempt);
            }
            if states[node_index] != OutputState::UpToDate {
                continue;
            }
            let path = plan.run.join(&output);
            match node.stage {
                StageId::Ingest => report.clip = Some(path),
                StageId::RobotMaps if !node.by_key => report.robot = Some(path),
                StageId::Score => {
                    if let Ok((scores, _)) = read_record::<Scores>(&path) {
                        let sheet = scores.summary;
                        if sheet.images.is_empty() && sheet.tracks.is_empty() {
                            // An outside method without a prediction for the clip: it does not count there.
                            continue;
                        }
                        report.scores.push((sheet.method.clone(), path));
                        self.timings.push(timing(plan, index, node_index, &sheet, &costs));
                        self.sheets.push(sheet);
                    } else {
                        // The page names the file that cannot be read.
                        report.scores.push((node.label.clone(), path));
                    }
                }
                _ => {}
            }
        }
        self.clips.push(report);
    }

    /// One table of the paper over the clips of the run.
    ///
    /// # Errors
    /// When two outputs are scores of one method and clip.
    pub fn table(&self, id: TableId, cohort: Option<&CohortCounts>, options: TableOptions) -> anyhow::Result<Table> {
        let input = TableInput {
            sheets: &self.sheets,
            timings: &self.timings,
            cohort,
        };
        Ok(table(id, &input, options)?)
    }

    /// Writes `report/index.html` and returns its path. Files that cannot be read are named in the page instead of
    /// stopping it.
    ///
    /// # Errors
    /// When the page or a table cannot be written.
    pub fn write(self) -> anyhow::Result<PathBuf> {
        let options = TableOptions {
            hide_empty_rows: true,
            ..TableOptions::default()
        };
        let folder = self.plan.run.join("report");
        let mut tables = Vec::new();
        for id in TableId::ALL {
            let table = self.table(id, None, options)?;
            if has_content(&table) {
                write_table(&folder.join(TABLES_FOLDER), &table)?;
                tables.push(report_table(&table));
            }
        }
        let count = |finished: bool| {
            self.clips
                .iter()
                .filter(|clip| clip.failures.is_empty() == finished)
                .count()
        };
        let summary = vec![
            (
                "clips".to_owned(),
                format!("{} without failures, {} with", count(true), count(false)),
            ),
            ("setting".to_owned(), self.plan.setting.clone()),
            ("variants".to_owned(), self.plan.variants.join(", ")),
            ("program".to_owned(), format!("rogs {}", env!("CARGO_PKG_VERSION"))),
        ];
        let manifest = rogs_orchestrator::manifest::Manifest::load(&self.plan.manifest).ok();
        let max_picture_clips = manifest
            .and_then(|(manifest, _)| manifest.report.clips)
            .unwrap_or(DEFAULT_PICTURE_CLIPS);
        let input = ReportInput {
            run_name: self.plan.name.clone(),
            summary,
            tables,
            plots: plots(&self.sheets),
            clips: self.clips,
            max_picture_clips,
        };
        write_report(&folder, &input).with_context(|| format!("writing the report in `{}`", folder.display()))
    }
}

/// Folder of the table files beside the page.
const TABLES_FOLDER: &str = "tables";

/// Whether a table says something about this run: a number, and in tables of variants one of a variant.
fn has_content(table: &Table) -> bool {
    let measured = |row: &&rogs_score::tables::Row| row.cells.iter().any(|cell| cell.value().is_some());
    let of_variants = !matches!(
        table.id,
        TableId::Main | TableId::Additional | TableId::Ci | TableId::Scale | TableId::Timing
    );
    let mut rows = table.rows.iter().filter(measured);
    rows.any(|row| !of_variants || row.method.contains('/'))
}

/// Writes a table in all its forms.
fn write_table(folder: &Path, table: &Table) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("making `{}`", folder.display()))?;
    let mut json = serde_json::to_vec_pretty(table)?;
    json.push(b'\n');
    let forms = [
        ("txt", to_text(table).into_bytes()),
        ("csv", to_csv(table).into_bytes()),
        ("tex", to_latex(table).into_bytes()),
        ("json", json),
    ];
    for (extension, bytes) in forms {
        rogs_schemas::atomic::write_bytes(&folder.join(format!("{}.{extension}", table.id)), &bytes)?;
    }
    Ok(())
}

/// Methods that are compared, with the baseline first: those that are no variant of another.
fn plain_methods(sheets: &[ScoreSheet]) -> Vec<&str> {
    let names: std::collections::BTreeSet<&str> = sheets
        .iter()
        .map(|sheet| sheet.method.as_str())
        .filter(|method| !method.contains('/'))
        .collect();
    let mut methods: Vec<&str> = names.into_iter().collect();
    methods.sort_by_key(|method| *method != "stage1");
    methods
}

/// Plots over the clips of a run: what refinement updates do, and each clip under every method against the baseline.
fn plots(sheets: &[ScoreSheet]) -> Vec<Plot> {
    let metrics = [
        (Metric::Source(ImageMetric::Psnr), "source PSNR, dB"),
        (Metric::Novel(ImageMetric::Psnr), "novel PSNR, dB"),
        (Metric::Novel(ImageMetric::AbsRel), "novel AbsRel"),
        (Metric::RobotEpe, "robot EPE, mm"),
    ];
    let mut plots = Vec::new();
    for (metric, label) in metrics {
        plots.push(recurrence_plot(sheets, metric, label));
    }
    let methods = plain_methods(sheets);
    for (metric, label) in metrics {
        plots.push(clip_plot(sheets, &methods, metric, label));
    }
    plots.retain(|plot| !plot.series.is_empty());
    plots
}

/// Mean over clips after 0, 1, ... refinement updates (methods `stage1+2/rN`).
fn recurrence_plot(sheets: &[ScoreSheet], metric: Metric, label: &str) -> Plot {
    let mut by_update: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for sheet in sheets {
        let update = sheet
            .method
            .strip_prefix("stage1+2/r")
            .and_then(|update| update.parse().ok());
        if let (Some(update), Some(value)) = (update, clip_value(sheet, metric)) {
            by_update.entry(update).or_default().push(value);
        }
    }
    let point = |(update, values): (u32, Vec<f64>)| {
        let mean = rogs_score::metrics::mean(&values)?;
        Some(PlotPoint {
            x: f64::from(update),
            y: mean,
            name: format!("{update} updates, {} clips", values.len()),
        })
    };
    let points: Vec<PlotPoint> = by_update.into_iter().filter_map(point).collect();
    Plot {
        title: format!("Refinement updates: {label}"),
        x_label: "updates".to_owned(),
        y_label: label.to_owned(),
        series: if points.len() > 1 {
            vec![Series {
                label: String::new(),
                points,
            }]
        } else {
            Vec::new()
        },
        lines: true,
        ..Plot::default()
    }
}

/// Every clip: the baseline's value against that of each other method; with one method, its values in the order of clips.
fn clip_plot(sheets: &[ScoreSheet], methods: &[&str], metric: Metric, label: &str) -> Plot {
    let of = |method: &str| -> BTreeMap<(&str, &str), f64> {
        let own = sheets.iter().filter(|sheet| sheet.method == method);
        own.filter_map(|sheet| {
            Some((
                (sheet.setting.as_str(), sheet.clip_id.as_str()),
                clip_value(sheet, metric)?,
            ))
        })
        .collect()
    };
    let mut plot = Plot {
        title: format!("Clips: {label}"),
        y_label: label.to_owned(),
        ..Plot::default()
    };
    let Some((first, others)) = methods.split_first() else {
        return plot;
    };
    let base = of(first);
    if others.is_empty() {
        plot.x_label = "clip".to_owned();
        let points = base.iter().zip(1u32..).map(|(((_, clip), &y), x)| PlotPoint {
            x: f64::from(x),
            y,
            name: (*clip).to_owned(),
        });
        plot.series.push(Series {
            label: (*first).to_owned(),
            points: points.collect(),
        });
    } else {
        plot.x_label = format!("{first}: {label}");
        plot.diagonal = true;
        for method in others {
            let points = of(method).into_iter().filter_map(|(key, y)| {
                let x = *base.get(&key)?;
                let name = key.1.to_owned();
                Some(PlotPoint { x, y, name })
            });
            plot.series.push(Series {
                label: (*method).to_owned(),
                points: points.collect(),
            });
        }
    }
    plot.series.retain(|series| !series.points.is_empty());
    plot
}

/// The table as text cells.
fn report_table(table: &Table) -> ReportTable {
    let mut columns = vec!["method".to_owned()];
    columns.extend(table.columns.iter().map(|column| column.name.clone()));
    let row = |row: &rogs_score::tables::Row| {
        let mut cells = vec![if row.group.is_empty() {
            row.label.clone()
        } else {
            format!("{}: {}", row.group, row.label)
        }];
        cells.extend(
            row.cells
                .iter()
                .zip(&table.columns)
                .map(|(cell, column)| cell.print(column, row.clips)),
        );
        cells
    };
    ReportTable {
        title: table.title.clone(),
        rows: table.rows.iter().map(row).collect(),
        columns,
        footnotes: table.footnotes.clone(),
    }
}
