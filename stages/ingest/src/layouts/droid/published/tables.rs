//! A folder of tables by episode or serial: JSON files, some of them large, of which one entry at a time is kept.

use std::fmt;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use rogs_worker::{StageError, StageResult};
use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, Visitor};
use serde_json::Value;

use crate::fault::{io_error, wrong};

/// The folder.
#[derive(Debug)]
pub(super) struct Tables {
    folder: PathBuf,
}

impl Tables {
    pub(super) fn of(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
        }
    }

    /// A file of the folder, whether it is there or not.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Names of the files in it.
    pub(super) fn names(&self) -> StageResult<Vec<String>> {
        let entries = rogs_files::entries(&self.folder).map_err(|error| io_error(&self.folder, &error))?;
        let mut names: Vec<String> = entries
            .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
            .collect();
        names.sort();
        Ok(names)
    }

    /// The first entry of a file that is wanted; nothing else of it is kept.
    pub(super) fn find(&self, name: &str, wanted: Wanted<'_>) -> StageResult<Option<(String, Value)>> {
        let path = self.path(name);
        let file = match rogs_files::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(io_error(&path, &error)),
        };
        let mut json = serde_json::Deserializer::from_reader(BufReader::with_capacity(1 << 16, file));
        let found = wanted.deserialize(&mut json);
        found.map_err(|error| wrong(&path, format!("not a table by episode: {error}")))
    }

    /// What is wrong with one of the files.
    pub(super) fn wrong(&self, name: &str, what: String) -> StageError {
        wrong(&self.path(name), what)
    }
}

/// The numbers of a list; `None` for anything else.
pub(super) fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(Value::as_f64).collect()
}

/// Which entry of a table is wanted.
pub(super) enum Wanted<'a> {
    Key(&'a str),
    Named(&'a dyn Fn(&str) -> bool),
    Fits(&'a dyn Fn(&Value) -> bool),
}

impl<'de> DeserializeSeed<'de> for Wanted<'_> {
    type Value = Option<(String, Value)>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Wanted<'_> {
    type Value = Option<(String, Value)>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("an object by episode or serial")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut found = None;
        while let Some(key) = map.next_key::<String>()? {
            match self {
                Self::Key(wanted) if found.is_none() && key == wanted => found = Some((key, map.next_value()?)),
                Self::Named(fits) if found.is_none() && fits(&key) => found = Some((key, map.next_value()?)),
                Self::Fits(fits) if found.is_none() => {
                    let value = map.next_value()?;
                    found = fits(&value).then_some((key, value));
                }
                _ => {
                    let _: IgnoredAny = map.next_value()?;
                }
            }
        }
        Ok(found)
    }
}
