//! `rogs verify`: every byte of the outputs of a run.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use rogs_orchestrator::verify::{Verification, remove_bad, verify};
use rogs_schemas::shown;
use schemars::JsonSchema;
use serde::Serialize;

use super::run::{Machine, RunOutcome, describe, execute};
use crate::output;

/// Reads every output of a run folder completely and checks it against the plan.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run folder.
    run: PathBuf,
    /// Remove what is wrong and make it again, as `rogs run` does.
    #[arg(long)]
    repair: bool,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// What is printed as JSON.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Verified {
    /// What was found; a repair removed what was bad.
    #[serde(flatten)]
    found: Verification,
    /// The run that made it again; absent where nothing was bad or nothing was to be repaired.
    #[serde(skip_serializing_if = "Option::is_none")]
    made_again: Option<RunOutcome>,
}

/// Reads every output completely and checks it against the plan.
pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if args.repair {
        return repair(args);
    }
    let found = verify(&args.run)?;
    let exit = found.exit();
    output::after_work(if args.json {
        let made_again = None;
        output::json(&Verified { found, made_again })
    } else {
        output::text(&text(&found))
    })?;
    Ok(ExitCode::from(exit.code()))
}

/// Removes what is wrong and makes it again.
fn repair(args: &Args) -> anyhow::Result<ExitCode> {
    // First of all whether it can be made again.
    let mut prepared = Machine::default().prepare(&args.run)?;
    let found = remove_bad(&args.run)?;
    let made_again = match found.bad.is_empty() {
        true => None,
        false => Some(execute(&mut prepared, true)?),
    };
    let exit = made_again.as_ref().map_or(found.exit(), |outcome| outcome.summary.exit);
    let printed = if args.json {
        output::json(&Verified { found, made_again })
    } else {
        let again = made_again.as_ref().map(describe).unwrap_or_default();
        output::text(&format!("{}{again}", text(&found)))
    };
    output::after_work(printed)?;
    Ok(ExitCode::from(exit.code()))
}

fn text(found: &Verification) -> String {
    let mut text = format!(
        "{} outputs are good, {} missing, {} bad\n",
        found.good,
        found.missing,
        found.bad.len()
    );
    for bad in &found.bad {
        let _ = writeln!(text, "bad: {}: {}", bad.output.display(), shown::line(&bad.what));
    }
    text
}
