//! From a run folder to its report: outputs, ledger and score tables put together.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use rogs_orchestrator::ledger::{last_by_output, read_all};
use rogs_orchestrator::plan::{Plan, Unit, read_plan};
use rogs_orchestrator::report::{ClipReport, FailureReport, ReportInput, ReportTable, TimingReport, write_report};
use rogs_orchestrator::state::OutputState;
use rogs_orchestrator::status::status_of;
use rogs_schemas::ledger::Attempt;
use rogs_schemas::read_record;
use rogs_schemas::records::scores::{ScoreSheet, Scores};
use rogs_score::tables::{Table, TableId, TableInput, TableOptions, table};
use rogs_score::timing::ClipTiming;

/// Clips with pictures when the manifest does not say.
const DEFAULT_PICTURE_CLIPS: usize = 24;

/// What a run folder holds for tables and reports.
pub(crate) struct RunResults {
    plan: Plan,
    clips: Vec<ClipReport>,
    /// Score sheets of all methods and clips that are up to date.
    pub(crate) sheets: Vec<ScoreSheet>,
    /// What the units cost, for the `timing` and `main` tables.
    pub(crate) timings: Vec<ClipTiming>,
}

impl RunResults {
    /// Reads the plan, the ledgers and the scores of a run folder.
    pub(crate) fn read(run: &Path) -> anyhow::Result<Self> {
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
        // Seconds and peak memory by node label, for the timing of methods.
        let mut costs: BTreeMap<usize, (f64, u64)> = BTreeMap::new();
        for (node_index, node) in plan.nodes.iter().enumerate() {
            let output = plan.output(
                Unit {
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
                costs.insert(node_index, (seconds, attempt.peak_rss_bytes));
            }
            if states[node_index] != OutputState::UpToDate {
                continue;
            }
            let path = plan.run.join(&output);
            match node.stage.as_str() {
                "ingest" => report.clip = Some(path),
                "robot-maps" if !node.by_key => report.robot = Some(path),
                "score" => {
                    if let Ok((scores, _)) = read_record::<Scores>(&path) {
                        let sheet = scores.summary;
                        report.scores.push((sheet.method.clone(), path));
                        self.timings.push(timing(plan, node_index, &sheet, &costs));
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
    pub(crate) fn table(&self, id: TableId, options: TableOptions) -> anyhow::Result<Table> {
        let input = TableInput {
            sheets: &self.sheets,
            timings: &self.timings,
            cohort: None,
        };
        Ok(table(id, &input, options)?)
    }

    /// Writes `report/index.html` and returns its path.
    pub(crate) fn write(self) -> anyhow::Result<PathBuf> {
        let options = TableOptions {
            hide_empty_rows: true,
            ..TableOptions::default()
        };
        let mut tables = Vec::new();
        for id in [TableId::Main, TableId::Additional, TableId::Robot, TableId::Ci] {
            let table = self.table(id, options)?;
            if !table.rows.is_empty() {
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
        let folder = self.plan.run.join("report");
        let manifest = rogs_orchestrator::manifest::Manifest::load(&self.plan.manifest).ok();
        let max_picture_clips = manifest
            .and_then(|(manifest, _)| manifest.report.clips)
            .unwrap_or(DEFAULT_PICTURE_CLIPS);
        let input = ReportInput {
            run_name: self.plan.name.clone(),
            summary,
            tables,
            clips: self.clips,
            max_picture_clips,
        };
        write_report(&folder, &input).with_context(|| format!("writing the report in `{}`", folder.display()))
    }
}

/// What a method's field on a clip cost: the nodes upstream of its scores.
fn timing(plan: &Plan, score: usize, sheet: &ScoreSheet, costs: &BTreeMap<usize, (f64, u64)>) -> ClipTiming {
    let mut timing = ClipTiming {
        method: sheet.method.clone(),
        setting: sheet.setting.clone(),
        clip_id: sheet.clip_id.clone(),
        device: "cpu".to_owned(),
        ..ClipTiming::default()
    };
    timing.render_query_s = costs.get(&score).map(|(seconds, _)| *seconds);
    let mut peak = costs.get(&score).map(|(_, bytes)| *bytes);
    for upstream in plan.upstream(score) {
        let Some(&(seconds, bytes)) = costs.get(&upstream) else {
            continue;
        };
        match plan.nodes[upstream].stage.as_str() {
            "lift" => timing.lift_s = Some(seconds),
            "refine" => timing.refine_s = Some(seconds),
            _ => continue,
        }
        peak = peak.max(Some(bytes));
    }
    timing.peak_rss_bytes = peak;
    timing
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
