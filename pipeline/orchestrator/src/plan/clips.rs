//! The clips of a plan: which episodes, under which names, with which content.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;
use rogs_schemas::ids::{did_you_mean, unknown};
use rogs_schemas::selection::Selection;
use rogs_schemas::{ClipId, ContentHash};
use serde_json::Map;

use super::model::{Plan, PlannedClip, PlannedSource, latents_file};
use super::params::normalise_overrides;
use super::rollouts::RolloutFolder;
use super::selection::read_selection;
use crate::diagnose::{At, Text, path_hint, shown};
use crate::error::Result;
use crate::manifest::{Cut, Episode, Input, Manifest, Params, safe_name};
use crate::programs::{ListedEpisode, StagePrograms};
use crate::sources::SourceCache;
use crate::stage::StageId;

/// One clip that was asked for, before its content is known.
#[derive(Clone)]
struct Asked<'a> {
    /// Which of `[[episodes]]` asks for it; `None`: `[input]`.
    table: Option<usize>,
    root: PathBuf,
    listed: Arc<ListedEpisode>,
    id: Option<&'a str>,
    /// Name that a selection gives it.
    name: Option<String>,
    calibration: Option<&'a PathBuf>,
    pointworld: Option<&'a PathBuf>,
    ingest: &'a Params,
    cut: Option<Cut>,
    /// Episode frame at which the clip starts, where the manifest says so.
    start: Option<u32>,
}

impl Asked<'_> {
    /// What its name ends in: where it starts, when there may be several clips of its episode.
    fn ending(&self) -> String {
        match (self.cut, self.start) {
            (Some(Cut { several: true, .. }), Some(start)) => format!("-f{start:06}"),
            _ => String::new(),
        }
    }

    /// The name that a person chose for it.
    fn chosen(&self) -> Option<String> {
        self.id.map(|id| format!("{id}{}", self.ending()))
    }

    /// The table of the manifest that asks for it.
    fn at(&self) -> At<'static> {
        self.table.map_or(At::key("input"), episode_table)
    }
}

/// One of `[[episodes]]`.
fn episode_table(index: usize) -> At<'static> {
    At::key("episodes").item(index)
}

