//! `rogs status`, `rogs report`: questions to a run folder.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use rogs_orchestrator::status::status;
use rogs_report::write_report;

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
    if args.json {
        output::json(&status)?;
        return Ok(ExitCode::from(status.exit.code()));
    }
    let clips = &status.clips;
    let mut text = format!(
        "{}{}: {} of {} clips done, {} failed\n",
        status.name,
        if status.active { " (running)" } else { "" },
        clips.done,
        clips.total,
        clips.failed
    );
    for node in &status.nodes {
        let _ = writeln!(
            text,
            "  {:<24} {:>7} done {:>7} to do {:>5} failed {:>5} blocked",
            node.node, node.done, node.todo, node.failed, node.blocked
        );
    }
    for failure in &status.failures {
        let _ = writeln!(
            text,
            "failed: {} at {}: {}",
            failure.clip, failure.node, failure.failure.message
        );
        if let Some(hint) = &failure.failure.hint {
            let _ = writeln!(text, "  hint: {hint}");
        }
    }
    output::text(&text)?;
    Ok(ExitCode::from(status.exit.code()))
}

/// Makes the report of a run folder anew.
pub(crate) fn make_report(run: &Path, json: bool) -> anyhow::Result<ExitCode> {
    let report = write_report(run)?;
    if json {
        output::json(&serde_json::json!({ "report": report }))?;
    } else {
        output::text(&format!("report: {}", report.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}
