//! `rogs cohort`: the paper's evaluation cohort, chosen before any output exists.

use std::path::PathBuf;
use std::process::ExitCode;

use rogs_score::cohort::{CohortOptions, PointWorldManifest, read_episodes, select};

use crate::output;

/// Selects episodes as the paper does and writes `selection.json`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Episode list: a JSON array of records, or one record a line.
    #[arg(long, value_name = "FILE")]
    episodes: PathBuf,
    /// The released PointWorld split (`droid_paper_split_manifest.json`).
    #[arg(long, value_name = "FILE")]
    manifest: PathBuf,
    /// Where the selection goes.
    #[arg(long, value_name = "FILE", default_value = "selection.json")]
    out: PathBuf,
    /// Laboratories held out; default ILIAD and PennPAL.
    #[arg(long, value_name = "LAB")]
    lab: Vec<String>,
    /// Seed of the permutation.
    #[arg(long, default_value_t = 42)]
    seed: u64,
    /// Episodes to select.
    #[arg(long, default_value_t = 256)]
    take: usize,
    /// Print one JSON value: the selection.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let mut options = CohortOptions {
        seed: args.seed,
        take: args.take,
        ..CohortOptions::default()
    };
    if !args.lab.is_empty() {
        options.labs.clone_from(&args.lab);
    }
    let selection = select(
        &read_episodes(&args.episodes)?,
        &PointWorldManifest::read(&args.manifest)?,
        &options,
    )?;
    let mut text = serde_json::to_vec_pretty(&selection)?;
    text.push(b'\n');
    rogs_files::write_bytes(&args.out, &text)?;
    if args.json {
        output::json(&selection)?;
    } else {
        let counts = &selection.counts;
        output::text(&format!(
            "{} reserved, {} cached, {} in the test set, {} eligible, {} selected: {}",
            counts.reserved,
            counts.cached,
            counts.candidates,
            counts.eligible,
            counts.selected,
            args.out.display()
        ))?;
    }
    Ok(ExitCode::SUCCESS)
}
