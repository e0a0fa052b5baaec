//! The program `rogs`: plans, runs and reports the pipeline, and asks its files questions.
//!
//! Results go to standard output, progress and messages to standard error. Exit codes are the table of
//! `rogs_orchestrator::Exit`.

mod commands;
mod output;
mod stages;

use std::ffi::OsString;
use std::io;
use std::process::ExitCode;

use clap::Parser as _;
use rogs_orchestrator::Exit;

fn main() -> ExitCode {
    // A stage inside this program parses its own arguments, so that it is the same program as `rogs-NAME`.
    let arguments: Vec<OsString> = std::env::args_os().collect();
    if arguments.get(1).is_some_and(|word| word == "stage") {
        let Some(name) = arguments.get(2).and_then(|name| name.to_str()) else {
            rogs_worker::message!("usage: rogs stage NAME one|worker|describe ...");
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
            ExitCode::from(exit_of(&error).code())
        }
    }
}

/// The exit code of an error. What the orchestrator did not say is a wrong request, unless the machine refused.
fn exit_of(error: &anyhow::Error) -> Exit {
    if let Some(known) = error.downcast_ref::<rogs_orchestrator::Error>() {
        return known.exit();
    }
    if error.is::<output::CannotPrint>() {
        return Exit::Environment;
    }
    let refused = |error: &io::Error| {
        use io::ErrorKind::{
            FileTooLarge, OutOfMemory, PermissionDenied, QuotaExceeded, ReadOnlyFilesystem, StorageFull,
        };
        let kinds = [
            FileTooLarge,
            OutOfMemory,
            PermissionDenied,
            QuotaExceeded,
            ReadOnlyFilesystem,
            StorageFull,
        ];
        kinds.contains(&error.kind())
    };
    let refused = error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<io::Error>())
        .any(refused);
    if refused { Exit::Environment } else { Exit::Usage }
}
