//! What clips, cameras and outputs may be called across files and crates.

use std::borrow::Borrow;
use std::fmt;
use std::ops::Deref;
use std::path::Path;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Most bytes of a name.
const MAX_NAME: usize = 128;

/// A name that is not a file name everywhere.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("invalid name {name:?}: expected 1 to 128 letters, digits and `. _ + -`, not `.` or `..`")]
pub struct InvalidName {
    /// The name.
    pub name: String,
}

/// A name that is a file name everywhere: `[A-Za-z0-9._+-]{1,128}`, not `.` or `..`.
///
/// # Errors
/// When it is not.
pub fn check_name(name: &str) -> Result<(), InvalidName> {
    let fits = (1..=MAX_NAME).contains(&name.len()) && name.chars().all(is_safe) && name != "." && name != "..";
    if fits {
        Ok(())
    } else {
        Err(InvalidName { name: name.to_owned() })
    }
}

/// A name for [`check_name`] made of any text: at most 128 characters, others become `_`. It does not begin with `.` or
/// `-`, so that no listing hides it and no program takes it for an option.
#[must_use]
pub fn safe_name(text: &str) -> String {
    let safe = |c: char| if is_safe(c) { c } else { '_' };
    let mut name: String = text.chars().take(MAX_NAME).map(safe).collect();
    if name.is_empty() || name.starts_with(['.', '-']) {
        name.insert(0, '_');
        name.truncate(MAX_NAME);
    }
    name
}

/// True for names that [`safe_name`] leaves as they are: those of [`check_name`] that do not begin with `.` or `-`. What
/// people name in a manifest must be like this.
#[must_use]
pub fn is_safe_name(name: &str) -> bool {
    safe_name(name) == name
}

fn is_safe(c: char) -> bool {
    c.is_ascii_alphanumeric() || "._+-".contains(c)
}

/// The candidate that `word` was probably meant to be, unless two are as near; case does not count.
#[must_use]
pub fn did_you_mean<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let lowered = word.to_lowercase();
    let distance = |candidate: &str| strsim::damerau_levenshtein(&lowered, &candidate.to_lowercase());
    let mut scored: Vec<_> = (candidates.into_iter())
        .map(|candidate| (distance(candidate), candidate))
        .collect();
    scored.sort_by_key(|&(distance, _)| distance);
    let &(nearest, candidate) = scored.first()?;
    // The same name twice is one name.
    let mut others = scored.iter().filter(|(_, other)| *other != candidate);
    let alone = others.next().is_none_or(|&(second, _)| second > nearest);
    (alone && nearest <= 1 + word.chars().count() / 4).then_some(candidate)
}

/// `; did you mean ...?` with the name that was probably meant, or all names when there are few, or nothing.
#[must_use]
pub fn suggestion<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let known: Vec<&str> = known.into_iter().collect();
    match did_you_mean(word, known.iter().copied()) {
        Some(meant) => format!("; did you mean `{meant}`?"),
        None if (1..=16).contains(&known.len()) => format!("; it has {}", known.join(", ")),
        None => String::new(),
    }
}

/// The name that a message of a reader says is unknown, as in ``unknown field `x`, expected one of `y`, `z` ``, and the
/// other name in it that was probably meant.
#[must_use]
pub fn misspelt(message: &str) -> Option<(&str, Option<&str>)> {
    let words: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let (&name, candidates) = words.split_first().filter(|_| message.contains("unknown "))?;
    Some((name, did_you_mean(name, candidates.iter().copied())))
}

/// Several words that are not among the known names, each with the one that was probably meant: `` `a`, `lfet` (did you
/// mean `left`?) ``. Nothing when all are known.
#[must_use]
pub fn unknown<'a>(words: impl IntoIterator<Item = &'a str>, known: &[&str]) -> Option<String> {
    let words = words.into_iter().filter(|word| !known.contains(word));
    let told: Vec<String> = words
        .map(|word| match did_you_mean(word, known.iter().copied()) {
            Some(meant) => format!("`{word}` (did you mean `{meant}`?)"),
            None => format!("`{word}`"),
        })
        .collect();
    (!told.is_empty()).then(|| told.join(", "))
}

/// Name of a clip, unique in a run; also the name of its folder, so [`check_name`] holds for it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
pub struct ClipId(String);