/// Fills in the clips of a plan.
pub(super) fn add_clips(
    plan: &mut Plan,
    manifest: &Manifest,
    text: &Text,
    programs: &StagePrograms,
    sources: &SourceCache,
) -> Result<()> {
    let input = manifest.input.iter().map(Input::cut);
    let cuts = input.chain(manifest.episodes.iter().map(Episode::cut));
    let mut listings = Listings {
        programs,
        counted: cuts.flatten().any(|cut| cut.several),
        known: HashMap::new(),
    };
    let mut asked = Vec::new();
    for (index, episode) in manifest.episodes.iter().enumerate() {
        let listing = listings.of(text, episode_table(index).then("root"), &episode.root)?;
        asked.push(pick(episode, index, listing, text)?);
    }
    if let Some(input) = &manifest.input {
        let listing = listings.of(text, At::key("input").then("root"), &input.root)?;
        included(input, listing, text)?;
        asked.extend(match &input.selection {
            None => filter(input, listing),
            Some(path) => {
                let (selection, note) = read_selection(path, text, sources)?;
                plan.selection = Some(note);
                selected(input, &selection, listing, text)?
            }
        });
        if asked.is_empty() {
            let error = text.error(
                At::key("input"),
                format!("no episode in `{}` is taken", input.root.display()),
            );
            return Err(error.with_hint("check `include`, `exclude`, `layout` and `limit`"));
        }
    }
    let (asked, normalised) = cut_all(asked, plan, text, programs)?;
    let ids = names(&asked, text)?;
    let contents: Vec<_> = asked
        .par_iter()
        .map(|asked| sources.episode(&asked.root, &asked.listed.files))
        .collect();
    let mut references = References {
        programs,
        known: HashMap::new(),
    };
    let rollouts = plan.rollouts.as_deref().map(RolloutFolder::read).transpose()?;
    let (mut roots, mut calibrations) = (HashMap::new(), HashMap::new());
    for (((asked, id), content), ingest) in asked.iter().zip(ids).zip(contents).zip(normalised) {
        let calibration = match asked.calibration {
            None => None,
            Some(path) => Some(match calibrations.get(path) {
                Some(&index) => index,
                None => {
                    let index = calibration(plan, path, asked.at().then("calibration"), text, sources)?;
                    calibrations.insert(path, index);
                    index
                }
            }),
        };
        let references = match asked.pointworld {
            Some(root) => references.of(text, asked, root, sources)?,
            None => BTreeMap::new(),
        };
        let predictions = predictions(plan, &id, sources)?;
        let latents = plan.latents.as_ref().map(|root| latents_file(root, &id));
        let latents = latents.filter(|file| file.is_file());
        let rollout = match &rollouts {
            Some(folder) => folder.of(&id, &asked.listed.episode_id, text, sources)?,
            None => None,
        };
        let own = plan.rollout_latents.as_ref().map(|root| latents_file(root, &id));
        let rollout_latents = own.filter(|file| file.is_file());
        let sidecars = |root: &Option<PathBuf>| {
            let folder = root
                .as_ref()
                .map(|root| root.join(&id))
                .filter(|folder| folder.is_dir());
            folder.map(|folder| sources.source("sidecars", &folder)).transpose()
        };
        let clip = PlannedClip {
            predictions,
            sidecars: sidecars(&plan.sidecars)?,
            rollout_sidecars: sidecars(&plan.rollout_sidecars)?,
            rollout,
            rollout_latents: rollout_latents
                .map(|file| sources.source("latents", &file))
                .transpose()?,
            latents: latents.map(|file| sources.source("latents", &file)).transpose()?,
            id,
            episode: asked.listed.episode_id.clone(),
            layout: asked.listed.layout.clone(),
            root: *roots.entry(asked.root.as_path()).or_insert_with(|| {
                plan.roots.push(asked.root.clone());
                plan.roots.len() as u32 - 1
            }),
            selector: asked.listed.selector.clone(),
            content: content?,
            calibration,
            references,
            ingest,
        };
        plan.clips.push(clip);
    }
    Ok(())
}

/// The clips of every episode, with their parameters.
fn cut_all<'a>(
    asked: Vec<Asked<'a>>,
    plan: &Plan,
    text: &Text,
    programs: &StagePrograms,
) -> Result<(Vec<Asked<'a>>, Vec<Params>)> {
    let node = plan.nodes.iter().find(|node| node.stage == StageId::Ingest);
    let (mut clips, mut params, mut known) = (Vec::new(), Vec::new(), HashMap::new());
    for asked in asked {
        let own = match node {
            Some(node) => normalise_overrides(programs, node, asked.ingest, &mut known)?,
            None => Map::new(),
        };
        let interval = node.and_then(|node| Some((node, node.stage.spec().interval.as_ref()?)));
        let (Some(cut), Some((node, names))) = (asked.cut, interval) else {
            clips.push(asked);
            params.push(own);
            continue;
        };
        let value = |name: &str| own.get(name).or_else(|| node.params.get(name));
        if value(names.start).is_some_and(|start| !start.is_null()) {
            let message = format!(
                "`{}` of `ingest` and `clips` or `start` both say where clips start",
                names.start
            );
            return Err(text.error(asked.at(), message).with_hint("keep one of them"));
        }
        let number = |name: &str| value(name).and_then(serde_json::Value::as_u64).unwrap_or(1);
        let span = number(names.frames).saturating_sub(1) * number(names.step) + 1;
        for start in cut.starts(span, asked.listed.frames) {
            let mut own = own.clone();
            own.insert(names.start.to_owned(), start.into());
            params.push(own);
            clips.push(Asked {
                start: Some(start),
                ..asked.clone()
            });
        }
    }
    Ok((clips, params))
}

/// Folders with references, each looked through once.
struct References<'a> {
    programs: &'a StagePrograms,
    known: HashMap<PathBuf, HashMap<String, BTreeMap<String, PathBuf>>>,
}

