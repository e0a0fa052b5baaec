//! The clips of a plan: which episodes, under which names, with which content.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use rogs_schemas::ContentHash;
use serde_json::Map;

use super::build::normalise_overrides;
use super::{Clip, Plan, Source};
use crate::diagnose::Text;
use crate::error::{Result, did_you_mean};
use crate::manifest::{Episode, Input, Manifest, Params, safe_name};
use crate::programs::{ListedEpisode, StagePrograms};
use crate::sources::SourceCache;

/// One episode that was asked for, before its content is known.
struct Asked<'a> {
    root: PathBuf,
    listed: ListedEpisode,
    id: Option<&'a str>,
    calibration: Option<&'a PathBuf>,
    ingest: &'a Params,
}

/// Fills in the clips of a plan.
pub(super) fn add_clips(
    plan: &mut Plan,
    manifest: &Manifest,
    text: &Text,
    programs: &StagePrograms,
    sources: &SourceCache,
) -> Result<()> {
    let mut listings = Listings {
        programs,
        known: HashMap::new(),
    };
    let mut asked = Vec::new();
    for episode in &manifest.episodes {
        asked.push(pick(
            episode,
            listings.of(text, &["episodes", "root"], &episode.root)?,
            text,
        )?);
    }
    if let Some(input) = &manifest.input {
        asked.extend(filter(input, listings.of(text, &["input", "root"], &input.root)?));
        if asked.is_empty() {
            let error = text.error(&["input"], format!("no episode in `{}` is taken", input.root.display()));
            return Err(error.with_hint("check `include`, `exclude`, `layout` and `limit`"));
        }
    }
    let ids = names(&asked, text)?;
    let mut overrides = HashMap::new();
    let mut normalised = Vec::with_capacity(asked.len());
    for asked in &asked {
        let map = match plan.nodes.first() {
            Some(node) => normalise_overrides(programs, node, asked.ingest, &mut overrides)?,
            None => Map::new(),
        };
        normalised.push(map);
    }
    let contents: Vec<_> = asked
        .par_iter()
        .map(|asked| sources.episode(&asked.root, &asked.listed.files))
        .collect();
    for (((asked, id), content), ingest) in asked.iter().zip(ids).zip(contents).zip(normalised) {
        let calibration = match asked.calibration {
            None => None,
            Some(path) => Some(calibration(plan, path, text, sources)?),
        };
        let predictions = predictions(plan, &id, sources)?;
        let latents = plan.latents.as_ref().map(|root| super::latents_file(root, &id));
        let latents = latents.filter(|file| file.is_file());
        let clip = Clip {
            predictions,
            latents: latents.map(|file| sources.source("latents", &file)).transpose()?,
            id,
            episode: asked.listed.episode_id.clone(),
            layout: asked.listed.layout.clone(),
            root: position_or_push(&mut plan.roots, asked.root.clone()),
            selector: asked.listed.selector.clone(),
            content: content?,
            calibration,
            ingest,
        };
        plan.clips.push(clip);
    }
    Ok(())
}

struct Listings<'a> {
    programs: &'a StagePrograms,
    known: HashMap<PathBuf, Vec<ListedEpisode>>,
}

impl Listings<'_> {
    fn of(&mut self, text: &Text, keys: &[&str], root: &Path) -> Result<&[ListedEpisode]> {
        if !root.is_dir() {
            let error = text.error(keys, format!("`{}` is no folder", root.display()));
            return Err(error.with_hint("paths in a manifest are relative to the manifest's folder"));
        }
        if !self.known.contains_key(root) {
            let episodes = self.programs.list_episodes(root)?;
            if episodes.is_empty() {
                return Err(text.error(
                    keys,
                    format!("`{}` holds no episode in a layout that ingest knows", root.display()),
                ));
            }
            self.known.insert(root.to_owned(), episodes);
        }
        Ok(&self.known[root])
    }
}

/// The one episode that an `[[episodes]]` table means.
fn pick<'a>(episode: &'a Episode, listed: &[ListedEpisode], text: &Text) -> Result<Asked<'a>> {
    let found: Vec<&ListedEpisode> = match &episode.select {
        None => listed.iter().collect(),
        Some(select) => listed.iter().filter(|listed| listed.is_called(select)).collect(),
    };
    let [listed] = found[..] else {
        let names = || {
            listed.iter().map(|listed| {
                if listed.selector.is_empty() {
                    &listed.episode_id
                } else {
                    &listed.selector
                }
            })
        };
        let root = episode.root.display();
        let (keys, message): (&[&str], _) = match &episode.select {
            Some(select) if found.is_empty() => {
                (&["episodes", "select"], format!("`{root}` has no episode `{select}`"))
            }
            Some(select) => (
                &["episodes", "select"],
                format!("`{select}` means {} episodes in `{root}`", found.len()),
            ),
            None => (&["episodes"], format!("`{root}` holds {} episodes", found.len())),
        };
        let meant = episode
            .select
            .as_deref()
            .and_then(|select| did_you_mean(select, names().map(String::as_str)));
        let some: Vec<_> = names().take(8).map(String::as_str).collect();
        return Err(text.error(keys, message).with_hint(match meant {
            Some(meant) => format!("did you mean `{meant}`?"),
            None => format!(
                "set `select` to one of: {}{}",
                some.join(", "),
                if listed.len() > 8 { ", ..." } else { "" }
            ),
        }));
    };
    Ok(Asked {
        root: folder_of(&episode.root, listed),
        listed: listed.clone(),
        id: episode.id.as_deref(),
        calibration: episode.calibration.as_ref(),
        ingest: &episode.ingest,
    })
}

