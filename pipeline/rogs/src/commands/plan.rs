//! `rogs plan`: what a run would do and why, without doing it.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use rogs_lift::BUILTIN_SIZE;
use rogs_orchestrator::Prepared;
use rogs_orchestrator::estimate::estimate;
use rogs_orchestrator::export::export;
use rogs_orchestrator::plan::{Node, Plan};
use rogs_orchestrator::quote::shell_line;
use rogs_orchestrator::stage::StageId;
use rogs_weights::BUILTIN;

use super::run::Machine;
use crate::output::{self, Items};

/// Shows what a run would make, how long and how large it will be, and with `--explain` why each output is not up to date.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The manifest (TOML), or a run folder.
    manifest: PathBuf,
    #[command(flatten)]
    machine: Machine,
    /// Say for every output that is not up to date what differs: old and new value.
    #[arg(long)]
    explain: bool,
    /// Explain only this clip.
    #[arg(long, value_name = "CLIP", requires = "explain")]
    clip: Option<String>,
    /// Write the units for other engines (Kubernetes indexed jobs, HyperQueue, Ray, xargs) and print the commands that
    /// run them, one a stage and shard.
    #[arg(long, value_name = "FORM", value_parser = ["jsonl"], conflicts_with = "explain")]
    emit: Option<String>,
    /// Number of shards to cut the clips into.
    #[arg(long, default_value_t = 1, requires = "emit")]
    shards: u32,
    /// Where the units are written; default: `units.jsonl` in the run folder.
    #[arg(long, value_name = "FILE", requires = "emit")]
    units: Option<PathBuf>,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let prepared = args.machine.prepare(&args.manifest)?;
    let plan = &prepared.plan;
    if args.emit.is_some() {
        emit(&prepared, args.shards, args.units.as_deref(), args.json)?;
        return Ok(ExitCode::SUCCESS);
    }
    if args.explain {
        let clips = match &args.clip {
            Some(clip) => vec![plan.find_clip(clip)?],
            None => (0..plan.clips.len()).collect(),
        };
        let explanations: Vec<_> = clips.into_iter().flat_map(|clip| plan.explain_clip(clip)).collect();
        if args.json {
            output::json(&Items { items: explanations })?;
        } else if explanations.is_empty() {
            output::text("everything is up to date")?;
        } else {
            let mut text = String::new();
            for explanation in &explanations {
                let _ = writeln!(text, "{explanation}");
            }
            output::text(&text)?;
        }
        return Ok(ExitCode::SUCCESS);
    }
    let mut estimate = estimate(plan, &prepared.options)?;
    estimate.notes = notes(plan);
    if args.json {
        output::json(&estimate)?;
    } else {
        output::text(&estimate.table())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// What to know of the built-in networks before a run.
fn notes(plan: &Plan) -> Vec<String> {
    let builtin = |node: &&Node| {
        let weights = node.params.get("weights").and_then(serde_json::Value::as_str);
        node.stage == StageId::Lift && weights.is_some_and(|word| word.starts_with(BUILTIN))
    };
    if !plan.nodes.iter().any(|node| builtin(&node)) {
        return Vec::new();
    }
    let mut notes = vec![
        "the built-in networks for robots have seen procedural clips only: on real episodes they are out of distribution"
            .to_owned(),
    ];
    let [height, width] = BUILTIN_SIZE;
    let ingest = plan.nodes.iter().find(|node| node.stage == StageId::Ingest);
    let size = |name: &str| ingest.and_then(|node| node.params.get(name)?.as_u64());
    if let (Some(own_height), Some(own_width)) = (size("height"), size("width"))
        && (own_height, own_width) != (height.into(), width.into())
    {
        notes.push(format!(
            "WARNING: the built-in networks are made for images of {width}x{height} pixels, and clips have \
             {own_width}x{own_height}: expect worse fields; `height = {height}` and `width = {width}` under [ingest]"
        ));
    }
    notes
}

/// Writes the units of a plan to `file` and prints one command a stage and shard.
fn emit(prepared: &Prepared, shards: u32, file: Option<&Path>, json: bool) -> anyhow::Result<()> {
    let default = prepared.plan.run.join("units.jsonl");
    let file = file.unwrap_or(&default);
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let exported = export(&prepared.plan, &prepared.options.programs, shards.max(1), file)?;
    if json {
        return output::json(&exported);
    }
    output::note(&format!("{} units in {}", exported.units, exported.plan.display()));
    let lines: Vec<String> = exported.commands.iter().map(|command| shell_line(command)).collect();
    output::text(&lines.join("\n"))
}
