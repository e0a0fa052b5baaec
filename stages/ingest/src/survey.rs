//! What a cohort is chosen by: each episode of a folder opened and checked, nothing decoded.

use std::path::Path;

use rayon::prelude::*;
use rogs_schemas::records::clip::CameraRole;
use rogs_worker::StageResult;

use crate::layouts;
use crate::listing::{EpisodeListing, list_episodes};
use crate::params::Params;
use crate::source::Source;

/// What an episode has.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeFacts {
    /// The episode.
    pub listing: EpisodeListing,
    /// What it has; or why ingest cannot read it, in its words.
    pub content: Result<EpisodeContent, String>,
}

/// What an episode that can be read has. Its cameras are calibrated: else it could not be read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EpisodeContent {
    /// Frames.
    pub frames: u32,
    /// It has what stereo gives: reference depth of an input camera, or images of the right eye of one.
    pub stereo: bool,
    /// Smallest and largest gripper value.
    pub gripper_range: [f64; 2],
}

/// Opens the wanted ones of the episodes that [`list_episodes`] finds; `calibration` is for layouts that have none.
///
/// # Errors
/// When the folder cannot be listed. An episode that cannot be read says so itself.
pub fn survey(
    root: &Path,
    calibration: Option<&Path>,
    wanted: impl Fn(&EpisodeListing) -> bool,
) -> StageResult<Vec<EpisodeFacts>> {
    let listed: Vec<EpisodeListing> = list_episodes(root)?.into_iter().filter(wanted).collect();
    let facts = |listing: EpisodeListing| {
        let params = Params {
            episode: listing.selector.clone(),
            ..Params::default()
        };
        let source = layouts::open(&root.join(&listing.folder), calibration, &params);
        EpisodeFacts {
            content: source.map(|source| content(&source)).map_err(|error| error.to_string()),
            listing,
        }
    };
    Ok(listed.into_par_iter().map(facts).collect())
}

fn content(source: &Source) -> EpisodeContent {
    let input = |id: &str| {
        let is_input = |camera: &&crate::source::SourceCamera| camera.id == id && camera.role == CameraRole::Source;
        source.cameras.iter().any(|camera| is_input(&camera))
    };
    let stereo = source.cameras.iter().any(|camera| match camera.role {
        CameraRole::Source => camera.depth.is_some(),
        CameraRole::Evaluation => camera.images.is_some() && camera.partner.as_deref().is_some_and(input),
    });
    let range = source
        .states
        .gripper
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &value| {
            [low.min(value), high.max(value)]
        });
    EpisodeContent {
        frames: source.frame_count,
        stereo,
        gripper_range: range,
    }
}
