//! `rogs submit`: handing a run to Slurm.

use std::path::PathBuf;
use std::process::ExitCode;

use rogs_orchestrator::quote::shell_word;
use rogs_orchestrator::slurm::submit;

use super::run::Machine;
use crate::output;

/// Submits what is not up to date to Slurm: one job array a stage, elements of a shard after each other, then the report.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The manifest (TOML), or a run folder.
    manifest: PathBuf,
    #[command(flatten)]
    machine: Machine,
    /// Print the job scripts and `sbatch` calls and touch nothing.
    #[arg(long)]
    dry_run: bool,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let prepared = args.machine.prepare(&args.manifest)?;
    let program = std::env::current_exe()?.display().to_string();
    let finally = [program, "report".to_owned(), prepared.plan.run.display().to_string()];
    let submission = submit(&prepared, Some(&finally), args.dry_run)?;
    if args.json {
        output::json(&submission)?;
    } else if args.dry_run || submission.scripts.is_empty() {
        output::text(&submission.text())?;
    } else {
        output::after_work(output::text(&format!("submitted: {}", submission.ids.join(", "))))?;
        output::note(&format!(
            "rogs status {} shows the progress",
            shell_word(&prepared.plan.run.display().to_string())
        ));
    }
    Ok(ExitCode::SUCCESS)
}
