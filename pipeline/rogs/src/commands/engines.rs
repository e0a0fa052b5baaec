//! Handing work to other engines: `rogs submit` (Slurm) and `rogs plan --emit jsonl`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use rogs_orchestrator::Prepared;
use rogs_orchestrator::export::{export, shell_line};
use rogs_orchestrator::slurm::submit;

use super::run::Machine;
use crate::output;

/// Submits what is not up to date to Slurm: one job array a stage, elements of a shard after each other, then the report.
#[derive(Debug, clap::Args)]
pub(crate) struct SubmitArgs {
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

pub(crate) fn run_submit(args: &SubmitArgs) -> anyhow::Result<ExitCode> {
    let prepared = args.machine.prepare(&args.manifest)?;
    let program = std::env::current_exe()?.display().to_string();
    let finally = [program, "report".to_owned(), prepared.plan.run.display().to_string()];
    let submission = submit(&prepared, Some(&finally), args.dry_run)?;
    if args.json {
        output::json(&submission)?;
    } else if args.dry_run {
        output::text(&submission.text())?;
    } else {
        output::text(&format!("submitted: {}", submission.ids.join(", ")))?;
        output::note(&format!(
            "rogs status {} tells how far it is",
            prepared.plan.run.display()
        ));
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the units of a plan to `file` and prints one command a stage and shard.
pub(crate) fn emit(prepared: &Prepared, shards: u32, file: Option<&Path>, json: bool) -> anyhow::Result<()> {
    let default = prepared.plan.run.join("units.jsonl");
    let file = file.unwrap_or(&default);
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let exported = export(&prepared.plan, &prepared.options.programs, shards.max(1), file)?;
    if json {
        return output::json(&exported);
    }
    output::note(&format!("{} units in {}", exported.units, exported.plan.display()));
    let lines: Vec<String> = exported.commands.iter().map(|command| shell_line(command)).collect();
    output::text(&lines.join("\n"))
}
