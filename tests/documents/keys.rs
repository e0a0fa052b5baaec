//! Keys of manifests that texts name: each is one that the manifest reader accepts.

use std::path::Path;

use serde_json::Value;

use super::assert_none;
use super::text::{File, files, root};

/// The published schema; a test of the program holds that it is the reader's.
fn schema() -> Value {
    let text = std::fs::read_to_string(root().join("manifests/manifest.schema.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// What a schema says once references, choices and lists are followed: every object that a value may be.
fn meant<'a>(schema: &'a Value, here: &'a Value) -> Vec<&'a Value> {
    let mut out = vec![here];
    if let Some(reference) = here["$ref"].as_str() {
        out.extend(
            schema
                .pointer(&reference[1..])
                .map(|found| meant(schema, found))
                .unwrap_or_default(),
        );
    }
    for choices in ["anyOf", "oneOf", "allOf"] {
        let choices = here[choices].as_array().into_iter().flatten();
        out.extend(choices.flat_map(|choice| meant(schema, choice)));
    }
    if here["items"].is_object() {
        out.extend(meant(schema, &here["items"]));
    }
    out
}

/// Whether a manifest may have this key.
fn is_key(schema: &Value, path: &[&str]) -> bool {
    let mut here = meant(schema, schema);
    for part in path {
        let mut next = Vec::new();
        for place in &here {
            if let Some(found) = place["properties"].get(part) {
                next.extend(meant(schema, found));
            } else if place["additionalProperties"].is_object() || place["additionalProperties"] == true {
                next.extend(meant(schema, &place["additionalProperties"]));
            }
        }
        if next.is_empty() {
            return false;
        }
        here = next;
    }
    true
}

/// Tables that a text names as `[a.b]` or `[[a]]`, each with the keys that it sets or names behind it, and the line.
fn named(file: &File) -> Vec<(usize, Vec<String>)> {
    let mut out = Vec::new();
    for (number, line) in file.text.lines().enumerate() {
        for (at, _) in line.match_indices('[') {
            let inside = line[at..].trim_start_matches('[');
            let Some((name, behind)) = inside.split_once(']') else {
                continue;
            };
            let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '.' | '-' | '_');
            // Places in arrays and links to pages have brackets too.
            let index = line[..at].ends_with(|c: char| c.is_alphanumeric() || matches!(c, '_' | ')'));
            let begins = name.starts_with(|c: char| c.is_ascii_lowercase());
            if index
                || !begins
                || !name.chars().all(plain)
                || Path::new(name).extension().is_some_and(|end| end == "md")
            {
                continue;
            }
            let table: Vec<String> = name.split('.').map(str::to_owned).collect();
            // `[ingest] height = 84`: the key belongs to the table.
            let behind = behind.trim_start_matches(']').trim_start_matches(' ');
            let key: String = behind.chars().take_while(|&c| plain(c)).collect();
            if !key.is_empty() && behind[key.len()..].trim_start().starts_with("= ") {
                out.push((
                    number + 1,
                    table.iter().cloned().chain(key.split('.').map(str::to_owned)).collect(),
                ));
            }
            out.push((number + 1, table));
        }
    }
    out
}

/// Whether a file speaks to people of manifests.
fn speaks(file: &File) -> bool {
    let path = file.path.to_string_lossy();
    let source = path.ends_with(".rs") && path.contains("/src/");
    (source || file.is_page()) && !path.contains("tools/train") && !path.ends_with("training.md")
}

#[test]
fn keys_of_manifests_that_are_named_exist() {
    let schema = schema();
    let (mut wrong, mut keys) = (Vec::new(), 0);
    for file in files().iter().filter(|file| speaks(file)) {
        for (line, path) in named(file) {
            let path: Vec<&str> = path.iter().map(String::as_str).collect();
            // A first name that no manifest has is of another language: an attribute, an index, a table of Cargo.
            if path.len() < 2 || !is_key(&schema, &path[..1]) {
                continue;
            }
            keys += 1;
            if !is_key(&schema, &path) {
                wrong.push(format!("{}:{line}: `{}`", file.path.display(), path.join(".")));
            }
        }
    }
    assert_none(&wrong, "keys that no manifest has");
    assert!(keys > 10, "keys are not found any more: {keys}");
}

#[test]
fn keys_are_told_apart() {
    let schema = schema();
    for good in [
        "robot.spec.gripper_joint",
        "ingest.states.unit",
        "slurm.memory.lift",
        "weights.lift",
        "input.clips",
    ] {
        assert!(is_key(&schema, &good.split('.').collect::<Vec<_>>()), "{good}");
    }
    for bad in [
        "states.gripper",
        "params.robot-maps.robot",
        "ingest.gripper",
        "weights.builtin",
        "lift.weights",
    ] {
        assert!(!is_key(&schema, &bad.split('.').collect::<Vec<_>>()), "{bad}");
    }
}
