//! What helps at the command line: completions, manual pages, the schema of manifests.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context as _;
use clap::CommandFactory as _;
use clap_complete::Shell;
use rogs_orchestrator::editor::manifest_schema;
use rogs_orchestrator::programs::StagePrograms;

use super::CommandLine;
use crate::output;

/// Prints the script that makes a shell complete the commands and options of `rogs`.
///
/// For example `rogs completions bash > ~/.local/share/bash-completion/completions/rogs`, or
/// `rogs completions fish > ~/.config/fish/completions/rogs.fish`; for zsh a file `_rogs` in a folder of `fpath`.
#[derive(Debug, clap::Args)]
pub(crate) struct CompletionsArgs {
    /// The shell.
    shell: Shell,
    /// Print one JSON value: the shell and the script.
    #[arg(long)]
    json: bool,
}

pub(crate) fn completions(args: &CompletionsArgs) -> anyhow::Result<ExitCode> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut CommandLine::command(), "rogs", &mut script);
    let script = String::from_utf8(script).context("the script is no text")?;
    if args.json {
        output::json(&serde_json::json!({ "shell": args.shell.to_string(), "script": script }))?;
    } else {
        output::text(&script)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the manual pages: `rogs.1` and one page a command. Read one with `man -l DIR/rogs.1`.
#[derive(Debug, clap::Args)]
pub(crate) struct ManArgs {
    /// Folder for the pages, such as `~/.local/share/man/man1`; made when missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON value: the files.
    #[arg(long)]
    json: bool,
}

pub(crate) fn man(args: &ManArgs) -> anyhow::Result<ExitCode> {
    let folder = args.out.display();
    std::fs::create_dir_all(&args.out).with_context(|| format!("making `{folder}`"))?;
    let mut command = CommandLine::command();
    command.build();
    let mut files = Vec::new();
    pages(&command, &mut |name, page| {
        let path = args.out.join(format!("{name}.1"));
        rogs_schemas::atomic::write_bytes(&path, page)?;
        files.push(path);
        Ok(())
    })?;
    if args.json {
        output::json(&files)?;
    } else {
        let lines: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
        output::text(&lines.join("\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// A page for the command and one for each command below it.
fn pages(command: &clap::Command, write: &mut dyn FnMut(&str, &[u8]) -> anyhow::Result<()>) -> anyhow::Result<()> {
    let name = command
        .get_display_name()
        .unwrap_or_else(|| command.get_name())
        .to_owned();
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).render(&mut page)?;
    write(&name, &page)?;
    let below = command
        .get_subcommands()
        .filter(|below| below.get_name() != "help" && !below.is_hide_set());
    below.into_iter().try_for_each(|below| pages(below, write))
}

/// JSON schema of manifests, for editors: names, types and meanings of all tables and of the parameters of every stage.
///
/// An editor with TOML support takes it from a first line `#:schema manifest.schema.json` in the manifest.
#[derive(Debug, clap::Args)]
pub(crate) struct SchemaArgs {
    /// What to describe; there is only the manifest.
    #[arg(default_value = "manifest", value_parser = ["manifest"])]
    of: String,
    /// Print JSON (the only form there is; accepted so that every command takes it).
    #[arg(long)]
    json: bool,
}

pub(crate) fn schema(args: &SchemaArgs) -> anyhow::Result<ExitCode> {
    let _ = (&args.of, args.json);
    output::json(&manifest_schema(&StagePrograms::this_program()?)?)?;
    Ok(ExitCode::SUCCESS)
}
