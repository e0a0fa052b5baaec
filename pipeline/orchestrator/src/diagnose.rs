//! Errors in a manifest, with line, column and what was probably meant.

use std::path::{Path, PathBuf};

use toml_edit::{Document, Item};

use crate::error::{Error, Place, Result, did_you_mean};
use crate::manifest::STAGES;

/// A manifest's text, to find places in it.
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

    /// An error at the value with these keys, or at the nearest table around it.
    pub fn error(&self, keys: &[&str], message: impl Into<String>) -> Error {
        let at = self.find(keys).map(|offset| line_and_column(&self.text, offset));
        Error::Manifest {
            path: self.path.clone(),
            place: Place { at },
            message: message.into(),
            hint: None,
        }
    }

    /// An error about the name in a message such as ``unknown field `x`, expected one of `y`, `z` ``, at that name.
    #[must_use]
    pub fn unknown(&self, keys: &[&str], message: &str) -> Error {
        let quoted = quoted(message);
        let Some((&name, candidates)) = quoted.split_first().filter(|_| message.contains("unknown")) else {
            return self.error(keys, message);
        };
        let mut path = keys.to_vec();
        path.push(name);
        let error = self.error(&path, message);
        match did_you_mean(name, candidates.iter().copied()) {
            Some(meant) => error.with_hint(format!("did you mean `{meant}`?")),
            None => error,
        }
    }

    /// An error when there is no such stage.
    pub(crate) fn check_stage(&self, keys: &[&str], stage: &str) -> Result<()> {
        if STAGES.contains(&stage) {
            return Ok(());
        }
        let error = self.error(
            keys,
            format!("unknown stage `{stage}`, expected one of {}", STAGES.join(", ")),
        );
        Err(match did_you_mean(stage, STAGES) {
            Some(meant) => error.with_hint(format!("did you mean `{meant}`?")),
            None => error,
        })
    }

    /// Byte offset of the key path, as far as it leads.
    fn find(&self, keys: &[&str]) -> Option<usize> {
        let document = Document::parse(self.text.as_str()).ok()?;
        let mut item = document.as_item();
        let mut found = None;
        for key in keys {
            // In arrays of tables the first element that has the key is meant.
            let step =
                |item: &'_ Item| -> Option<usize> { Some(item.as_table_like()?.get_key_value(key)?.0.span()?.start) };
            let tables = item.as_array_of_tables();
            if let Some(tables) = tables {
                let table = tables.iter().find(|table| table.contains_key(key))?;
                found = table
                    .get_key_value(key)
                    .and_then(|(key, _)| key.span())
                    .map(|span| span.start)
                    .or(found);
                item = table.get(key)?;
                continue;
            }
            let Some(offset) = step(item) else { break };
            found = Some(offset);
            item = item.get(key)?;
        }
        found
    }
}

/// Words in backticks.
fn quoted(message: &str) -> Vec<&str> {
    message.split('`').skip(1).step_by(2).collect()
}

/// Turns an error of the TOML reader into one of ours.
pub(crate) fn from_toml_error(text: &Text, error: &toml::de::Error) -> Error {
    let message = error.message().trim().replace('\n', ", ");
    let at = error.span().map(|span| line_and_column(&text.text, span.start));
    let words = quoted(&message);
    let meant = words
        .split_first()
        .filter(|_| message.contains("unknown field") || message.contains("unknown variant"));
    let hint = meant.and_then(|(name, candidates)| did_you_mean(name, candidates.iter().copied()));
    let hint = hint.map(|meant| format!("did you mean `{meant}`?"));
    Error::Manifest {
        path: text.path.clone(),
        place: Place { at },
        message,
        hint,
    }
}

/// Line and column, from 1, of a byte offset.
fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let before = &text.as_bytes()[..offset.min(text.len())];
    let line = before.iter().filter(|&&byte| byte == b'\n').count() + 1;
    let start = before.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
    (line, String::from_utf8_lossy(&before[start..]).chars().count() + 1)
}
