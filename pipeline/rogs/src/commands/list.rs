//! `rogs list`: the episodes of a folder.

use std::path::PathBuf;
use std::process::ExitCode;

use rogs_ingest::{EpisodeListing, count_frames, list_episodes};
use rogs_orchestrator::columns;
use schemars::JsonSchema;
use serde::Serialize;

use super::stage_error;
use crate::output;

/// Lists the episodes below a folder, in any layout that ingest knows, with their frames.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The folder.
    #[arg(default_value = ".")]
    folder: PathBuf,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// What is printed as JSON.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Listed {
    /// The episodes.
    episodes: Vec<EpisodeListing>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let mut episodes = list_episodes(&args.folder).map_err(stage_error)?;
    count_frames(&args.folder, &mut episodes);
    if args.json {
        output::json(&Listed { episodes })?;
        return Ok(ExitCode::SUCCESS);
    }
    let head = ["episode", "layout", "frames", "folder", "selector"].map(str::to_owned);
    let row = |episode: &EpisodeListing| {
        let frames = episode
            .frames
            .map_or_else(|| "?".to_owned(), |frames| frames.to_string());
        let selector = if episode.selector.is_empty() {
            "-"
        } else {
            &episode.selector
        };
        let text = [&episode.episode_id, &episode.layout, &frames, &episode.folder, selector];
        text.map(str::to_owned).to_vec()
    };
    let rows: Vec<Vec<String>> = std::iter::once(head.to_vec()).chain(episodes.iter().map(row)).collect();
    let mut lines = columns(&rows);
    lines.push(format!("{} episodes", episodes.len()));
    output::text(&lines.join("\n"))?;
    Ok(ExitCode::SUCCESS)
}
