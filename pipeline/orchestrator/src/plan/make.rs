//! Making a plan from a manifest.

use super::clips::add_clips;
use super::model::{InputSource, Node, PLAN_FORMAT, Plan};
use super::nodes::make_nodes;
use crate::diagnose::Text;
use crate::error::Result;
use crate::manifest::Manifest;
use crate::programs::StagePrograms;
use crate::sources::SourceCache;

/// Makes the plan: asks the stage programs what they are, lists and hashes the sources. Writes nothing.
///
/// # Errors
/// When the manifest does not fit the stages or a source is missing; with line and column.
pub fn make_plan(manifest: &Manifest, text: &Text, programs: &StagePrograms, sources: &SourceCache) -> Result<Plan> {
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
        rollouts: rollouts.map(|rollouts| rollouts.root.clone()),
        rollout_latents: rollout_latents.and_then(|rollouts| rollouts.latents.clone()),
        clips: Vec::new(),
        nodes,
    };
    add_clips(&mut plan, manifest, text, programs, sources)?;
    Ok(plan)
}
