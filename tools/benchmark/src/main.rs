//! `rogs-benchmark`: how good the built-in weights are on real rooms, in real robot cells and on procedural clips.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "the program's own file is the one place that prints")]

mod cell;
mod page;
mod part;
mod plane;
mod procedural;
mod rooms;
mod run;
mod table;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use clap::Parser;

use part::Part;

/// Lifts the clips of the benchmark and prints what they score, as a page in Markdown.
///
/// Data of others lies beside the checkout in `shared/data`; a part without its data is left out, and the page says so.
/// Runs are resumed: what is up to date is not made again.
#[derive(Debug, Parser)]
#[command(name = "rogs-benchmark", version)]
struct Args {
    /// Which parts; all of them where none is named.
    #[arg(value_enum)]
    parts: Vec<Part>,
    /// The checkout whose manifests are run.
    #[arg(long, value_name = "DIR", default_value = ".")]
    checkout: PathBuf,
    /// The program `rogs`. Default: the one beside this program.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Write the page to this file instead of printing it.
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// Measure runs that are there; make nothing.
    #[arg(long)]
    measure: bool,
}

fn main() -> ExitCode {
    match benchmark(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn benchmark(args: &Args) -> anyhow::Result<()> {
    let folder = args.checkout.join(part::MANIFESTS);
    if !folder.is_dir() {
        bail!(
            "`{}` is missing: name the checkout with `--checkout DIR`",
            folder.display()
        );
    }
    let program = match &args.program {
        Some(program) => program.clone(),
        None => std::env::current_exe()
            .context("finding the program")?
            .with_file_name(format!("rogs{}", std::env::consts::EXE_SUFFIX)),
    };
    if !args.measure && !program.is_file() {
        bail!(
            "`{}` is missing: build it with `cargo build --release --bin rogs`, or name it with `--program FILE`",
            program.display()
        );
    }
    let parts = if args.parts.is_empty() {
        Part::ALL.to_vec()
    } else {
        args.parts.clone()
    };
    let mut sections = Vec::new();
    for part in parts {
        let found = match part.missing(&args.checkout) {
            Some(missing) => Err(format!("`{}` is not there", missing.display())),
            None => {
                if !args.measure {
                    eprintln!("{}", part.title());
                    part.make(&args.checkout, &program)?;
                }
                Ok(part.measure(&args.checkout)?)
            }
        };
        sections.push((part.title(), found));
    }
    let text = page::page(&sections);
    match &args.page {
        Some(path) => rogs_files::write_bytes(path, text.as_bytes())?,
        None => println!("{text}"),
    }
    Ok(())
}
