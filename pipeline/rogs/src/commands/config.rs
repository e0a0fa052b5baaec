//! `rogs config show`: every value that a run works with, and where it comes from.

use std::path::PathBuf;
use std::process::ExitCode;

use rogs_orchestrator::colour;
use rogs_orchestrator::effective::{EffectiveValue, effective, variable};
use rogs_orchestrator::executor::RunOptions;
use rogs_orchestrator::manifest::Manifest;
use rogs_orchestrator::programs::StagePrograms;
use rogs_robot_files::SEARCH_VARIABLES;
use schemars::JsonSchema;
use serde::Serialize;

use super::run::Machine;
use crate::output;

/// Shows what a manifest comes to.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Show(Show),
}

/// Shows every value that a run works with and where it comes from: a line of the manifest, the robot's preset, a default,
/// this machine, the command line, the environment.
#[derive(Debug, clap::Args)]
pub(crate) struct Show {
    /// The manifest (TOML). Its data need not be there.
    manifest: PathBuf,
    #[command(flatten)]
    machine: Machine,
    /// Show only keys that begin like this, such as `ingest`.
    #[arg(long, value_name = "KEY")]
    only: Option<String>,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// What is printed as JSON.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Shown {
    /// The manifest.
    manifest: PathBuf,
    /// The values, by the tables of the manifest; then what the environment says.
    values: Vec<EffectiveValue>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let What::Show(args) = &args.what;
    let (manifest, text) = Manifest::load(&args.manifest)?;
    let programs = args.machine.stage_programs()?;
    let own = manifest.executor.programs.clone();
    let programs = own.map_or(programs, StagePrograms::Directory);
    let mut options = RunOptions::of(&manifest, programs);
    args.machine.lay_over(&mut options);
    let mut values = effective(&manifest, &text, &options.programs, &options, &args.machine.given())?;
    values.extend(
        colour::VARIABLES
            .into_iter()
            .chain(SEARCH_VARIABLES)
            .filter_map(variable),
    );
    if let Some(only) = &args.only {
        values.retain(|value| value.key.starts_with(only.as_str()));
    }
    if args.json {
        output::json(&Shown {
            manifest: args.manifest.clone(),
            values,
        })?;
        return Ok(ExitCode::SUCCESS);
    }
    let line = |value: &EffectiveValue| (format!("{} = {}", value.key, value.shown()), value.whence());
    let lines: Vec<(String, String)> = values.iter().map(line).collect();
    let widths = lines.iter().map(|(text, _)| text.chars().count());
    let width = widths.filter(|&width| width <= WIDEST).max().unwrap_or(0);
    let lines = lines.iter().map(|(text, whence)| format!("{text:<width$}  # {whence}"));
    output::text(&lines.collect::<Vec<_>>().join("\n"))?;
    Ok(ExitCode::SUCCESS)
}

/// Origins stand below each other behind values up to this width.
const WIDEST: usize = 64;
