//! The commands, one module each.

mod care;
mod cohort;
mod demo;
mod doctor;
mod engines;
mod fk;
mod inspect;
mod metrics;
mod plan;
mod query;
mod render;
mod run;
mod shell;
mod status;
mod synth;
mod table;
mod weights;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Turns robot video rollouts into metric 4D Gaussian worlds: plans, runs, resumes, renders and scores.
#[derive(Debug, Parser)]
#[command(name = "rogs", version, arg_required_else_help = true)]
pub(crate) struct CommandLine {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Args),
    #[command(visible_alias = "resume")]
    Run(run::Args),
    Plan(plan::Args),
    Submit(engines::SubmitArgs),
    /// What is done in a run folder, what failed and why, what is left.
    Status(status::Args),
    /// Reads every output of a run folder completely and checks it against the plan.
    Verify(status::Args),
    Report(table::ReportArgs),
    Logs(care::LogsArgs),
    Diff(care::DiffArgs),
    Gc(care::GcArgs),
    Table(table::Args),
    Synth(synth::Args),
    Metrics(metrics::Args),
    Cohort(cohort::Args),
    Weights(weights::Args),
    Render(render::Args),
    Query(query::Args),
    Inspect(inspect::Args),
    Fk(fk::Args),
    Doctor(doctor::Args),
    Schema(shell::SchemaArgs),
    Completions(shell::CompletionsArgs),
    Man(shell::ManArgs),
}

pub(crate) fn run(command_line: CommandLine) -> anyhow::Result<ExitCode> {
    match command_line.command {
        Command::Demo(args) => demo::run(&args),
        Command::Metrics(args) => metrics::run(&args),
        Command::Cohort(args) => cohort::run(&args),
        Command::Weights(args) => weights::run(args),
        Command::Synth(args) => synth::run(&args),
        Command::Run(args) => run::run(&args),
        Command::Plan(args) => plan::run(&args),
        Command::Submit(args) => engines::run_submit(&args),
        Command::Logs(args) => care::run_logs(&args),
        Command::Diff(args) => care::run_diff(&args),
        Command::Gc(args) => care::run_gc(&args),
        Command::Status(args) => status::show_status(&args),
        Command::Verify(args) => status::show_verify(&args),
        Command::Report(args) => table::run_report(&args),
        Command::Table(args) => table::run(&args),
        Command::Query(args) => query::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Fk(args) => fk::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Schema(args) => shell::schema(&args),
        Command::Completions(args) => shell::completions(&args),
        Command::Man(args) => shell::man(&args),
    }
}
