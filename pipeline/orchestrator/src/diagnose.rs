//! Errors in a manifest, with line, column and what was probably meant.

use std::fmt;
use std::path::{Path, PathBuf};

use rogs_schemas::ids::misspelt;
use toml_edit::{Document, Item, Table, TableLike, Value};

use crate::error::{Error, Place};

/// Where something stands in a manifest: keys and places in arrays, from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct At<'a> {
    steps: Vec<Step<'a>>,
}

/// One step on the way to a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step<'a> {
    /// The value of a key of a table.
    Key(&'a str),
    /// The n-th element of an array, from 0.
    Item(usize),
}

impl<'a> At<'a> {
    /// The manifest as a whole.
    #[must_use]
    pub fn top() -> Self {
        Self { steps: Vec::new() }
    }

    /// The value of a key at the top.
    #[must_use]
    pub fn key(name: &'a str) -> Self {
        Self::top().then(name)
    }

    /// The value of a key in it.
    #[must_use]
    pub fn then(mut self, name: &'a str) -> Self {
        self.steps.push(Step::Key(name));
        self
    }

    /// The n-th element of it, from 0.
    #[must_use]
    pub fn item(mut self, index: usize) -> Self {
        self.steps.push(Step::Item(index));
        self
    }
}

/// The keys alone: `variants.lift`.
impl fmt::Display for At<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let keys = self.steps.iter().filter_map(|step| match step {
            Step::Key(name) => Some(*name),
            Step::Item(_) => None,
        });
        f.write_str(&keys.collect::<Vec<_>>().join("."))
    }
}

/// A manifest's text, to find places in it.
///
/// `toml::Spanned` would keep a place beside every value, but in types that are also written as JSON, compared and shown as
/// a schema, and a parameter that a variant lays over the run's has no place of its own any more. So the types hold values
/// alone, and the text is walked once more when something in it is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Text {
    /// The file.
    pub path: PathBuf,
    /// What is in it.
    pub text: String,
}

impl Text {
    /// The text of a file.
    #[must_use]
    pub fn new(path: &Path, text: &str) -> Self {
        Self {
            path: path.to_owned(),
            text: text.to_owned(),
        }
    }

    /// An error at this place, or at the nearest table around it that is there.
    pub fn error(&self, at: At<'_>, message: impl Into<String>) -> Error {
        let at = self.find(&at).map(|offset| line_and_column(&self.text, offset));
        Error::Manifest {
            path: self.path.clone(),
            place: Place { at },
            message: message.into(),
            hint: None,
        }
    }

    /// An error about the name in a message such as ``unknown field `x`, expected one of `y`, `z` ``, at that name within
    /// the table at this place.
    #[must_use]
    pub fn unknown(&self, table: At<'_>, message: &str) -> Error {
        match misspelt(message) {
            Some((name, meant)) => suggest(self.error(table.then(name), message), meant),
            None => self.error(table, message),
        }
    }

    /// Lines, from 1, at which the values of these places stand; none for one that the text does not give.
    pub(crate) fn lines<'a>(&self, places: impl Iterator<Item = At<'a>>) -> Vec<Option<usize>> {
        let Ok(document) = Document::parse(self.text.as_str()) else {
            return places.map(|_| None).collect();
        };
        let line = |at: At<'a>| {
            let (offset, steps) = walk(document.as_item(), &at);
            let whole = offset.filter(|_| steps == at.steps.len());
            whole.map(|offset| line_and_column(&self.text, offset).0)
        };
        places.map(line).collect()
    }

    /// Byte offset of a place, as far as the way leads.
    fn find(&self, at: &At<'_>) -> Option<usize> {
        let document = Document::parse(self.text.as_str()).ok()?;
        walk(document.as_item(), at).0
    }
}

/// Byte offset of a place, as far as the way leads, and how many of its steps do.
fn walk(document: &Item, at: &At<'_>) -> (Option<usize>, usize) {
    let (mut here, mut found) = (Found::Item(document), None);
    for (taken, step) in at.steps.iter().enumerate() {
        let Some((offset, next)) = here.step(*step) else {
            return (found, taken);
        };
        (here, found) = (next, offset.or(found));
    }
    (found, at.steps.len())
}

