//! Keys of units, from sources down.

use std::collections::BTreeMap;

use rogs_schemas::{CacheKey, KeyMaterial, canonical_json};
use serde_json::Value;

use super::{From, Plan, Unit};

/// Key of a unit's output and what it is made of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnitKey {
    /// The key.
    pub key: CacheKey,
    /// What it is made of.
    pub material: KeyMaterial,
}

impl Plan {
    /// Parameters of a unit: the node's, and for ingest the clip's own laid over them.
    #[must_use]
    pub fn params(&self, unit: Unit) -> Value {
        let (clip, node) = (&self.clips[unit.clip], &self.nodes[unit.node]);
        let mut params = node.params.clone();
        if let Value::Object(params) = &mut params
            && node.stage == "ingest"
        {
            if !clip.selector.is_empty() {
                params.insert("episode".to_owned(), Value::String(clip.selector.clone()));
            }
            params.extend(clip.ingest.iter().map(|(name, value)| (name.clone(), value.clone())));
        }
        params
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
            let id = |from: &From| match from {
                From::Episode => Some(source.content.to_string()),
                From::Calibration => source
                    .calibration
                    .map(|index| plan.calibrations[index as usize].content.to_string()),
                From::Prediction(index) => source.prediction(*index).map(|content| content.to_string()),
                From::Latents => source.latents.map(|content| content.to_string()),
                // Nodes are ordered, so the upstream key is there already.
                From::Node(node) => Some(keys[*node].key.to_string()),
                From::Source(source) => Some(source.content.to_string()),
            };
            let inputs: BTreeMap<String, String> = node
                .inputs
                .iter()
                .filter_map(|input| Some((input.role.clone(), id(&input.from)?)))
                .collect();
            // Only ingest has parameters that differ between clips.
            let params = match node.stage.as_str() {
                "ingest" => canonical_json(&plan.params(Unit { clip, node: index })),
                _ => self.params[index].clone(),
            };
            let material = KeyMaterial {
                stage: node.stage.clone(),
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
