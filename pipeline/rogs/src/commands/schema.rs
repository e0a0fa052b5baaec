//! `rogs schema`: what a manifest may say, and what commands print as JSON.

use std::process::ExitCode;

use rogs_orchestrator::Error;
use rogs_orchestrator::editor::manifest_schema;
use rogs_orchestrator::programs::StagePrograms;
use rogs_schemas::ids::did_you_mean;

use super::formats::{FORMATS, Named, schema_of};
use crate::output::{self, Items};

/// Prints a JSON schema: that of manifests, for editors, or that of what a command prints with `--json`.
///
/// Without a name it lists them. An editor with TOML support takes the schema of manifests, `rogs schema manifest`, from a
/// first line `#:schema manifest.schema.json` in the manifest. JSON outputs say theirs in the entry `format`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// What to describe: `manifest`, or an output such as `status`, `rogs.status` or `rogs.status/1`.
    name: Option<String>,
    /// Print one JSON value; a schema is one in any case.
    #[arg(long)]
    json: bool,
}

/// What manifests are called here.
const MANIFEST: &str = "manifest";

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    match args.name.as_deref() {
        None => list(args.json)?,
        Some(MANIFEST) => output::schema(&manifest_schema(&StagePrograms::this_program()?)?)?,
        Some(name) => match schema_of(name) {
            Some(schema) => output::schema(&schema)?,
            None => return Err(unknown(name)),
        },
    }
    Ok(ExitCode::SUCCESS)
}

fn list(json: bool) -> anyhow::Result<()> {
    let manifest = Named {
        name: MANIFEST,
        format: None,
        command: "the file that `rogs plan` and `rogs run` take",
    };
    let items: Vec<Named> = std::iter::once(manifest).chain(FORMATS.iter().map(Named::of)).collect();
    if json {
        return output::json(&Items { items });
    }
    let width = items.iter().map(|item| item.name.len()).max().unwrap_or(0);
    let line = |item: &Named| format!("{:<width$}  {}", item.name, item.command);
    output::text(&items.iter().map(line).collect::<Vec<_>>().join("\n"))
}

fn unknown(name: &str) -> anyhow::Error {
    let names = std::iter::once(MANIFEST).chain(FORMATS.iter().map(|entry| entry.name));
    let hint = match did_you_mean(name, names) {
        Some(near) => format!("did you mean `{near}`? `rogs schema` lists all"),
        None => "`rogs schema` lists what has one".to_owned(),
    };
    Error::usage(format!("there is no schema `{name}`"))
        .with_hint(hint)
        .into()
}
