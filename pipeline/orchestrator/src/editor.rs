//! The JSON schema of manifests that editors complete and check against: the manifest's own tables, and in them the
//! parameters of every stage as its program describes them.

use serde_json::{Map, Value, json};

use crate::error::Result;
use crate::manifest::Manifest;
use crate::programs::StagePrograms;
use crate::stage::{Filled, StageId};

/// Name that the published schema goes by.
const TITLE: &str = "rogs run manifest";

/// Tables that hold parameters of stages besides those at the top: definition, and of which stages.
const TABLES: [(&str, &[StageId]); 5] = [
    ("Variant", StageId::ALL),
    ("Episode", &[StageId::Ingest]),
    ("Input", &[StageId::Ingest]),
    ("Prediction", &[StageId::Score]),
    ("Baseline", &[StageId::Score]),
];

/// The schema of manifests for these stage programs.
///
/// # Errors
/// When a stage program cannot be asked.
pub fn manifest_schema(programs: &StagePrograms) -> Result<Value> {
    let mut schema = Manifest::json_schema();
    let mut definitions = Map::new();
    for &stage in StageId::ALL {
        let params = programs.describe(stage, &json!({}))?.params_schema;
        add_stage(&mut definitions, stage, params);
    }
    let reference = |stage: StageId, description: Value| {
        // Words beside a reference are allowed; the stage's own still say what the table is.
        json!({"$ref": format!("#/$defs/{stage}"), "description": description})
    };
    let mut fill = |place: &str, stages: &[StageId]| {
        for &stage in stages {
            if let Some(table) = schema.pointer_mut(&format!("{place}/properties/{stage}")) {
                let description = table.get("description").cloned().unwrap_or_default();
                *table = reference(stage, description);
            }
        }
    };
    fill("", StageId::ALL);
    for (definition, stages) in TABLES {
        fill(&format!("/$defs/{definition}"), stages);
    }
    if let Some(all) = schema.get_mut("$defs").and_then(Value::as_object_mut) {
        all.extend(definitions);
    }
    if let Some(top) = schema.as_object_mut() {
        top.insert("title".to_owned(), TITLE.into());
    }
    Ok(schema)
}

/// Puts the schema of a stage's parameters under the stage's name, with what it refers to under names of its own.
fn add_stage(definitions: &mut Map<String, Value>, stage: StageId, mut params: Value) {
    rename_references(&mut params, stage);
    let Some(table) = params.as_object_mut() else { return };
    table.remove("$schema");
    // What [weights] says is no parameter of a manifest.
    let own = stage.spec().filled.iter();
    let of_weights = own.filter(|(_, filled)| matches!(filled, Filled::Weights(_)));
    if let Some(properties) = table.get_mut("properties").and_then(Value::as_object_mut) {
        of_weights.for_each(|(name, _)| drop(properties.remove(*name)));
    }
    // A misspelt parameter is an error of the plan, so the editor may say so too.
    table.insert("additionalProperties".to_owned(), false.into());
    if let Some(Value::Object(own)) = table.remove("$defs") {
        definitions.extend(own.into_iter().map(|(name, value)| (format!("{stage}.{name}"), value)));
    }
    definitions.insert(stage.to_string(), params);
}

fn rename_references(value: &mut Value, stage: StageId) {
    match value {
        Value::Object(table) => {
            for (key, value) in table.iter_mut() {
                match value {
                    Value::String(text) if key == "$ref" => {
                        if let Some(name) = text.strip_prefix("#/$defs/") {
                            *text = format!("#/$defs/{stage}.{name}");
                        }
                    }
                    other => rename_references(other, stage),
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(|item| rename_references(item, stage)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definitions_of_stages_keep_apart() {
        let params = |kind: &str| {
            json!({"$schema": "x", "type": "object", "properties": {"a": {"anyOf": [{"$ref": "#/$defs/A"}, {"type": "null"}]}},
                "$defs": {"A": {"type": kind}}})
        };
        let mut definitions = Map::new();
        add_stage(&mut definitions, StageId::Lift, params("string"));
        add_stage(&mut definitions, StageId::Score, params("number"));
        assert_eq!(definitions["lift.A"], json!({"type": "string"}));
        assert_eq!(definitions["score.A"], json!({"type": "number"}));
        assert_eq!(
            definitions["score"]["properties"]["a"]["anyOf"][0]["$ref"],
            "#/$defs/score.A"
        );
        assert_eq!(definitions["lift"]["additionalProperties"], false);
        assert!(definitions["lift"].get("$schema").is_none());
    }
}
