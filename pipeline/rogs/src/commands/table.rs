//! `rogs table`: a table of the paper over the clips of a run.

use std::path::PathBuf;
use std::process::ExitCode;

use rogs_score::tables::{TableId, TableOptions, to_csv, to_latex, to_text};

use crate::output;
use crate::run_report::RunResults;

/// Prints a table of the paper, made from the scores of a run folder.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run folder.
    run: PathBuf,
    /// Which table: main, joint, robot, robot_stage1, additional, ci, frames_4dgt, scale, fk_transport, recurrence,
    /// latent, latent_resolution, cohort, inputs, timing.
    #[arg(long, default_value = "main", value_parser = table_id)]
    table: TableId,
    /// How to print it.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Print one JSON value (the same as `--format json`).
    #[arg(long)]
    json: bool,
    /// Put the paper's published values beside ours.
    #[arg(long)]
    published: bool,
    /// Give every mean its 95 % bootstrap interval over clips.
    #[arg(long)]
    intervals: bool,
}

/// Forms of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Text,
    Csv,
    Json,
    Latex,
}

fn table_id(name: &str) -> Result<TableId, String> {
    let names: Vec<&str> = TableId::ALL.iter().map(|id| id.name()).collect();
    let found = TableId::ALL.into_iter().find(|id| id.name() == name);
    found.ok_or_else(|| format!("tables are {}", names.join(", ")))
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let options = TableOptions {
        published: args.published,
        intervals: args.intervals,
        hide_empty_rows: !args.published,
    };
    let table = RunResults::read(&args.run)?.table(args.table, options)?;
    match if args.json { Format::Json } else { args.format } {
        Format::Text => output::text(&to_text(&table))?,
        Format::Csv => output::text(&to_csv(&table))?,
        Format::Latex => output::text(&to_latex(&table))?,
        Format::Json => output::json(&table)?,
    }
    Ok(ExitCode::SUCCESS)
}
