//! `rogs gc`: what no plan names any more.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use rogs_orchestrator::gc::collect;
use rogs_schemas::shown;

use crate::output;

/// Removes outputs that the plan of a run no longer names, and what killed writers left behind.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run folder.
    run: PathBuf,
    /// Only say what would be removed.
    #[arg(long)]
    dry_run: bool,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let collected = collect(&args.run, args.dry_run)?;
    if args.json {
        output::json(&collected)?;
    } else {
        let mut lines = String::new();
        for file in &collected.files {
            let _ = writeln!(lines, "{}", shown::line(&file.to_string_lossy()));
        }
        let what = if collected.dry_run {
            "would be removed"
        } else {
            "removed"
        };
        let _ = writeln!(
            lines,
            "{} files, {} bytes {what}",
            collected.files.len(),
            collected.bytes
        );
        output::after_work(output::text(&lines))?;
    }
    Ok(ExitCode::SUCCESS)
}
