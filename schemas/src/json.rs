//! JSON: canonical text of parameters, one table laid over another, and files of strangers read with our own words.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use serde_json::error::{Category, Error};

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

/// Reads JSON that other programs and people wrote. A byte-order mark is left aside, and the `NaN` and `Infinity` that Python
/// writes and JSON does not have are taken as `null`.
///
/// # Errors
/// What is wrong and where, in words of the file: the key, the line, and what was expected.
pub fn read<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let text = text.trim_start_matches('\u{feff}');
    match serde_json::from_str(text) {
        Ok(value) => Ok(value),
        Err(error) if error.is_syntax() => match without_python_numbers(text) {
            Some(plain) => serde_json::from_str(&plain).map_err(|error| fault(&plain, &error)),
            None => Err(fault(text, &error)),
        },
        Err(error) => Err(fault(text, &error)),
    }
}

/// The text with `null` in place of bare `NaN`, `Infinity` and `-Infinity`; `None` where there are none.
fn without_python_numbers(text: &str) -> Option<String> {
    const WORDS: [&str; 3] = ["-Infinity", "Infinity", "NaN"];
    let (mut out, mut rest, mut found) = (String::with_capacity(text.len()), text, false);
    while let Some(at) = rest.find(['"', 'N', 'I', '-']) {
        let (before, from) = rest.split_at(at);
        out.push_str(before);
        if let Some(word) = WORDS.iter().find(|word| from.starts_with(**word)) {
            out.push_str("null");
            (rest, found) = (&from[word.len()..], true);
        } else if from.starts_with('"') {
            let end = end_of_string(from);
            out.push_str(&from[..end]);
            rest = &from[end..];
        } else {
            out.push_str(&from[..1]);
            rest = &from[1..];
        }
    }
    out.push_str(rest);
    found.then_some(out)
}

/// Bytes of the string that a text begins with, quotes included.
fn end_of_string(text: &str) -> usize {
    let mut escaped = false;
    for (at, byte) in text.bytes().enumerate().skip(1) {
        match byte {
            _ if escaped => escaped = false,
            b'\\' => escaped = true,
            b'"' => return at + 1,
            _ => {}
        }
    }
    text.len()
}

/// What is wrong with JSON, in words of the file.
fn fault(text: &str, error: &Error) -> String {
    let place = format!("line {}, column {}", error.line(), error.column());
    match error.classify() {
        Category::Eof if text.trim().is_empty() => "it is empty".to_owned(),
        Category::Eof => format!("it ends in the middle ({place}): is it cut off?"),
        Category::Syntax | Category::Io => {
            let line = text.lines().nth(error.line().saturating_sub(1)).unwrap_or_default();
            let from = error.column().saturating_sub(1).min(line.len());
            let from = (0..=from).rev().find(|&at| line.is_char_boundary(at)).unwrap_or(0);
            let found: String = line[from..].chars().take(24).collect();
            let why = match found.chars().next() {
                Some('/' | '#') => "; JSON has no comments",
                Some('\'') => "; JSON puts text in double quotes",
                Some('}' | ']') => "; a comma or a value too much before it?",
                _ => "",
            };
            format!("it is no JSON at {place}, `{found}`{why}")
        }
        Category::Data => {
            let what = error.to_string();
            let what = what.split(" at line ").next().unwrap_or_default();
            // What is missing has no place, and what is unknown names itself.
            let names_itself = what.starts_with("missing ") || what.starts_with("unknown ");
            let key = key_before(text, error).filter(|_| !names_itself);
            let key = key.map_or_else(String::new, |key| format!("`{key}`, "));
            format!("{key}{place}: {}", in_our_words(what))
        }
    }
}

/// The last key before the place of an error.
fn key_before<'a>(text: &'a str, error: &Error) -> Option<&'a str> {
    let before: usize = text
        .split_inclusive('\n')
        .take(error.line().saturating_sub(1))
        .map(str::len)
        .sum();
    let end = (before + error.column()).min(text.len());
    let mut rest = text.get(..end)?;
    // From the end: the last `"key":`.
    while let Some(colon) = rest.rfind(':') {
        rest = &rest[..colon];
        let Some(quoted) = rest.trim_end().strip_suffix('"') else {
            continue;
        };
        if let Some(open) = quoted.rfind('"') {
            let key = &quoted[open + 1..];
            if key.len() <= 80 {
                return Some(key);
            }
        }
    }
    None
}

