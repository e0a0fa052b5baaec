//! `rogs demo`: procedural episodes through every stage, on any machine, without any data.

use std::path::PathBuf;
use std::process::ExitCode;

use rogs_report::{Form, RunResults};
use rogs_score::tables::{Table, TableId, TableOptions};
use schemars::JsonSchema;
use serde::Serialize;

use super::run::{Machine, RunOutcome, describe, execute};
use super::synth;
use crate::output;

/// Makes procedural episodes, runs every stage on them, prints the score table and the report's path.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for episodes, run and report; a second demo in it only does what is missing.
    #[arg(long, value_name = "DIR", default_value = "rogs-demo")]
    out: PathBuf,
    /// Number of episodes.
    #[arg(long, default_value_t = 2)]
    episodes: u32,
    /// Seed of the first episode.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    machine: Machine,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// What the demo prints as JSON.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct DemoOutcome {
    #[serde(flatten)]
    outcome: RunOutcome,
    /// The manifest that was run.
    manifest: PathBuf,
    /// The main score table.
    table: Table,
}

/// Frames of an episode.
const FRAMES: u32 = 33;
/// Height and width of its images: those that the built-in checkpoint was trained on.
const SIZE: [u32; 2] = [84, 154];

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    output::note(&format!(
        "making {} procedural episodes in `{}`",
        args.episodes,
        args.out.display()
    ));
    let (_, manifest) = synth::make(
        &args.out,
        "demo",
        args.episodes,
        args.seed,
        &synth::config(FRAMES, SIZE),
    )?;
    let mut prepared = args.machine.prepare(&manifest)?;
    let outcome = execute(&mut prepared, true)?;
    let options = TableOptions {
        hide_empty_rows: true,
        ..TableOptions::default()
    };
    let table = RunResults::read(&outcome.summary.run)?.table(TableId::Main, None, options)?;
    let code = outcome.summary.exit.code();
    output::after_work(if args.json {
        output::json(&DemoOutcome {
            outcome,
            manifest,
            table,
        })
    } else {
        output::text(&Form::Text.print(&table)?).and_then(|()| output::text(&describe(&outcome)))
    })?;
    Ok(ExitCode::from(code))
}
