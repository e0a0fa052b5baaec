//! The commands, one module each.

mod audit;
mod calibrate;
mod cohort;
mod completions;
mod config;
mod demo;
mod diff;
mod doctor;
mod export;
mod export_clip;
mod export_field;
mod export_moving;
mod film;
mod fk;
mod formats;
mod gc;
mod init;
mod inspect;
mod list;
mod logs;
mod man;
mod metrics;
mod network;
mod plan;
mod query;
mod render;
mod run;
mod scene;
mod schema;
mod status;
mod submit;
mod synth;
mod table;
mod verify;
mod view;
mod viewpoint;
mod weights;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::output::{self, Voice};

/// Turns robot video rollouts into metric 4D Gaussian worlds: plans, runs, resumes, renders and scores.
#[derive(Debug, Parser)]
#[command(name = "rogs", version, arg_required_else_help = true)]
pub(crate) struct CommandLine {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    voice: VoiceArgs,
}

/// How much is told beside results. Results and exit codes are the same.
#[derive(Debug, Clone, Copy, clap::Args)]
struct VoiceArgs {
    /// Say less beside the result: failures and warnings, no progress and no notes.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more beside the result: every unit that starts, and what it says on the way.
    #[arg(short, long, global = true)]
    verbose: bool,
}

impl From<VoiceArgs> for Voice {
    fn from(args: VoiceArgs) -> Self {
        match (args.quiet, args.verbose) {
            (true, _) => Self::Quiet,
            (_, true) => Self::Detailed,
            _ => Self::Usual,
        }
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Args),
    Init(init::Args),
    List(list::Args),
    #[command(visible_alias = "resume")]
    Run(run::Args),
    Plan(plan::Args),
    Submit(submit::Args),
    /// Shows what is done in a run folder, what failed and why, and what is left.
    Status(status::Args),
    Verify(verify::Args),
    Audit(audit::Args),
    Report(table::ReportArgs),
    Logs(logs::Args),
    Diff(diff::Args),
    Gc(gc::Args),
    Table(table::Args),
    Synth(synth::Args),
    Metrics(metrics::Args),
    Calibrate(calibrate::Args),
    Cohort(cohort::Args),
    Weights(weights::Args),
    Render(render::Args),
    Query(query::Args),
    View(view::Args),
    Inspect(inspect::Args),
    Fk(fk::Args),
    Export(export::Args),
    Doctor(doctor::Args),
    Config(config::Args),
    Schema(schema::Args),
    Completions(completions::Args),
    Man(man::Args),
}

/// An error of a stage's library, with its hint.
fn stage_error(error: rogs_worker::StageError) -> anyhow::Error {
    let said = rogs_orchestrator::Error::usage(error.message);
    match error.hint {
        Some(hint) => said.with_hint(hint).into(),
        None => said.into(),
    }
}

pub(crate) fn run(command_line: CommandLine) -> anyhow::Result<ExitCode> {
    output::set_voice(command_line.voice.into());
    match command_line.command {
        Command::Demo(args) => demo::run(&args),
        Command::Init(args) => init::run(&args),
        Command::List(args) => list::run(&args),
        Command::Metrics(args) => metrics::run(&args),
        Command::Calibrate(args) => calibrate::run(&args),
        Command::Cohort(args) => cohort::run(&args),
        Command::Weights(args) => weights::run(args),
        Command::Synth(args) => synth::run(&args),
        Command::Run(args) => run::run(&args),
        Command::Plan(args) => plan::run(&args),
        Command::Submit(args) => submit::run(&args),
        Command::Logs(args) => logs::run(&args),
        Command::Diff(args) => diff::run(&args),
        Command::Gc(args) => gc::run(&args),
        Command::Status(args) => status::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Audit(args) => audit::run(&args),
        Command::Report(args) => table::run_report(&args),
        Command::Table(args) => table::run(&args),
        Command::Query(args) => query::run(&args),
        Command::Render(args) => render::run(&args),
        Command::View(args) => view::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Fk(args) => fk::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Config(args) => config::run(&args),
        Command::Schema(args) => schema::run(&args),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
    }
}
