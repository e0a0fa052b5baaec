//! `rogs status`, `rogs report`: questions to a run folder.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use rogs_orchestrator::status::status;
use rogs_report::write_report;
use schemars::JsonSchema;
use serde::Serialize;

use crate::output;

/// A run folder to look at.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run folder.
    pub(super) run: PathBuf,
    /// Print one JSON value.
    #[arg(long)]
    pub(super) json: bool,
}

/// What is done, what failed and why, what is left.
pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let status = status(&args.run)?;
    output::after_work(if args.json {
        output::json(&status)
    } else {
        output::text(&status.table())
    })?;
    Ok(ExitCode::from(status.exit.code()))
}

/// What the making of a report prints as JSON.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Report {
    /// The page.
    report: PathBuf,
}

/// Makes the report of a run folder anew.
pub(crate) fn make_report(run: &Path, json: bool) -> anyhow::Result<ExitCode> {
    let report = write_report(run)?;
    if json {
        output::json(&Report { report })?;
    } else {
        output::text(&format!("report: {}", report.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}