impl References<'_> {
    /// The files of an episode, by role; empty when it has none.
    fn of(
        &mut self,
        text: &Text,
        asked: &Asked<'_>,
        root: &Path,
        sources: &SourceCache,
    ) -> Result<BTreeMap<String, PlannedSource>> {
        if !self.known.contains_key(root) {
            if !root.is_dir() {
                let error = text.error(
                    asked.at().then("pointworld"),
                    format!("`{}` is not a folder", shown(root)),
                );
                return Err(error.with_hint(path_hint(root)));
            }
            self.known.insert(root.to_owned(), self.programs.list_references(root)?);
        }
        let files = self.known[root].get(&asked.listed.episode_id).into_iter().flatten();
        let source = |(role, file): (&String, &PathBuf)| {
            let path = root.join(file);
            let content = sources.source(role, &path)?;
            Ok((role.clone(), PlannedSource { path, content }))
        };
        files.map(source).collect()
    }
}

struct Listings<'a> {
    programs: &'a StagePrograms,
    /// Clips are cut along episodes, whose lengths must be known.
    counted: bool,
    known: HashMap<PathBuf, Listing>,
}

/// The episodes of a folder, and which of them are called by a name.
struct Listing {
    episodes: Vec<Arc<ListedEpisode>>,
    by_name: HashMap<String, Vec<usize>>,
}

impl Listing {
    fn new(episodes: Vec<ListedEpisode>) -> Self {
        let mut by_name: HashMap<String, Vec<usize>> = HashMap::new();
        for (index, episode) in episodes.iter().enumerate() {
            for name in episode.names() {
                let called = by_name.entry(name).or_default();
                if called.last() != Some(&index) {
                    called.push(index);
                }
            }
        }
        Self {
            episodes: episodes.into_iter().map(Arc::new).collect(),
            by_name,
        }
    }

    /// The episodes that a person means by `select`; all without it.
    fn called(&self, select: Option<&str>) -> Vec<&Arc<ListedEpisode>> {
        let Some(select) = select else {
            return self.episodes.iter().collect();
        };
        let found = self.by_name.get(select).into_iter().flatten();
        found.map(|&index| &self.episodes[index]).collect()
    }
}

impl Listings<'_> {
    fn of(&mut self, text: &Text, at: At<'_>, root: &Path) -> Result<&Listing> {
        if self.known.contains_key(root) {
            return Ok(&self.known[root]);
        }
        if !root.is_dir() {
            let error = text.error(at, format!("`{}` is not a folder", shown(root)));
            return Err(error.with_hint(path_hint(root)));
        }
        let episodes = self.programs.list_episodes(root, self.counted)?;
        if episodes.is_empty() {
            let message = format!("`{}` holds no episode in a layout that ingest knows", root.display());
            return Err(text.error(at, message));
        }
        Ok(self.known.entry(root.to_owned()).or_insert(Listing::new(episodes)))
    }
}