impl ClipId {
    /// A clip of this name.
    ///
    /// # Errors
    /// When it cannot be the name of a folder.
    pub fn new(name: impl Into<String>) -> Result<Self, InvalidName> {
        let name = name.into();
        check_name(&name).map(|()| Self(name))
    }

    /// A name made of any text, as [`safe_name`].
    #[must_use]
    pub fn made_of(text: &str) -> Self {
        Self(safe_name(text))
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for ClipId {
    type Error = InvalidName;

    fn try_from(name: String) -> Result<Self, InvalidName> {
        Self::new(name)
    }
}

impl FromStr for ClipId {
    type Err = InvalidName;

    fn from_str(name: &str) -> Result<Self, InvalidName> {
        Self::new(name)
    }
}

impl From<ClipId> for String {
    fn from(id: ClipId) -> Self {
        id.0
    }
}

impl Deref for ClipId {
    type Target = str;

    fn deref(&self) -> &str {
        &self.0
    }
}

impl Borrow<str> for ClipId {
    fn borrow(&self) -> &str {
        &self.0
    }
}

impl AsRef<Path> for ClipId {
    fn as_ref(&self) -> &Path {
        self.0.as_ref()
    }
}

impl fmt::Display for ClipId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl PartialEq<str> for ClipId {
    fn eq(&self, other: &str) -> bool {
        self.0 == other
    }
}

impl PartialEq<&str> for ClipId {
    fn eq(&self, other: &&str) -> bool {
        self.0 == *other
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked() {
        let long = "a".repeat(MAX_NAME);
        for good in ["a", "LAB+a1+2026-01-31-12h-00m", "...", "-rf", ".hidden", &long] {
            assert_eq!(ClipId::new(good).unwrap(), good);
        }
        for bad in ["", ".", "..", "a/b", "a b", "ä", "a\n", &format!("{long}a")] {
            let error = ClipId::new(bad).unwrap_err().to_string();
            assert!(error.contains("1 to 128 letters"), "{error}");
        }
    }

    #[test]
    fn names_become_safe() {
        assert_eq!(safe_name("LAB+a1+2026-01-31-12h:00m"), "LAB+a1+2026-01-31-12h_00m");
        assert_eq!(safe_name("../x"), "_.._x");
        assert_eq!(safe_name(".."), "_..");
        assert_eq!(safe_name("-rf"), "_-rf");
        assert_eq!(safe_name(""), "_");
        assert_eq!(safe_name(&"ä".repeat(300)).len(), MAX_NAME);
        assert_eq!(safe_name(&"-".repeat(MAX_NAME)).len(), MAX_NAME);
        assert!(is_safe_name("movies+4dgt") && !is_safe_name("-rf") && !is_safe_name(".x") && !is_safe_name("a/b"));
    }

    #[test]
    fn json_shows_plain_values() {
        let id = ClipId::new("kitchen-0").unwrap();
        assert_eq!(serde_json::to_string(&id).unwrap(), "\"kitchen-0\"");
        assert_eq!(serde_json::from_str::<ClipId>("\"kitchen-0\"").unwrap(), id);
        assert!(serde_json::from_str::<ClipId>("\"..\"").is_err());
    }

    #[test]
    fn near_words_are_suggested_and_far_ones_are_not() {
        assert_eq!(did_you_mean("calibraton", ["root", "calibration"]), Some("calibration"));
        assert_eq!(did_you_mean("ROOT", ["root", "calibration"]), Some("root"));
        assert_eq!(did_you_mean("zebra", ["root", "calibration"]), None);
        assert_eq!(did_you_mean("a", ["b", "c"]), None, "either");
        assert_eq!(did_you_mean("rot", ["root", "root"]), Some("root"), "one name");
        assert_eq!(
            suggestion("left_fingr", ["left_finger", "waist"]),
            "; did you mean `left_finger`?"
        );
        assert_eq!(
            suggestion("zebra", ["left_finger", "waist"]),
            "; it has left_finger, waist"
        );
        assert_eq!(suggestion("zebra", ["a"; 17]), "");
        let known = ["wrist", "ext1", "side"];
        assert_eq!(
            unknown(["wrist", "sdie", "zebra"], &known).unwrap(),
            "`sdie` (did you mean `side`?), `zebra`"
        );
        assert_eq!(unknown(["wrist", "side"], &known), None);
    }
}
