//! `rogs completions`: scripts with which shells complete commands and options.

use std::process::ExitCode;

use anyhow::Context as _;
use clap::CommandFactory as _;
use clap_complete::Shell;
use schemars::JsonSchema;
use serde::Serialize;

use super::CommandLine;
use crate::output;

/// Prints the script that makes a shell complete the commands and options of `rogs`.
///
/// For example `rogs completions bash > ~/.local/share/bash-completion/completions/rogs`, or
/// `rogs completions fish > ~/.config/fish/completions/rogs.fish`; for zsh a file `_rogs` in a folder of `fpath`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The shell.
    shell: Shell,
    /// Print one JSON value: the shell and the script.
    #[arg(long)]
    json: bool,
}

/// What is printed as JSON.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Script {
    /// The shell.
    shell: String,
    /// What it reads.
    script: String,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut CommandLine::command(), "rogs", &mut script);
    let script = String::from_utf8(script).context("the script is not UTF-8")?;
    if args.json {
        output::json(&Script {
            shell: args.shell.to_string(),
            script,
        })?;
    } else {
        output::text(&script)?;
    }
    Ok(ExitCode::SUCCESS)
}
