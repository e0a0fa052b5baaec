//! JSON values of parameters: canonical text, one table laid over another.

use serde::Serialize;
use serde_json::Value;

/// Canonical JSON text of a serialisable value: objects sorted by key, no white space.
///
/// # Panics
/// Never for the parameter types of the stages, which are plain structs.
#[must_use]
#[expect(clippy::expect_used, reason = "plain structs always become JSON")]
pub fn canonical_json<T: Serialize>(value: &T) -> String {
    // `serde_json::Value` keeps object keys sorted (the `preserve_order` feature is off).
    let value = serde_json::to_value(value).expect("parameters are plain data");
    value.to_string()
}

/// Lays `given` over `base`: tables name by name at any depth, every other value as a whole.
pub fn overlay(base: &mut Value, given: &Value) {
    match (base, given) {
        (Value::Object(base), Value::Object(given)) => {
            for (name, value) in given {
                overlay(base.entry(name.clone()).or_insert(Value::Null), value);
            }
        }
        (base, given) => *base = given.clone(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn tables_are_overlaid_name_by_name_and_other_values_as_a_whole() {
        let mut base = json!({"a": {"b": 1, "c": [1, 2]}, "d": 3});
        overlay(&mut base, &json!({"a": {"c": [3]}, "e": {"f": null}}));
        assert_eq!(base, json!({"a": {"b": 1, "c": [3]}, "d": 3, "e": {"f": null}}));
        overlay(&mut base, &json!({"a": 7}));
        assert_eq!(base["a"], 7);
    }
}
