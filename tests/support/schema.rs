//! Whether a JSON value is as a schema says: the part of draft 2020-12 that schemas made of Rust types use.

use std::collections::BTreeSet;

use serde_json::{Map, Value};

/// Checks a value.
///
/// # Errors
/// The first place that is not as the schema says; an entry that the schema does not know is one too.
pub(crate) fn check(schema: &Value, value: &Value) -> Result<(), String> {
    Checker { root: schema }.check(schema, value, "$")
}

struct Checker<'a> {
    root: &'a Value,
}

/// What this checker knows; another word in a schema is an error, so that no part of one is passed over in silence.
const KNOWN: [&str; 21] = [
    "$schema",
    "$id",
    "$defs",
    "$ref",
    "title",
    "description",
    "default",
    "format",
    "type",
    "const",
    "enum",
    "properties",
    "required",
    "additionalProperties",
    "items",
    "prefixItems",
    "minItems",
    "maxItems",
    "minimum",
    "pattern",
    "maximum",
];

impl Checker<'_> {
    fn check(&self, schema: &Value, value: &Value, place: &str) -> Result<(), String> {
        let Some(words) = schema.as_object() else {
            return if schema == &Value::Bool(true) {
                Ok(())
            } else {
                Err(format!("{place}: nothing may stand here"))
            };
        };
        let unions = ["anyOf", "oneOf", "allOf"];
        if let Some(word) = words
            .keys()
            .find(|word| !KNOWN.contains(&word.as_str()) && !unions.contains(&word.as_str()))
        {
            return Err(format!("{place}: the test does not know `{word}`"));
        }
        if let Some(target) = words.get("$ref") {
            self.check(self.definition(target), value, place)?;
        }
        for part in words.get("allOf").and_then(Value::as_array).into_iter().flatten() {
            self.check(part, value, place)?;
        }
        for union in ["anyOf", "oneOf"] {
            let Some(parts) = words.get(union).and_then(Value::as_array) else {
                continue;
            };
            // A choice knows what stands beside the choices, too.
            let beside = |part: &Value| {
                let mut part = part.clone();
                if let (Some(own), Some(Value::Object(more))) = (part.as_object_mut(), words.get("properties")) {
                    let known = own.entry("properties").or_insert_with(|| Map::new().into());
                    for (name, schema) in more {
                        known[name] = schema.clone();
                    }
                }
                part
            };
            let wrong: Vec<String> = parts
                .iter()
                .filter_map(|part| self.check(&beside(part), value, place).err())
                .collect();
            let fit = parts.len() - wrong.len();
            if fit == 0 || union == "oneOf" && fit > 1 {
                return Err(format!(
                    "{place}: {fit} of {} choices fit: {}",
                    parts.len(),
                    wrong.join("; ")
                ));
            }
        }
        self.own(words, value, place)?;
        match value {
            Value::Object(entries) => self.object(schema, words, entries, place),
            Value::Array(items) => self.array(words, items, place),
            _ => Ok(()),
        }
    }

    fn definition(&self, target: &Value) -> &Value {
        let pointer = target.as_str().unwrap().strip_prefix('#').expect("within the schema");
        self.root.pointer(pointer).expect("a definition")
    }

    fn own(&self, words: &Map<String, Value>, value: &Value, place: &str) -> Result<(), String> {
        let is = |kind: &Value| match kind.as_str().unwrap() {
            "null" => value.is_null(),
            "boolean" => value.is_boolean(),
            "integer" => value.is_i64() || value.is_u64(),
            "number" => value.is_number(),
            "string" => value.is_string(),
            "array" => value.is_array(),
            "object" => value.is_object(),
            other => panic!("no type `{other}`"),
        };
        let fits = match words.get("type") {
            Some(Value::Array(kinds)) => kinds.iter().any(is),
            Some(kind) => is(kind),
            None => true,
        };
        let allowed = words
            .get("enum")
            .is_none_or(|all| all.as_array().unwrap().contains(value));
        let same = words.get("const").is_none_or(|only| only == value);
        let (least, most) = (words.get("minimum"), words.get("maximum"));
        let number = |bound: &Value| bound.as_f64().unwrap();
        let within = value.as_f64().is_none_or(|own| {
            least.is_none_or(|least| own >= number(least)) && most.is_none_or(|most| own <= number(most))
        });
        // All patterns are of one form: digits, so many of them.
        let hex = words.get("pattern").is_none_or(|pattern| {
            let count = pattern
                .as_str()
                .unwrap()
                .strip_prefix("^[0-9a-f]{")
                .expect("hexadecimal digits");
            let count: usize = count.strip_suffix("}$").unwrap().parse().unwrap();
            let text = value.as_str().unwrap_or_default();
            text.len() == count && text.bytes().all(|digit| digit.is_ascii_hexdigit())
        });
        if fits && allowed && same && within && hex {
            Ok(())
        } else {
            Err(format!(
                "{place}: {value} is not as `{}` says",
                Value::Object(words.clone())
            ))
        }
    }

    fn object(
        &self,
        schema: &Value,
        words: &Map<String, Value>,
        entries: &Map<String, Value>,
        place: &str,
    ) -> Result<(), String> {
        let required = words.get("required").and_then(Value::as_array).into_iter().flatten();
        for name in required.filter_map(Value::as_str) {
            if !entries.contains_key(name) {
                return Err(format!("{place}: `{name}` is missing"));
            }
        }
        let properties = words.get("properties").and_then(Value::as_object);
        for (name, value) in entries {
            let place = format!("{place}.{name}");
            if let Some(schema) = properties.and_then(|properties| properties.get(name)) {
                self.check(schema, value, &place)?;
            } else if let Some(schema) = words.get("additionalProperties") {
                self.check(schema, value, &place)?;
            }
        }
        let mut known = BTreeSet::new();
        if words.contains_key("properties")
            && self.known(schema, &mut known)
            && let Some(other) = entries.keys().find(|name| !known.contains(name.as_str()))
        {
            return Err(format!("{place}: the schema does not know `{other}`"));
        }
        Ok(())
    }

    /// The names that a schema and its parts know; false where any name may stand.
    fn known<'b>(&'b self, schema: &'b Value, names: &mut BTreeSet<&'b str>) -> bool {
        if schema
            .get("additionalProperties")
            .is_some_and(|other| other != &Value::Bool(false))
        {
            return false;
        }
        let properties = schema.get("properties").and_then(Value::as_object);
        names.extend(properties.into_iter().flat_map(Map::keys).map(String::as_str));
        let parts = ["anyOf", "oneOf", "allOf"]
            .into_iter()
            .filter_map(|union| schema.get(union)?.as_array());
        let target = schema.get("$ref").map(|target| self.definition(target));
        parts.flatten().chain(target).all(|part| self.known(part, names))
    }

    fn array(&self, words: &Map<String, Value>, items: &[Value], place: &str) -> Result<(), String> {
        let count = |word: &str| words.get(word).and_then(Value::as_u64).map(|count| count as usize);
        if count("minItems").is_some_and(|least| items.len() < least)
            || count("maxItems").is_some_and(|most| items.len() > most)
        {
            return Err(format!("{place}: {} items", items.len()));
        }
        let first = words
            .get("prefixItems")
            .and_then(Value::as_array)
            .map_or(&[][..], Vec::as_slice);
        for (index, item) in items.iter().enumerate() {
            if let Some(schema) = first.get(index).or(words.get("items")) {
                self.check(schema, item, &format!("{place}[{index}]"))?;
            }
        }
        Ok(())
    }
}

#[test]
fn what_is_not_as_the_schema_says_is_found() {
    use serde_json::json;
    let schema = json!({
        "type": "object", "required": ["a"],
        "properties": {"a": {"type": "integer", "minimum": 0}, "b": {"$ref": "#/$defs/Words"}},
        "$defs": {"Words": {"type": ["array", "null"], "items": {"enum": ["x", "y"]}}},
    });
    assert_eq!(check(&schema, &json!({"a": 1, "b": ["x", "y"]})), Ok(()));
    assert_eq!(check(&schema, &json!({"a": 1, "b": null})), Ok(()));
    for (wrong, place) in [
        (json!({}), "`a` is missing"),
        (json!({"a": 1.5}), "$.a"),
        (json!({"a": -1}), "$.a"),
        (json!({"a": 1, "b": ["x", "z"]}), "$.b[1]"),
        (json!({"a": 1, "c": 0}), "does not know `c`"),
        (json!([]), "$: [] is not"),
    ] {
        let error = check(&schema, &wrong).unwrap_err();
        assert!(error.contains(place), "{error}");
    }
    assert!(
        check(&json!({"not": {}}), &json!(1)).is_err(),
        "what the test does not know is no silent yes"
    );
}
