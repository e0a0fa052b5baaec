//! `rogs logs`: the story of one clip.

use std::path::PathBuf;
use std::process::ExitCode;

use rogs_orchestrator::logs::{logs, text};

use crate::output::{self, Items};

/// Shows what happened to one clip, attempt by attempt.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run folder.
    run: PathBuf,
    /// The clip, by its id or its episode's.
    clip: String,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let attempts = logs(&args.run, &args.clip)?;
    if args.json {
        output::json(&Items { items: attempts })?;
    } else {
        output::text(&attempts.iter().map(text).collect::<Vec<_>>().join("\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}
