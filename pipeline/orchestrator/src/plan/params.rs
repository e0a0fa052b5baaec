//! Parameters that a clip has of its own.

use std::collections::HashMap;

use rogs_schemas::{canonical_json, overlay};
use serde_json::{Map, Value};

use super::model::Node;
use crate::error::Result;
use crate::manifest::Params;
use crate::programs::StagePrograms;

/// Normalises parameters that a clip has of its own: those names of what the stage makes of them.
pub(super) fn normalise_overrides(
    programs: &StagePrograms,
    node: &Node,
    given: &Params,
    cache: &mut HashMap<String, Map<String, Value>>,
) -> Result<Map<String, Value>> {
    if given.is_empty() {
        return Ok(Map::new());
    }
    let text = canonical_json(given);
    if let Some(known) = cache.get(&text) {
        return Ok(known.clone());
    }
    let mut params = node.params.clone();
    overlay(&mut params, &Value::Object(given.clone()));
    let normalised = programs.describe(node.stage, &params)?.default_params;
    let take = |name: &String| Some((name.clone(), normalised.get(name)?.clone()));
    let map: Map<String, Value> = given.keys().filter_map(take).collect();
    cache.insert(text, map.clone());
    Ok(map)
}
