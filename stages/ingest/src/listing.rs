//! Finding the episodes below a folder.

use std::path::Path;

use rayon::prelude::*;
use rogs_schemas::ids::safe_name;
use rogs_worker::{StageError, StageResult};
use schemars::JsonSchema;
use serde::Serialize;

use crate::fault::io_error;
use crate::layouts::{
    KNOWN, Layout, LerobotEpisode, agibot, ctrlworld, detect, droid, foreign, lerobot_dataset, refusal, rogs_episode,
};
use crate::pointworld;

/// One episode that can be ingested.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct EpisodeListing {
    /// Id in the dataset.
    pub episode_id: String,
    /// A name made of it that can be a file name.
    pub name: String,
    /// Layout, as the clip keeps it.
    pub layout: String,
    /// Folder to give as input `episode`, relative to the listed root (`.` for the root itself).
    pub folder: String,
    /// Value for the parameter `episode`.
    pub selector: String,
    /// Its frames, where its description can be read; a clip is an interval of them.
    pub frames: Option<u64>,
    /// Every file that ingest may read for it, relative to `folder`, sorted.
    pub files: Vec<String>,
}

/// The episodes of a folder: the folder itself in any layout, the folders right below it, or a tree of raw DROID.
///
/// # Errors
/// When the folder or the description of a data set cannot be read. One episode that is damaged is listed with the files
/// that are there; ingesting it says what is wrong.
pub fn list_episodes(root: &Path) -> StageResult<Vec<EpisodeListing>> {
    let mut found = match detect(root) {
        Some(layout) => list(root, ".", layout)?,
        None => Vec::new(),
    };
    // A data set of its own may lie in a folder of a Ctrl-World tree; below the others there are only their own files.
    if !found.is_empty() && found.iter().any(|episode| episode.layout != ctrlworld::LAYOUT) {
        return Ok(found);
    }
    let entries = rogs_files::entries(root).map_err(|error| io_error(root, &error))?;
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .collect();
    names.sort();
    for name in names {
        let folder = root.join(&name);
        if let Some(layout) = detect(&folder) {
            found.extend(list(&folder, &name, layout)?);
        }
    }
    if found.is_empty() {
        found = list_droid(root, "")?;
    }
    if found.is_empty() {
        let known = refusal(root).or_else(|| pointworld::refusal(root));
        let known = known.or_else(|| foreign::refusal(root));
        return Err(known.unwrap_or_else(|| {
            StageError::bad_input(format!("`{}` holds no episode of a known layout", root.display())).with_hint(KNOWN)
        }));
    }
    Ok(found)
}

fn list(folder: &Path, relative: &str, layout: Layout) -> StageResult<Vec<EpisodeListing>> {
    let listing = |episode_id: String, layout: &str, selector: String, frames: Option<u64>, files: Vec<String>| {
        listed(episode_id, layout, (relative.to_owned(), selector), frames, files)
    };
    match layout {
        Layout::RogsEpisode => {
            // A description that is damaged still names an episode: by its folder.
            let (id, frames) = match rogs_episode::read_description(folder) {
                Ok(episode) => (episode.episode_id, Some(u64::from(episode.frame_count))),
                Err(_) => {
                    let name = folder.file_name().unwrap_or_default();
                    (name.to_string_lossy().into_owned(), None)
                }
            };
            Ok(vec![listing(
                id,
                rogs_episode::LAYOUT,
                String::new(),
                frames,
                all_files(folder)?,
            )])
        }
        Layout::DroidCtrlworld => {
            let one = |selector: String| match ctrlworld::files(folder, &selector) {
                Ok((id, frames, files)) => listing(id, ctrlworld::LAYOUT, selector, Some(frames.into()), files),
                Err(_) => {
                    let id = selector.rsplit('/').next().unwrap_or(&selector).to_owned();
                    let files = vec![format!("annotation/{selector}.json")];
                    listing(id, ctrlworld::LAYOUT, selector, None, files)
                }
            };
            Ok(ctrlworld::selectors(folder)?.into_iter().map(one).collect())
        }
        Layout::DroidRaw => list_droid(folder, relative),
        Layout::Agibot => {
            let name = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
            let name = name.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let (frames, files) = (agibot::frames(folder), all_files(folder)?);
            Ok(vec![listing(name, agibot::LAYOUT, String::new(), frames, files)])
        }
        Layout::Lerobot => {
            let dataset = lerobot_dataset(folder)?;
            let one = |episode: LerobotEpisode| {
                let id = episode.selector.clone();
                listing(id, dataset.layout, episode.selector, episode.frames, episode.files)
            };
            Ok(dataset.episodes.into_iter().map(one).collect())
        }
    }
}

/// An entry of the list.
fn listed(
    episode_id: String,
    layout: &str,
    (folder, selector): (String, String),
    frames: Option<u64>,
    mut files: Vec<String>,
) -> EpisodeListing {
    files.sort();
    files.dedup();
    EpisodeListing {
        name: safe_name(&episode_id),
        episode_id,
        layout: layout.to_owned(),
        folder,
        selector,
        frames,
        files,
    }
}

/// Raw DROID episodes in a folder or tree that is at `relative`.
fn list_droid(folder: &Path, relative: &str) -> StageResult<Vec<EpisodeListing>> {
    let place = |found: &str| match (relative, found) {
        ("" | ".", "") => ".".to_owned(),
        ("" | ".", found) => found.to_owned(),
        (before, "") => before.to_owned(),
        (before, found) => format!("{before}/{found}"),
    };
    let found = droid::episodes(folder)?.into_iter();
    Ok(found
        .map(|found| {
            let folder = place(&found.folder);
            listed(found.id, droid::LAYOUT, (folder, String::new()), None, found.files)
        })
        .collect())
}

/// Fills in the frames that a listing does not know by itself: those of raw DROID, whose metadata are read for it.
pub fn count_frames(root: &Path, episodes: &mut [EpisodeListing]) {
    let unknown = episodes.par_iter_mut().filter(|episode| episode.frames.is_none());
    unknown.for_each(|episode| {
        if episode.layout == droid::LAYOUT {
            episode.frames = droid::frames(&root.join(&episode.folder));
        }
    });
}

/// Every file below a folder but strays, relative; links are followed.
fn all_files(folder: &Path) -> StageResult<Vec<String>> {
    fn walk(root: &Path, folder: &Path, depth: usize, out: &mut Vec<String>) -> StageResult<()> {
        let entries = rogs_files::entries(folder).map_err(|error| io_error(folder, &error))?;
        for entry in entries.filter_map(Result::ok) {
            let path = entry.path();
            let name = path.strip_prefix(root).unwrap_or(&path).to_str().map(str::to_owned);
            match path.is_dir() {
                true if depth < 8 => walk(root, &path, depth + 1, out)?,
                true => {}
                false => out.extend(name),
            }
        }
        Ok(())
    }
    let mut files = Vec::new();
    walk(folder, folder, 0, &mut files)?;
    Ok(files)
}