/// The one episode that the n-th of `[[episodes]]` means.
fn pick<'a>(episode: &'a Episode, index: usize, listing: &Listing, text: &Text) -> Result<Asked<'a>> {
    let found = listing.called(episode.select.as_deref());
    let [listed] = found[..] else {
        let listed = &listing.episodes;
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
        let at = episode_table(index);
        let (at, message) = match &episode.select {
            Some(select) if found.is_empty() => (at.then("select"), format!("`{root}` has no episode `{select}`")),
            Some(select) => (
                at.then("select"),
                format!("`{select}` means {} episodes in `{root}`", found.len()),
            ),
            None => (at, format!("`{root}` holds {} episodes", found.len())),
        };
        let meant = episode
            .select
            .as_deref()
            .and_then(|select| did_you_mean(select, names().map(String::as_str)));
        let some: Vec<_> = names().take(8).map(String::as_str).collect();
        return Err(text.error(at, message).with_hint(match meant {
            Some(meant) => format!("did you mean `{meant}`?"),
            None => format!(
                "set `select` to one of: {}{}",
                some.join(", "),
                if listed.len() > 8 { ", ..." } else { "" }
            ),
        }));
    };
    Ok(Asked {
        table: Some(index),
        root: folder_of(&episode.root, listed),
        listed: Arc::clone(listed),
        id: episode.id.as_deref(),
        name: None,
        calibration: episode.calibration.as_ref(),
        pointworld: episode.pointworld.as_ref(),
        ingest: &episode.ingest,
        cut: episode.cut(),
        start: None,
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

/// Refuses names in `include` that no episode has: who leaves an episode out by a misspelt name would not notice.
fn included(input: &Input, listing: &Listing, text: &Text) -> Result<()> {
    let mut names = Patterns::new(&input.include).names;
    if names.is_empty() {
        return Ok(());
    }
    for name in listing.episodes.iter().flat_map(|listed| listed.names()) {
        names.remove(name.as_str());
    }
    let mut names: Vec<&str> = names.into_iter().collect();
    names.sort_unstable();
    names.truncate(MOST_NAMED);
    let known: Vec<&str> = listing
        .episodes
        .iter()
        .map(|listed| listed.episode_id.as_str())
        .collect();
    let Some(unknown) = unknown(names, &known) else {
        return Ok(());
    };
    let message = format!("`{}` has no episode {unknown}", input.root.display());
    let error = text.error(At::key("input").then("include"), message);
    Err(error.with_hint("`rogs list FOLDER` shows their ids; `*` and `?` stand for other characters"))
}

/// Most unknown episodes that an error names.
const MOST_NAMED: usize = 8;

/// The episodes that an `[input]` table takes.
fn filter<'a>(input: &'a Input, listing: &Listing) -> Vec<Asked<'a>> {
    let (include, exclude) = (Patterns::new(&input.include), Patterns::new(&input.exclude));
    let taken = listing.episodes.iter().filter(|listed| {
        input.layout.as_ref().is_none_or(|layout| *layout == listed.layout)
            && (input.include.is_empty() || include.fit(listed))
            && !exclude.fit(listed)
    });
    let taken = taken.take(input.limit.unwrap_or(usize::MAX));
    taken.map(|listed| of_input(input, listed, None)).collect()
}

/// An episode of an `[input]` table, under the name that a selection gives it.
fn of_input<'a>(input: &'a Input, listed: &Arc<ListedEpisode>, name: Option<String>) -> Asked<'a> {
    Asked {
        table: None,
        root: folder_of(&input.root, listed),
        listed: Arc::clone(listed),
        id: None,
        name,
        calibration: input.calibration.as_ref(),
        pointworld: input.pointworld.as_ref(),
        ingest: &input.ingest,
        cut: input.cut(),
        start: None,
    }
}

/// The episodes of an `[input]` table that a selection names, in its order. `layout`, `include`, `exclude` and `limit`
/// take some of them; one that is not there is an error, unless `exclude` names it.
fn selected<'a>(input: &'a Input, selection: &Selection, listing: &Listing, text: &Text) -> Result<Vec<Asked<'a>>> {
    let (include, exclude) = (Patterns::new(&input.include), Patterns::new(&input.exclude));
    let (mut taken, mut missing) = (Vec::new(), Vec::new());
    for own in &selection.selected {
        if taken.len() + missing.len() == input.limit.unwrap_or(usize::MAX) {
            break;
        }
        let names = || [own.episode_id.clone(), own.clip_name.clone()].into_iter();
        if exclude.fit_any(names()) || !(input.include.is_empty() || include.fit_any(names())) {
            continue;
        }
        let called = listing.called(Some(&own.episode_id));
        let wanted =
            |listed: &&&Arc<ListedEpisode>| input.layout.as_ref().is_none_or(|layout| *layout == listed.layout);
        match called.iter().filter(wanted).collect::<Vec<_>>()[..] {
            [] => missing.push(own.episode_id.as_str()),
            [listed] => taken.push(of_input(input, listed, Some(own.clip_name.clone()))),
            ref several => {
                let message = format!(
                    "the selected episode `{}` lies {} times in `{}`",
                    own.episode_id,
                    several.len(),
                    input.root.display()
                );
                return Err(text
                    .error(At::key("input").then("selection"), message)
                    .with_hint("name a folder that holds it once, or its `layout`"));
            }
        }
    }
    if missing.is_empty() {
        return Ok(taken);
    }
    let some: Vec<&str> = missing.iter().take(8).copied().collect();
    let message = format!(
        "{} of the {} selected episodes are not in `{}`: {}{}",
        missing.len(),
        selection.selected.len(),
        input.root.display(),
        some.join(", "),
        if missing.len() > some.len() { ", ..." } else { "" }
    );
    Err(text.error(At::key("input").then("selection"), message).with_hint(
        "a cohort stays what was drawn: fetch them, or leave them out by name with `exclude`, and the tables count fewer clips",
    ))
}

