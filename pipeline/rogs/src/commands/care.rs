//! Looking after run folders: `rogs gc`, `rogs diff`, `rogs logs`.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use rogs_orchestrator::diff::diff;
use rogs_orchestrator::gc::collect;
use rogs_orchestrator::logs::{logs, text};

use crate::output;

/// Removes outputs that the plan of a run no longer names, and what killed writers left behind.
#[derive(Debug, clap::Args)]
pub(crate) struct GcArgs {
    /// The run folder.
    run: PathBuf,
    /// Only say what would be removed.
    #[arg(long)]
    dry_run: bool,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run_gc(args: &GcArgs) -> anyhow::Result<ExitCode> {
    let collected = collect(&args.run, args.dry_run)?;
    if args.json {
        output::json(&collected)?;
    } else {
        let mut lines = String::new();
        for file in &collected.files {
            let _ = writeln!(lines, "{}", file.display());
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
        output::text(&lines)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Compares two run folders, or two container files, by content. Exits 1 when they differ.
#[derive(Debug, clap::Args)]
pub(crate) struct DiffArgs {
    /// A run folder or file.
    a: PathBuf,
    /// Another.
    b: PathBuf,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run_diff(args: &DiffArgs) -> anyhow::Result<ExitCode> {
    let difference = diff(&args.a, &args.b)?;
    if args.json {
        output::json(&difference)?;
    } else {
        let mut lines = String::new();
        for output in &difference.different {
            let _ = writeln!(
                lines,
                "differs: {}: {}",
                output.output.display(),
                output.what.join("; ")
            );
        }
        for (files, side) in [(&difference.only_a, &args.a), (&difference.only_b, &args.b)] {
            for file in files {
                let _ = writeln!(lines, "only in {}: {}", side.display(), file.display());
            }
        }
        let _ = writeln!(lines, "{} outputs are the same", difference.same);
        output::text(&lines)?;
    }
    Ok(ExitCode::from(difference.exit().code()))
}

/// What happened to one clip, attempt by attempt.
#[derive(Debug, clap::Args)]
pub(crate) struct LogsArgs {
    /// The run folder.
    run: PathBuf,
    /// The clip, by its id or its episode's.
    clip: String,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run_logs(args: &LogsArgs) -> anyhow::Result<ExitCode> {
    let attempts = logs(&args.run, &args.clip)?;
    if args.json {
        output::json(&attempts)?;
    } else {
        output::text(&attempts.iter().map(text).collect::<Vec<_>>().join("\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}
