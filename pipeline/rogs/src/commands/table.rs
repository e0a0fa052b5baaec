//! `rogs table` and `rogs report --table`: a table of the paper over the clips of a run.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use rogs_report::{Form, RunResults};
use rogs_score::cohort::{CohortCounts, Selection};
use rogs_score::tables::{TableId, TableOptions};

use crate::output;

/// Prints a table of the paper, made from the scores of run folders.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run folder; of several, the scores are taken together, as of recordings and of rollouts.
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// Which table.
    #[arg(long, default_value = TableId::Main.name(), value_parser = table_id())]
    table: TableId,
    #[command(flatten)]
    print: Print,
}

/// Makes the report of a run folder anew; with --table, prints that table instead (the same as `rogs table`).
#[derive(Debug, clap::Args)]
pub(crate) struct ReportArgs {
    /// The run folder.
    run: PathBuf,
    /// Print this table of the paper instead of writing the page.
    #[arg(long, value_parser = table_id())]
    table: Option<TableId>,
    #[command(flatten)]
    print: Print,
}

/// How tables are printed.
#[derive(Debug, clap::Args)]
struct Print {
    /// How to print the table.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Print one JSON value (of a table the same as `--format json`).
    #[arg(long)]
    json: bool,
    /// Put the paper's published values beside ours.
    #[arg(long)]
    published: bool,
    /// Give every mean its 95 % bootstrap interval over clips.
    #[arg(long)]
    intervals: bool,
    /// The selection that `rogs cohort` wrote, for the table `cohort`.
    #[arg(long, value_name = "FILE")]
    selection: Option<PathBuf>,
}

/// Forms of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Text,
    Csv,
    Json,
    Latex,
}

/// Reads the name of a table; the help lists them.
fn table_id() -> impl TypedValueParser<Value = TableId> {
    PossibleValuesParser::new(TableId::ALL.map(TableId::name)).try_map(|name| name.parse::<TableId>())
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    print(&args.runs, args.table, &args.print)
}

pub(crate) fn run_report(args: &ReportArgs) -> anyhow::Result<ExitCode> {
    match args.table {
        Some(table) => print(std::slice::from_ref(&args.run), table, &args.print),
        None => super::status::make_report(&args.run, args.print.json),
    }
}

fn print(runs: &[PathBuf], id: TableId, print: &Print) -> anyhow::Result<ExitCode> {
    let options = TableOptions {
        published: print.published,
        intervals: print.intervals,
        hide_empty_rows: !print.published,
    };
    let counts = print.selection.as_deref().map(selection_counts).transpose()?;
    let table = results(runs)?.table(id, counts.as_ref(), options)?;
    let form = match print.format {
        Format::Json => return output::json(&table).map(|()| ExitCode::SUCCESS),
        _ if print.json => return output::json(&table).map(|()| ExitCode::SUCCESS),
        Format::Text => Form::Text,
        Format::Csv => Form::Csv,
        Format::Latex => Form::Latex,
    };
    output::text(&form.print(&table)?)?;
    Ok(ExitCode::SUCCESS)
}

/// The results of all runs together.
fn results(runs: &[PathBuf]) -> anyhow::Result<RunResults> {
    let mut runs = runs.iter();
    let first = runs.next().context("name a run folder")?;
    let mut results = RunResults::read(first)?;
    for run in runs {
        results.add(RunResults::read(run)?);
    }
    Ok(results)
}

/// The counts in a `selection.json`.
fn selection_counts(path: &Path) -> anyhow::Result<CohortCounts> {
    let text = rogs_files::read(path).with_context(|| format!("reading `{}`", path.display()))?;
    let selection: Selection = serde_json::from_slice(&text)
        .with_context(|| format!("`{}` is not a selection of `rogs cohort`", path.display()))?;
    Ok(selection.counts)
}
