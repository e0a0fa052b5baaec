//! Which files a cache has of which episode.

use std::collections::BTreeMap;
use std::path::Path;

use rogs_worker::{StageError, StageResult};

use super::clips::{episodes_of_shard, is_shard};
use super::{ROLES, role_of};
use crate::fault::{io_error, wrong};

/// Deepest folder that is looked into: releases are cut into folders by the first letters of the uuid.
const DEEPEST: usize = 8;

/// Files by episode and role, relative to the folder.
pub type ReferenceFiles = BTreeMap<String, BTreeMap<String, String>>;

/// Finds the files of every episode below a folder: by their names, of shards by the names in them. Each folder and
/// each shard is looked through once. An episode without a file of tracks of its own has those in the shard that holds
/// most of its clips, the first of equals.
///
/// # Errors
/// When a folder or a shard cannot be read, or an episode has two files of one kind.
pub fn list_references(root: &Path) -> StageResult<ReferenceFiles> {
    let (mut found, mut shards) = (ReferenceFiles::new(), Vec::new());
    walk(root, root, 0, &mut found, &mut shards)?;
    let mut best: BTreeMap<String, (usize, String)> = BTreeMap::new();
    for shard in shards {
        for (uuid, clips) in episodes_of_shard(&root.join(&shard))? {
            let most = best.get(&uuid).map_or(0, |(most, _)| *most);
            if clips > most {
                best.insert(uuid, (clips, shard.clone()));
            }
        }
    }
    for (uuid, (_, shard)) in best {
        found
            .entry(uuid)
            .or_default()
            .entry(ROLES[2].to_owned())
            .or_insert(shard);
    }
    Ok(found)
}

/// The error for a folder of caches that is given as one of episodes; `None` for all others.
pub(crate) fn refusal(root: &Path) -> Option<StageError> {
    let (mut found, mut shards) = (ReferenceFiles::new(), Vec::new());
    walk(root, root, 0, &mut found, &mut shards).ok()?;
    if found.is_empty()
        && !shards
            .iter()
            .any(|shard| episodes_of_shard(&root.join(shard)).is_ok_and(|of| !of.is_empty()))
    {
        return None;
    }
    let text = format!(
        "`{}` holds caches of PointWorld and no episodes: of every clip they have one image a fixed camera and none of the \
         wrist, so that nothing can be lifted from them alone",
        root.display()
    );
    Some(StageError::bad_input(text).with_hint(
        "set `root` under [input] to the raw episodes of the same uuids (docs/droid.md), and `pointworld` to this folder \
         (docs/pointworld.md)",
    ))
}

fn walk(
    root: &Path,
    folder: &Path,
    depth: usize,
    found: &mut ReferenceFiles,
    shards: &mut Vec<String>,
) -> StageResult<()> {
    let entries = rogs_files::entries(folder).map_err(|error| io_error(folder, &error))?;
    let mut paths: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort();
    for path in paths {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let relative = || path.strip_prefix(root).unwrap_or(&path).to_string_lossy().into_owned();
        if let Some((role, uuid)) = role_of(name)
            && path.is_file()
        {
            let files = found.entry(uuid.to_owned()).or_default();
            let relative = relative();
            if let Some(other) = files.insert(role.to_owned(), relative) {
                return Err(wrong(&path, format!("`{other}` is of the same episode and kind")));
            }
        } else if is_shard(&path) && path.is_file() {
            shards.push(relative());
        } else if depth < DEEPEST && path.is_dir() {
            walk(root, &path, depth + 1, found, shards)?;
        }
    }
    Ok(())
}