/// The words of the library for a value of another type, in those of people.
fn in_our_words(what: &str) -> String {
    let named = |text: &str| {
        let plain = text.trim_start_matches("an ").trim_start_matches("a ");
        match plain {
            "u8" | "u16" | "u32" | "u64" | "usize" | "i32" | "i64" => "a whole number".to_owned(),
            "f32" | "f64" => "a number".to_owned(),
            "sequence" => "a list".to_owned(),
            "map" => "an object".to_owned(),
            "string" => "text in quotes".to_owned(),
            "boolean" => "`true` or `false`".to_owned(),
            _ if plain.starts_with("struct ") || plain.starts_with("internally tagged") => "an object".to_owned(),
            _ => text.to_owned(),
        }
    };
    if let Some(rest) = what
        .strip_prefix("invalid type: ")
        .or(what.strip_prefix("invalid value: "))
        && let Some((found, expected)) = rest.split_once(", expected ")
    {
        let found = match found.split_once(' ') {
            Some(("integer" | "floating", value)) => value.trim_start_matches("point ").to_owned(),
            Some(("string", value)) => format!("text, {value}"),
            Some(("boolean", value)) => value.to_owned(),
            _ => named(found),
        };
        return format!("it is {found}, expected {}", named(expected));
    }
    if let Some(rest) = what.strip_prefix("invalid length ")
        && let Some((length, expected)) = rest.split_once(", expected ")
    {
        let expected = expected.split(" with ").next().unwrap_or(expected);
        return match expected.starts_with("struct ") {
            true => format!("it is a list, expected {}", named(expected)),
            false => format!("it has {length} entries, expected {expected}"),
        };
    }
    if let Some(field) = what.strip_prefix("missing field ") {
        return format!("{field} is missing");
    }
    if what.starts_with("data did not match any variant") {
        return "it has none of the forms that are read".to_owned();
    }
    what.to_owned()
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

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Example {
        count: u32,
        #[serde(default)]
        size: Option<f64>,
        #[serde(default)]
        pair: [f64; 2],
        #[serde(default)]
        inner: Option<Inner>,
        #[serde(default)]
        note: String,
    }

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(untagged)]
    enum Inner {
        Number(f64),
        Text(String),
    }

    #[test]
    fn json_of_strangers_is_read() {
        let plain: Example = read(r#"{"count": 3, "size": 1.5, "note": "a"}"#).unwrap();
        for text in [
            "\u{feff}{\"count\": 3, \"size\": 1.5, \"note\": \"a\"}",
            "{\r\n\"count\": 3,\r\n\"size\": 1.5, \"note\": \"a\"}\r\n",
        ] {
            assert_eq!(read::<Example>(text).unwrap(), plain);
        }
        for word in ["NaN", "Infinity", "-Infinity"] {
            let text = format!(r#"{{"count": 3, "size": {word}, "note": "{word} \" -I NaN \\"}}"#);
            let found: Example = read(&text).unwrap();
            assert_eq!((found.size, found.note), (None, format!("{word} \" -I NaN \\")));
        }
    }

    #[test]
    fn faults_are_told_in_words_of_the_file() {
        for (text, words) in [
            ("", "it is empty"),
            ("  \n", "it is empty"),
            ("{\"count\": 3", "it ends in the middle (line 1, "),
            (
                "// a\n{}",
                "it is no JSON at line 1, column 1, `// a`; JSON has no comments",
            ),
            ("{'count': 3}", "JSON puts text in double quotes"),
            ("{\"count\": 3,}", "a comma or a value too much"),
            ("count: 3", "it is no JSON at line 1, column 1, `count: 3`"),
            ("[]", "it is a list, expected an object"),
            ("{\"count\": \"17\"}", "it is text, \"17\", expected a whole number"),
            ("{\"count\": 17.5}", "`count`, line 1, "),
            ("{\"count\": -1}", "it is `-1`, expected a whole number"),
            ("{\"count\": NaN}", "it is null, expected a whole number"),
            ("{\"count\": 1, \"pair\": [1]}", "it has 1 entries"),
            ("{\"count\": 1, \"pair\": 7}", "it is `7`, expected"),
            ("{\"size\": 1.0}", "`count` is missing"),
            (
                "{\"count\": 1, \"cuont\": 2}",
                "unknown field `cuont`, expected one of `count`, `size`",
            ),
            (
                "{\"count\": 1, \"inner\": [1]}",
                "it has none of the forms that are read",
            ),
        ] {
            let told = read::<Example>(text).unwrap_err();
            assert!(told.contains(words), "{text}: {told}");
        }
    }
}