/// Patterns over the names of episodes. Those without wildcards may be as many as there are episodes.
struct Patterns<'a> {
    names: HashSet<&'a str>,
    wild: Vec<&'a str>,
}

impl<'a> Patterns<'a> {
    fn new(patterns: &'a [String]) -> Self {
        let (wild, names): (Vec<&str>, Vec<&str>) = patterns
            .iter()
            .map(String::as_str)
            .partition(|pattern| pattern.contains(['*', '?']));
        Self {
            names: names.into_iter().collect(),
            wild,
        }
    }

    /// True when one of them fits one of the episode's names.
    fn fit(&self, listed: &ListedEpisode) -> bool {
        self.fit_any(listed.names())
    }

    /// True when one of them fits one of these names.
    fn fit_any(&self, mut names: impl Iterator<Item = String>) -> bool {
        let any = !self.names.is_empty() || !self.wild.is_empty();
        any && names.any(|name| {
            self.names.contains(name.as_str()) || self.wild.iter().any(|pattern| crate::glob::matches(pattern, &name))
        })
    }
}

/// Safe and unique names. A name that was chosen is kept; a name that was made gets a suffix where it would collide.
fn names(asked: &[Asked<'_>], text: &Text) -> Result<Vec<ClipId>> {
    let mut taken = BTreeSet::new();
    for asked in asked {
        if let Some(id) = asked.chosen().filter(|id| !taken.insert(id.to_lowercase())) {
            let message = format!("two episodes have the id `{id}`");
            return Err(text.error(asked.at().then("id"), message));
        }
    }
    let mut ids = Vec::with_capacity(asked.len());
    let mut seen = BTreeSet::new();
    for asked in asked {
        if let Some(id) = asked.chosen() {
            ids.push(id);
            continue;
        }
        let twice = || {
            let message = format!("the episode `{}` is named twice", asked.listed.episode_id);
            text.error(asked.at(), message).with_hint("give each its own `id`")
        };
        if !seen.insert((&asked.root, asked.listed.selector.as_str(), asked.start)) {
            return Err(twice());
        }
        let name = [
            asked.name.as_ref(),
            Some(&asked.listed.name),
            Some(&asked.listed.episode_id),
        ];
        let name = name.into_iter().flatten().find(|name| !name.is_empty());
        let (mut id, ending) = (safe_name(name.map_or("episode", String::as_str)), asked.ending());
        id.truncate(128 - ending.len());
        if taken.contains(&format!("{id}{ending}").to_lowercase()) {
            // Of the folder only its name, so that moving the data does not rename clips.
            let folder = asked.root.file_name().map(|name| name.to_string_lossy().into_owned());
            let origin = format!("{}\0{}", folder.unwrap_or_default(), asked.listed.selector);
            let suffix = &blake3::hash(origin.as_bytes()).to_hex()[..8];
            id.truncate(119 - ending.len());
            id = format!("{id}-{suffix}");
        }
        id.push_str(&ending);
        if !taken.insert(id.to_lowercase()) {
            return Err(twice());
        }
        ids.push(id);
    }
    Ok(ids.iter().map(|id: &String| ClipId::made_of(id)).collect())
}

/// Content of a clip's folder in each of the plan's predictions; empty when there is none at all.
fn predictions(plan: &Plan, id: &ClipId, sources: &SourceCache) -> Result<Vec<Option<ContentHash>>> {
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

fn calibration(plan: &mut Plan, path: &Path, at: At<'_>, text: &Text, sources: &SourceCache) -> Result<u32> {
    if !path.exists() {
        let error = text.error(at, format!("calibration file `{}` is not there", shown(path)));
        return Err(error.with_hint(path_hint(path)));
    }
    let content = sources.source("calibration", path)?;
    plan.calibrations.push(PlannedSource {
        path: path.to_owned(),
        content,
    });
    Ok(plan.calibrations.len() as u32 - 1)
}
