//! `rogs diff`: two runs side by side.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use rogs_orchestrator::diff::diff;
use rogs_schemas::shown;

use crate::output;

/// Compares two run folders, or two container files, by content. Exits 1 when they differ.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A run folder or file.
    a: PathBuf,
    /// Another.
    b: PathBuf,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
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
                shown::line(&output.what.join("; "))
            );
        }
        for (files, side) in [(&difference.only_a, &args.a), (&difference.only_b, &args.b)] {
            for file in files {
                let _ = writeln!(lines, "only in {}: {}", side.display(), file.display());
            }
        }
        let _ = writeln!(lines, "{} outputs are the same", difference.same);
        output::after_work(output::text(&lines))?;
    }
    Ok(ExitCode::from(difference.exit().code()))
}
