//! Units of a plan: their keys, from sources down, their places and their jobs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_schemas::protocol::{Job, JobId};
use rogs_schemas::{CacheKey, KeyMaterial, canonical_json};
use serde_json::Value;

use super::model::{InputSource, NodeInput, Plan, WorkUnit, latents_file};

/// Key of a unit's output and what it is made of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnitKey {
    /// The key.
    pub key: CacheKey,
    /// What it is made of.
    pub material: KeyMaterial,
}

impl Plan {
    /// Parameters of a unit: the node's, and where they may differ between clips the clip's own laid over them.
    #[must_use]
    pub fn params(&self, unit: WorkUnit) -> Value {
        let (clip, node) = (&self.clips[unit.clip], &self.nodes[unit.node]);
        let mut params = node.params.clone();
        if let (Value::Object(params), Some(selector)) = (&mut params, node.stage.spec().selector) {
            if !clip.selector.is_empty() {
                params.insert(selector.to_owned(), Value::String(clip.selector.clone()));
            }
            params.extend(clip.ingest.iter().map(|(name, value)| (name.clone(), value.clone())));
        }
        params
    }

    /// Where a unit's output goes, relative to the run folder.
    #[must_use]
    pub fn output(&self, unit: WorkUnit, keys: &[UnitKey]) -> PathBuf {
        let node = &self.nodes[unit.node];
        let mut path = Path::new("clips").join(&self.clips[unit.clip].id);
        if node.by_key {
            path.push(&keys[unit.node].key.to_string()[..16]);
        }
        path.join(&node.file)
    }

    /// The job of a unit. `keys` are those of its clip, see [`Plan::keys`].
    #[must_use]
    pub fn job(&self, number: JobId, unit: WorkUnit, keys: &[UnitKey]) -> Job {
        let (clip, node) = (&self.clips[unit.clip], &self.nodes[unit.node]);
        let path = |input: &NodeInput| match &input.from {
            InputSource::Episode => Some(self.roots[clip.root as usize].clone()),
            InputSource::Calibration => clip
                .calibration
                .map(|index| self.calibrations[index as usize].path.clone()),
            InputSource::Prediction(index) => clip
                .prediction(*index)
                .map(|_| self.predictions[*index as usize].join(&clip.id)),
            InputSource::Reference => clip.references.get(&input.role).map(|source| source.path.clone()),
            InputSource::Latents => {
                let root = self.latents.as_ref().filter(|_| clip.latents.is_some());
                root.map(|root| latents_file(root, &clip.id))
            }
            InputSource::Rollout => {
                let root = self.rollouts.as_ref()?;
                clip.rollout.as_ref().map(|rollout| root.join(&rollout.name))
            }
            InputSource::RolloutLatents => {
                let root = self.rollout_latents.as_ref().filter(|_| clip.rollout_latents.is_some());
                root.map(|root| latents_file(root, &clip.id))
            }
            InputSource::Sidecars => {
                let root = self.sidecars.as_ref().filter(|_| clip.sidecars.is_some());
                root.map(|root| root.join(&clip.id))
            }
            InputSource::RolloutSidecars => {
                let root = self
                    .rollout_sidecars
                    .as_ref()
                    .filter(|_| clip.rollout_sidecars.is_some());
                root.map(|root| root.join(&clip.id))
            }
            InputSource::Node(node) => Some(self.run.join(self.output(WorkUnit { node: *node, ..unit }, keys))),
            InputSource::Source(source) => Some(source.path.clone()),
        };
        let inputs = node
            .inputs
            .iter()
            .filter_map(|input| Some((input.role.clone(), path(input)?)));
        let UnitKey { key, material } = keys[unit.node].clone();
        Job {
            job: number,
            clip_id: clip.id.clone(),
            inputs: inputs.collect(),
            output: self.run.join(self.output(unit, keys)),
            params: self.params(unit),
            material,
            key,
        }
    }

    /// Keys of all units of a clip, by node. For many clips [`Plan::key_maker`] is faster.
    #[must_use]
    pub fn keys(&self, clip: usize) -> Vec<UnitKey> {
        self.key_maker().keys(clip)
    }

    /// Makes keys of one clip after the other; what all clips have in common is worked out once.
    #[must_use]
    pub fn key_maker(&self) -> KeyMaker<'_> {
        KeyMaker {
            plan: self,
            params: self.nodes.iter().map(|node| canonical_json(&node.params)).collect(),
        }
    }
}

/// Makes keys, see [`Plan::key_maker`].
#[derive(Debug, Clone)]
pub struct KeyMaker<'a> {
    plan: &'a Plan,
    /// Canonical parameters by node.
    params: Vec<String>,
}

impl KeyMaker<'_> {
    /// Keys of all units of a clip, by node.
    #[must_use]
    pub fn keys(&self, clip: usize) -> Vec<UnitKey> {
        let plan = self.plan;
        let source = &plan.clips[clip];
        let mut keys: Vec<UnitKey> = Vec::with_capacity(plan.nodes.len());
        for (index, node) in plan.nodes.iter().enumerate() {
            let id = |input: &NodeInput| match &input.from {
                InputSource::Episode => Some(source.content.to_string()),
                InputSource::Calibration => source
                    .calibration
                    .map(|index| plan.calibrations[index as usize].content.to_string()),
                InputSource::Prediction(index) => source.prediction(*index).map(|content| content.to_string()),
                InputSource::Reference => source
                    .references
                    .get(&input.role)
                    .map(|source| source.content.to_string()),
                InputSource::Latents => source.latents.map(|content| content.to_string()),
                InputSource::Rollout => source.rollout.as_ref().map(|rollout| rollout.content.to_string()),
                InputSource::RolloutLatents => source.rollout_latents.map(|content| content.to_string()),
                InputSource::Sidecars => source.sidecars.map(|content| content.to_string()),
                InputSource::RolloutSidecars => source.rollout_sidecars.map(|content| content.to_string()),
                // Nodes are ordered, so the upstream key is there already.
                InputSource::Node(node) => Some(keys[*node].key.to_string()),
                InputSource::Source(source) => Some(source.content.to_string()),
            };
            let inputs: BTreeMap<String, String> = node
                .inputs
                .iter()
                .filter_map(|input| Some((input.role.clone(), id(input)?)))
                .collect();
            let params = match node.stage.spec().selector {
                Some(_) => canonical_json(&plan.params(WorkUnit { clip, node: index })),
                None => self.params[index].clone(),
            };
            let material = KeyMaterial {
                stage: node.stage.to_string(),
                stage_version: node.stage_version,
                schema: node.schema.clone(),
                params,
                inputs,
            };
            keys.push(UnitKey {
                key: material.key(),
                material,
            });
        }
        keys
    }
}