/// The folder that ingest gets for an episode.
fn folder_of(root: &Path, listed: &ListedEpisode) -> PathBuf {
    let inside = listed
        .folder
        .components()
        .filter(|part| matches!(part, std::path::Component::Normal(_)));
    inside.fold(root.to_owned(), |path, part| path.join(part))
}

/// The episodes that an `[input]` table takes.
fn filter<'a>(input: &'a Input, listed: &[ListedEpisode]) -> Vec<Asked<'a>> {
    let any = |patterns: &[String], listed: &ListedEpisode| patterns.iter().any(|pattern| listed.fits(pattern));
    let taken = listed.iter().filter(|listed| {
        input.layout.as_ref().is_none_or(|layout| *layout == listed.layout)
            && (input.include.is_empty() || any(&input.include, listed))
            && !any(&input.exclude, listed)
    });
    let make = |listed: &ListedEpisode| Asked {
        root: folder_of(&input.root, listed),
        listed: listed.clone(),
        id: None,
        calibration: input.calibration.as_ref(),
        ingest: &input.ingest,
    };
    taken.take(input.limit.unwrap_or(usize::MAX)).map(make).collect()
}

/// Safe and unique names. A name that was chosen is kept; a name that was made gets a suffix where it would collide.
fn names(asked: &[Asked<'_>], text: &Text) -> Result<Vec<String>> {
    let mut taken: BTreeMap<String, usize> = BTreeMap::new();
    for (index, id) in asked
        .iter()
        .enumerate()
        .filter_map(|(index, asked)| Some((index, asked.id?)))
    {
        if taken.insert(id.to_lowercase(), index).is_some() {
            return Err(text.error(&["episodes", "id"], format!("two episodes have the id `{id}`")));
        }
    }
    let mut ids = Vec::with_capacity(asked.len());
    let mut seen = BTreeSet::new();
    for (index, asked) in asked.iter().enumerate() {
        if let Some(id) = asked.id {
            ids.push(id.to_owned());
            continue;
        }
        if !seen.insert((&asked.root, asked.listed.selector.as_str())) {
            let message = format!("the episode `{}` is named twice", asked.listed.episode_id);
            return Err(text.error(&["episodes"], message).with_hint("give each its own `id`"));
        }
        let name = [&asked.listed.name, &asked.listed.episode_id]
            .into_iter()
            .find(|name| !name.is_empty());
        let mut id = safe_name(name.map_or("episode", String::as_str));
        if taken.contains_key(&id.to_lowercase()) {
            // Of the folder only its name, so that moving the data does not rename clips.
            let folder = asked.root.file_name().map(|name| name.to_string_lossy().into_owned());
            let origin = format!("{}\0{}", folder.unwrap_or_default(), asked.listed.selector);
            let suffix = &blake3::hash(origin.as_bytes()).to_hex()[..8];
            id.truncate(119);
            id = format!("{id}-{suffix}");
        }
        if taken.insert(id.to_lowercase(), index).is_some() {
            let message = format!("the episode `{}` is named twice", asked.listed.episode_id);
            return Err(text.error(&["episodes"], message).with_hint("give each its own `id`"));
        }
        ids.push(id);
    }
    Ok(ids)
}

/// Content of a clip's folder in each of the plan's predictions; empty when there is none at all.
fn predictions(plan: &Plan, id: &str, sources: &SourceCache) -> Result<Vec<Option<ContentHash>>> {
    let of = |root: &PathBuf| {
        let folder = root.join(id);
        let content = folder.is_dir().then(|| sources.source("predictions", &folder));
        content.transpose()
    };
    let all = plan.predictions.iter().map(of).collect::<Result<Vec<_>>>()?;
    Ok(if all.iter().all(Option::is_none) {
        Vec::new()
    } else {
        all
    })
}

fn calibration(plan: &mut Plan, path: &Path, text: &Text, sources: &SourceCache) -> Result<u32> {
    if let Some(index) = plan.calibrations.iter().position(|source| source.path == path) {
        return Ok(index as u32);
    }
    if !path.is_file() {
        let error = text.error(
            &["episodes", "calibration"],
            format!("calibration file `{}` is not there", path.display()),
        );
        return Err(error.with_hint("paths in a manifest are relative to the manifest's folder"));
    }
    let content = sources.source("calibration", path)?;
    plan.calibrations.push(Source {
        path: path.to_owned(),
        content,
    });
    Ok(plan.calibrations.len() as u32 - 1)
}

fn position_or_push(list: &mut Vec<PathBuf>, path: PathBuf) -> u32 {
    let index = list.iter().position(|known| *known == path).unwrap_or_else(|| {
        list.push(path);
        list.len() - 1
    });
    index as u32
}
