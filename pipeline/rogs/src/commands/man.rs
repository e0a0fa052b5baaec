//! `rogs man`: manual pages.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context as _;
use clap::CommandFactory as _;
use schemars::JsonSchema;
use serde::Serialize;

use super::CommandLine;
use crate::output;

/// Writes the manual pages: `rogs.1` and one page a command. Read one with `man -l DIR/rogs.1`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for the pages, such as `~/.local/share/man/man1`; made when missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON value: the files.
    #[arg(long)]
    json: bool,
}

/// What is printed as JSON.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Pages {
    /// The pages written.
    files: Vec<PathBuf>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let folder = args.out.display();
    std::fs::create_dir_all(&args.out).with_context(|| format!("making `{folder}`"))?;
    let mut command = CommandLine::command();
    command.build();
    let mut files = Vec::new();
    pages(&command, &mut |name, page| {
        let path = args.out.join(format!("{name}.1"));
        rogs_files::write_bytes(&path, page)?;
        files.push(path);
        Ok(())
    })?;
    if args.json {
        output::json(&Pages { files })?;
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
