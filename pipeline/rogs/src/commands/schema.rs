//! `rogs schema`: what a manifest may say, for editors.

use std::process::ExitCode;

use rogs_orchestrator::editor::manifest_schema;
use rogs_orchestrator::programs::StagePrograms;

use crate::output;

/// Prints the JSON schema of manifests, for editors: names, types and meanings of all tables and stage parameters.
///
/// An editor with TOML support takes it from a first line `#:schema manifest.schema.json` in the manifest.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// What to describe; there is only the manifest.
    #[arg(default_value = "manifest", value_parser = ["manifest"])]
    of: String,
    /// Print JSON (the only form there is; accepted so that every command takes it).
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let _ = (&args.of, args.json);
    output::json(&manifest_schema(&StagePrograms::this_program()?)?)?;
    Ok(ExitCode::SUCCESS)
}