/// A value on the way to a place.
#[derive(Clone, Copy)]
enum Found<'a> {
    Item(&'a Item),
    Table(&'a Table),
    Value(&'a Value),
}

impl<'a> Found<'a> {
    /// One step further, with the byte offset of what stands there.
    fn step(self, step: Step<'_>) -> Option<(Option<usize>, Self)> {
        match step {
            Step::Key(name) => {
                let table: &dyn TableLike = match self {
                    Found::Item(item) => item.as_table_like()?,
                    Found::Table(table) => table,
                    Found::Value(value) => value.as_inline_table()?,
                };
                let (key, item) = table.get_key_value(name)?;
                Some((key.span().map(|span| span.start), Found::Item(item)))
            }
            Step::Item(index) => {
                let Found::Item(item) = self else { return None };
                if let Some(tables) = item.as_array_of_tables() {
                    let table = tables.get(index)?;
                    return Some((table.span().map(|span| span.start), Found::Table(table)));
                }
                let value = item.as_array()?.get(index)?;
                Some((value.span().map(|span| span.start), Found::Value(value)))
            }
        }
    }
}

/// The error with the name that was probably meant.
fn suggest(error: Error, meant: Option<&str>) -> Error {
    match meant {
        Some(meant) => error.with_hint(format!("did you mean `{meant}`?")),
        None => error,
    }
}

/// Turns an error of the TOML reader into one of ours.
pub(crate) fn from_toml_error(text: &Text, error: &toml::de::Error) -> Error {
    let message = error.message().trim().replace('\n', ", ");
    let at = error.span().map(|span| line_and_column(&text.text, span.start));
    let meant = misspelt(&message).and_then(|(_, meant)| meant.map(str::to_owned));
    let line = at
        .and_then(|(line, _)| text.text.lines().nth(line - 1))
        .unwrap_or_default();
    // A path of Windows in double quotes: `"C:\Users"` asks for a character by its number, `"D:\data"` for none there is.
    let escape =
        line.contains('"') && line.contains('\\') && ["escape", "unicode"].iter().any(|word| message.contains(word));
    let (message, hint) = if escape {
        let message = "in double quotes a backslash begins an escape, and this is none".to_owned();
        (message, Some(WINDOWS_PATHS.to_owned()))
    } else {
        (message, None)
    };
    let error = Error::Manifest {
        path: text.path.clone(),
        place: Place { at },
        message,
        hint,
    };
    suggest(error, meant.as_deref())
}

const WINDOWS_PATHS: &str = "write paths with `/`, or in single quotes, where a backslash is a backslash";

/// What to do about a path of a manifest at which nothing is.
pub(crate) fn path_hint(path: &Path) -> &'static str {
    let text = path.to_string_lossy();
    if text.contains(|c: char| c.is_control()) {
        // `"D:\temp\new"` is read with a tab and a line end in it.
        return "in double quotes a backslash begins an escape (`\\t` is a tab): write paths with `/` or in single quotes";
    }
    if text.contains('\\') {
        return "a backslash separates no folders on this system: write paths with `/`";
    }
    let has = |sign: &str| {
        path.components()
            .any(|part| part.as_os_str().to_string_lossy().starts_with(sign))
    };
    if has("~") || has("$") {
        return "`~` and variables such as `$HOME` are not expanded: write the path out, or relative to the manifest's folder";
    }
    "paths in a manifest are relative to the manifest's folder"
}

/// A path for a message: control characters are shown as escapes.
pub(crate) fn shown(path: &Path) -> String {
    let escaped = |c: char| {
        if c.is_control() {
            c.escape_default().to_string()
        } else {
            c.to_string()
        }
    };
    path.to_string_lossy().chars().map(escaped).collect()
}

/// Line and column, from 1, of a byte offset.
fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let before = &text.as_bytes()[..offset.min(text.len())];
    let line = before.iter().filter(|&&byte| byte == b'\n').count() + 1;
    let start = before.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
    (line, String::from_utf8_lossy(&before[start..]).chars().count() + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "[run]\nname = \"n\"\n[[variants]]\nname = \"a\"\nlift.seed = 1\n[[variants]]\nname = \"b\"\n\
                        lift = { seed = 2 }\n[robot]\nlist = [{ x = 1 }, { y = 2 }]\n";

    #[test]
    fn paths_of_other_worlds_get_a_way_on() {
        let manifest = |text: &str| {
            let source = Text::new(Path::new("m.toml"), text);
            from_toml_error(&source, &toml::from_str::<toml::Table>(text).unwrap_err())
        };
        for text in ["a = \"C:\\Users\"\n", "a = \"D:\\data\"\n", "b = 1\na = \"C:\\x\"\n"] {
            let error = manifest(text);
            assert!(error.to_string().contains("a backslash begins an escape"), "{error}");
            assert_eq!(error.hint().as_deref(), Some(WINDOWS_PATHS));
        }
        assert_eq!(manifest("a = \n").hint(), None);
        for (path, words) in [
            ("/m/D:\temp\new", "single quotes"),
            ("/m/D:\\data", "with `/`"),
            ("/m/~/episodes", "not expanded"),
            ("/m/$HOME/episodes", "not expanded"),
            ("/m/episodes", "relative to the manifest's folder"),
        ] {
            assert!(path_hint(Path::new(path)).contains(words), "{path:?}");
        }
        assert_eq!(shown(Path::new("a\tb")), "a\\tb");
    }

    #[test]
    fn places_of_keys_and_elements_are_found_or_the_nearest_around_them() {
        let text = Text::new(Path::new("m.toml"), TEXT);
        let at = |at: At<'_>| text.error(at, "wrong").to_string();
        let variant = |index| At::key("variants").item(index);
        assert_eq!(at(At::top()), "m.toml: wrong");
        assert_eq!(at(At::key("run").then("name")), "m.toml:2:1: wrong");
        assert_eq!(at(variant(0).then("lift").then("seed")), "m.toml:5:6: wrong");
        assert_eq!(at(variant(1).then("lift").then("seed")), "m.toml:8:10: wrong");
        // The second variant has no such table, the third is not there, and the first is not meant instead.
        assert_eq!(at(variant(1).then("refine").then("seed")), "m.toml:6:1: wrong");
        assert_eq!(at(variant(1)), "m.toml:6:1: wrong");
        assert_eq!(
            at(At::key("robot").then("list").item(1).then("y")),
            "m.toml:10:22: wrong"
        );
        assert_eq!(at(At::key("gone")), "m.toml: wrong");
    }

    #[test]
    fn unknown_names_are_marked_and_suggested() {
        let text = Text::new(Path::new("m.toml"), TEXT);
        let error = text.unknown(At::key("run"), "unknown field `name`, expected one of `nane`, `other`");
        assert!(error.to_string().starts_with("m.toml:2:1: unknown field"), "{error}");
        assert_eq!(error.hint().as_deref(), Some("did you mean `nane`?"));
    }
}
