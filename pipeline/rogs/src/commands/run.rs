//! `rogs run`: plan, run what is not up to date, report.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use rogs_orchestrator::executor::{RunOptions, RunSummary};
use rogs_orchestrator::manifest::MOST_WORKERS;
use rogs_orchestrator::programs::StagePrograms;
use rogs_orchestrator::quote::shell_word;
use rogs_orchestrator::{Exit, Interrupts, Prepared};
use rogs_report::write_report;
use rogs_schemas::protocol::MOST_THREADS;
use rogs_schemas::shown;
use schemars::JsonSchema;
use serde::Serialize;

use crate::output;

/// Runs a manifest, or resumes a run folder: makes every output that is missing or stale, then the report.
///
/// It may be killed at any moment; the same command resumes and ends with the same bytes.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The manifest (TOML), or a run folder.
    manifest: PathBuf,
    #[command(flatten)]
    machine: Machine,
    /// Run only these clips.
    #[arg(long, value_name = "CLIP")]
    only: Vec<String>,
    /// Make no report.
    #[arg(long)]
    no_report: bool,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// How the work is spread over this machine; nothing here changes a result.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct Machine {
    /// Worker processes at a time.
    #[arg(long, value_parser = at_most::<MOST_WORKERS>)]
    pub(crate) workers: Option<usize>,
    /// Threads of each worker.
    #[arg(long, value_parser = at_most::<MOST_THREADS>)]
    pub(crate) threads: Option<usize>,
    /// Folder with programs `rogs-STAGE` to use instead of the stages inside this program.
    #[arg(long, value_name = "DIR")]
    pub(crate) programs: Option<PathBuf>,
}

/// Reads a count that this machine can have.
fn at_most<const MOST: usize>(text: &str) -> Result<usize, String> {
    let count = text.parse().ok().filter(|count| (1..=MOST).contains(count));
    count.ok_or_else(|| format!("expected 1 to {MOST}"))
}

/// What a finished run prints as JSON.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct RunOutcome {
    #[serde(flatten)]
    pub(crate) summary: RunSummary,
    /// The report's page.
    pub(crate) report: Option<PathBuf>,
}

impl Machine {
    /// A plan with the command line's wishes laid over the manifest's.
    pub(crate) fn prepare(&self, manifest: &Path) -> rogs_orchestrator::Result<Prepared> {
        let programs = self.stage_programs()?;
        let mut prepared = Prepared::load(manifest, programs)?;
        self.lay_over(&mut prepared.options);
        Ok(prepared)
    }

    /// Where the stage programs are, unless the manifest says.
    pub(crate) fn stage_programs(&self) -> rogs_orchestrator::Result<StagePrograms> {
        match &self.programs {
            Some(folder) => Ok(StagePrograms::Directory(folder.clone())),
            None => StagePrograms::this_program(),
        }
    }

    /// The command line's wishes over the manifest's.
    pub(crate) fn lay_over(&self, options: &mut RunOptions) {
        if let Some(folder) = &self.programs {
            options.programs = StagePrograms::Directory(folder.clone());
        }
        options.progress = output::progress();
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        match (self.workers, self.threads) {
            (Some(workers), Some(threads)) => (options.workers, options.threads) = (workers, threads),
            (Some(workers), None) => {
                options.workers = workers;
                options.threads = (cores / options.workers).max(1);
            }
            (None, Some(threads)) => {
                options.threads = threads;
                options.workers = (cores / options.threads).max(1);
            }
            (None, None) => {}
        }
    }

    /// The keys of a manifest that the command line gives.
    pub(crate) fn given(&self) -> Vec<&'static str> {
        let given = [
            ("executor.workers", self.workers.is_some()),
            ("executor.threads", self.threads.is_some()),
            ("executor.programs", self.programs.is_some()),
        ];
        given
            .into_iter()
            .filter_map(|(key, given)| given.then_some(key))
            .collect()
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let mut prepared = args.machine.prepare(&args.manifest)?;
    if !args.only.is_empty() {
        let clips: rogs_orchestrator::Result<Vec<usize>> =
            args.only.iter().map(|clip| prepared.plan.find_clip(clip)).collect();
        prepared.options.only = Some(clips?);
    }
    let outcome = execute(&mut prepared, !args.no_report)?;
    output::after_work(if args.json {
        output::json(&outcome)
    } else {
        output::text(&describe(&outcome))
    })?;
    if outcome.summary.exit == Exit::Stopped {
        output::note(&format!(
            "stopped; finished outputs are kept. Resume with: rogs run {}",
            shell_word(&args.manifest.display().to_string())
        ));
    }
    Ok(ExitCode::from(outcome.summary.exit.code()))
}

/// Runs a plan and makes its report.
pub(crate) fn execute(prepared: &mut Prepared, report: bool) -> anyhow::Result<RunOutcome> {
    prepared.options.interrupts = Interrupts::install()?;
    let summary = prepared.run()?;
    let report = report.then(|| write_report(&summary.run)).transpose();
    let report = report.map_err(rogs_orchestrator::Error::after_start)?;
    Ok(RunOutcome { summary, report })
}

/// The outcome for people.
pub(crate) fn describe(outcome: &RunOutcome) -> String {
    use std::fmt::Write as _;
    let RunOutcome { summary, report } = outcome;
    let (units, clips) = (&summary.units, &summary.clips);
    let mut text = String::new();
    for failure in &summary.failures {
        let _ = writeln!(
            text,
            "failed: {} at {}: {}",
            failure.clip,
            failure.node,
            shown::line(&failure.message)
        );
        if let Some(hint) = &failure.hint {
            let _ = writeln!(text, "  hint: {}", shown::line(hint));
        }
    }
    let _ = writeln!(
        text,
        "{}: {} of {} clips done, {} failed; {} units made, {} were up to date, {} failed, {} blocked, {} left; {:.1} s",
        summary.name,
        clips.done,
        clips.total,
        clips.failed,
        units.made,
        units.up_to_date,
        units.failed,
        units.blocked,
        units.left,
        summary.seconds
    );
    if let Some(report) = report {
        let _ = writeln!(text, "report: {}", report.display());
    }
    text
}
