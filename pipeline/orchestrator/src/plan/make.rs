//! Making a plan from a manifest.

use std::path::Path;

use super::clips::add_clips;
use super::model::{InputSource, Node, PLAN_FORMAT, Plan};
use super::nodes::make_nodes;
use crate::diagnose::{At, Text, path_hint, shown};
use crate::error::Result;
use crate::manifest::{Chosen, Manifest};
use crate::programs::StagePrograms;
use crate::sources::SourceCache;
use crate::stage::WeightsRole;

/// Makes the plan: asks the stage programs what they are, lists and hashes the sources. Writes nothing.
///
/// # Errors
/// When the manifest does not fit the stages or a source is missing; with line and column.
pub fn make_plan(manifest: &Manifest, text: &Text, programs: &StagePrograms, sources: &SourceCache) -> Result<Plan> {
    refuse_missing(manifest, text)?;
    let nodes = make_nodes(manifest, text, programs, sources)?;
    let reads_latents = |node: &Node| node.inputs.iter().any(|input| input.from == InputSource::Latents);
    let latents = manifest.latents.as_ref().filter(|_| nodes.iter().any(reads_latents));
    let reads = |from: InputSource| {
        nodes
            .iter()
            .flat_map(|node| &node.inputs)
            .any(|input| input.from == from)
    };
    let rollouts = manifest.rollouts.as_ref().filter(|_| reads(InputSource::Rollout));
    let rollout_latents = rollouts.filter(|_| reads(InputSource::RolloutLatents));
    let sidecars = manifest.sidecars.as_ref().filter(|_| reads(InputSource::Sidecars));
    let rollout_sidecars = rollouts.filter(|_| reads(InputSource::RolloutSidecars));
    let settings: Vec<&str> = manifest.settings().iter().map(|setting| setting.name()).collect();
    let mut plan = Plan {
        format: PLAN_FORMAT.to_owned(),
        name: manifest.run.name.clone(),
        run: manifest.run.out.clone(),
        manifest: text.path.clone(),
        setting: settings.join(", "),
        variants: std::iter::once("main")
            .chain(manifest.variants.iter().map(|variant| variant.name.as_str()))
            .map(String::from)
            .collect(),
        selection: None,
        roots: Vec::new(),
        calibrations: Vec::new(),
        predictions: manifest.predictions.iter().map(|own| own.root.clone()).collect(),
        latents: latents.map(|latents| latents.root.clone()),
        sidecars: sidecars.map(|sidecars| sidecars.root.clone()),
        rollout_sidecars: rollout_sidecars.and_then(|rollouts| rollouts.sidecars.clone()),
        rollouts: rollouts.map(|rollouts| rollouts.root.clone()),
        rollout_latents: rollout_latents.and_then(|rollouts| rollouts.latents.clone()),
        clips: Vec::new(),
        nodes,
    };
    add_clips(&mut plan, manifest, text, programs, sources)?;
    Ok(plan)
}

/// Refuses a manifest that names several files and folders that are not there: all of them at once. One alone is left to
/// who reads it and knows more.
fn refuse_missing(manifest: &Manifest, text: &Text) -> Result<()> {
    let mut named: Vec<(At<'_>, &Path)> = vec![(At::key("robot").then("urdf"), &manifest.robot.urdf)];
    if let Some(input) = &manifest.input {
        let at = || At::key("input");
        named.push((at().then("root"), &input.root));
        named.extend(
            input
                .calibration
                .iter()
                .map(|path| (at().then("calibration"), path.as_path())),
        );
        named.extend(
            input
                .selection
                .iter()
                .map(|path| (at().then("selection"), path.as_path())),
        );
        named.extend(
            input
                .pointworld
                .iter()
                .map(|path| (at().then("pointworld"), path.as_path())),
        );
    }
    for (index, episode) in manifest.episodes.iter().enumerate() {
        let at = || At::key("episodes").item(index);
        named.push((at().then("root"), &episode.root));
        named.extend(
            episode
                .calibration
                .iter()
                .map(|path| (at().then("calibration"), path.as_path())),
        );
    }
    for (index, prediction) in manifest.predictions.iter().enumerate() {
        named.push((At::key("predictions").item(index).then("root"), &prediction.root));
    }
    for role in [
        WeightsRole::Lift,
        WeightsRole::Refine,
        WeightsRole::Lpips,
        WeightsRole::Adapter,
    ] {
        if let Some(Chosen::File(path)) = manifest.weights.get(role) {
            named.push((At::key("weights").then(role.key()), path));
        }
    }
    let mut missing = named.into_iter().filter(|(_, path)| !path.exists());
    let (Some((at, first)), Some(second)) = (missing.next(), missing.next()) else {
        return Ok(());
    };
    let others: Vec<String> = std::iter::once(second)
        .chain(missing)
        .take(MOST_NAMED)
        .map(|(at, path)| format!("`{}` ({at})", shown(path)))
        .collect();
    let error = text.error(
        at,
        format!("`{}` is not there, nor {}", shown(first), others.join(", ")),
    );
    Err(error.with_hint(path_hint(first)))
}

/// Most missing paths that an error names beside the first.
const MOST_NAMED: usize = 8;
