//! Reading parameters from JSON and from the command line.

use rogs_schemas::{canonical_json, overlay};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use crate::error::{StageError, StageResult};

/// Builds parameters from a JSON value that may leave out any of them.
///
/// # Errors
/// When a name is unknown or a value has the wrong type.
pub fn parse_params<P: Serialize + DeserializeOwned + Default>(given: &Value) -> StageResult<P> {
    let given = if given.is_null() {
        &Value::Object(Map::new())
    } else {
        given
    };
    if !given.is_object() {
        return Err(StageError::bad_params(format!(
            "parameters must be a table of names and values, not `{given}`"
        )));
    }
    let params = serde_json::from_value::<P>(given.clone()).or_else(|direct| {
        // A parameter struct without serde defaults: fill the gaps from `Default`.
        let mut merged = serde_json::to_value(P::default()).map_err(|error| error.to_string())?;
        overlay(&mut merged, given);
        serde_json::from_value(merged).map_err(|_| direct.to_string())
    });
    let params = params.map_err(|why: String| StageError::bad_params(format!("wrong parameters: {why}")))?;
    let understood = serde_json::to_value(&params).map_err(|error| StageError::bad_params(error.to_string()))?;
    match unknown_name(given, &understood, "") {
        None => Ok(params),
        Some((name, names)) => Err(StageError::bad_params(format!("unknown parameter `{name}`"))
            .with_hint(format!("known here: {}", names.join(", ")))),
    }
}

/// Canonical JSON of parameters given as JSON, with the defaults filled in.
pub(crate) fn canonical<P: Serialize>(params: &P) -> String {
    canonical_json(params)
}

/// A name in `given` that the understood parameters do not have, with those that they do have.
fn unknown_name(given: &Value, understood: &Value, prefix: &str) -> Option<(String, Vec<String>)> {
    let (Value::Object(given), Value::Object(understood)) = (given, understood) else {
        return None;
    };
    given.iter().find_map(|(name, value)| match understood.get(name) {
        None => Some((format!("{prefix}{name}"), understood.keys().cloned().collect())),
        Some(known) => unknown_name(value, known, &format!("{prefix}{name}.")),
    })
}

/// Reads what a person passes to `--params`: a JSON object, `@FILE` with one, or `NAME=VALUE` with dots for nesting.
pub(crate) fn read_arguments(arguments: &[String]) -> StageResult<Value> {
    let mut all = Value::Object(Map::new());
    for argument in arguments {
        let value = if let Some(file) = argument.strip_prefix('@') {
            let text = std::fs::read_to_string(file)
                .map_err(|error| StageError::bad_params(format!("cannot read parameters from `{file}`: {error}")))?;
            parse_object(&text, file)?
        } else if argument.trim_start().starts_with('{') {
            parse_object(argument, "--params")?
        } else if let Some((name, text)) = argument.split_once('=') {
            let value = serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()));
            let nest = |value, name: &str| Value::Object(Map::from_iter([(name.trim().to_owned(), value)]));
            name.rsplit('.').fold(value, nest)
        } else {
            return Err(StageError::bad_params(format!("invalid parameter `{argument}`"))
                .with_hint("write NAME=VALUE, a JSON object, or @FILE"));
        };
        overlay(&mut all, &value);
    }
    Ok(all)
}

fn parse_object(text: &str, place: &str) -> StageResult<Value> {
    let value: Value = serde_json::from_str(text)
        .map_err(|error| StageError::bad_params(format!("parameters in `{place}` are not JSON: {error}")))?;
    if value.is_object() {
        Ok(value)
    } else {
        Err(StageError::bad_params(format!("`{place}` holds no JSON object")))
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;
    use serde_json::json;

    use super::*;

    #[derive(Debug, Serialize, Deserialize, PartialEq)]
    struct Inner {
        depth: u32,
        rate: f32,
    }

    #[derive(Debug, Serialize, Deserialize, PartialEq)]
    struct Params {
        inner: Inner,
        name: String,
        cap: Option<f64>,
    }

    impl Default for Params {
        fn default() -> Self {
            Self {
                inner: Inner { depth: 3, rate: 0.5 },
                name: "a".into(),
                cap: None,
            }
        }
    }

    #[test]
    fn missing_parameters_take_their_defaults_at_any_depth() {
        let params: Params = parse_params(&json!({"inner": {"depth": 7}})).unwrap();
        assert_eq!(
            params,
            Params {
                inner: Inner { depth: 7, rate: 0.5 },
                ..Params::default()
            }
        );
        assert_eq!(parse_params::<Params>(&Value::Null).unwrap(), Params::default());
    }

    #[test]
    fn unknown_and_ill_typed_parameters_are_named() {
        let error = parse_params::<Params>(&json!({"inner": {"depht": 7}})).unwrap_err();
        assert!(error.message.contains("inner.depht"), "{error}");
        assert!(error.hint.unwrap().contains("depth"));
        assert!(
            parse_params::<Params>(&json!({"name": 3}))
                .unwrap_err()
                .message
                .contains("expected a string")
        );
        assert!(parse_params::<Params>(&json!([1])).is_err());
    }

    #[test]
    fn arguments_nest_by_dots_and_later_ones_win() {
        let arguments = [
            "inner.depth=4",
            "name=plain text",
            r#"{"cap": 1.5, "inner": {"depth": 5}}"#,
        ]
        .map(String::from);
        assert_eq!(
            read_arguments(&arguments).unwrap(),
            json!({"inner": {"depth": 5}, "name": "plain text", "cap": 1.5})
        );
        assert!(read_arguments(&["nothing".to_owned()]).is_err());
    }
}
