//! The program `rogs`: plans, runs and reports the pipeline, and asks its files questions.
//!
//! Results go to standard output, progress and messages to standard error. Exit codes are the table of
//! `rogs_orchestrator::Exit`.

mod commands;
mod output;
mod run_report;
mod stages;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::Parser as _;

fn main() -> ExitCode {
    // A stage inside this program parses its own arguments, so that it is the same program as `rogs-NAME`.
    let arguments: Vec<OsString> = std::env::args_os().collect();
    if arguments.get(1).is_some_and(|word| word == "stage") {
        let Some(name) = arguments.get(2).and_then(|name| name.to_str()) else {
            eprintln!("usage: rogs stage NAME one|worker|describe ...");
            return ExitCode::from(2);
        };
        return stages::run(name, arguments[3..].to_vec());
    }
    let command_line = commands::CommandLine::parse();
    match commands::run(command_line) {
        Ok(code) => code,
        Err(error) if output::is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            output::error(&error);
            let known = error.downcast_ref::<rogs_orchestrator::Error>();
            ExitCode::from(known.map_or(2, |error| error.exit().code()))
        }
    }
}
