//! Weights that ship inside the program, and what a run without a weights file takes.

use std::borrow::Cow;
use std::fmt;
use std::sync::OnceLock;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A weights file inside the program.
#[derive(Debug)]
pub struct Bundled {
    /// Name of the file.
    pub name: &'static str,
    /// Its bytes: a safetensors file.
    pub bytes: &'static [u8],
    hash: OnceLock<String>,
}

impl Bundled {
    /// A weights file of this name.
    #[must_use]
    pub const fn new(name: &'static str, bytes: &'static [u8]) -> Self {
        Self {
            name,
            bytes,
            hash: OnceLock::new(),
        }
    }

    /// BLAKE3 of the bytes, in hex: that of the same file on disk.
    pub fn hash(&self) -> &str {
        self.hash.get_or_init(|| blake3::hash(self.bytes).to_hex().to_string())
    }
}

/// The network of a stage to which no weights file is given: `[weights] lift` and `refine` of a manifest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Unfiled {
    /// What is inside the program, by the hash of its file or files: outputs of others are not taken for its own.
    Builtin(String),
    /// Random values from the stage's seed; they predict nothing.
    Seeded,
}

/// How [`Unfiled::Builtin`] is written.
pub const BUILTIN: &str = "builtin";
/// How [`Unfiled::Seeded`] is written.
pub const SEEDED: &str = "seeded";

impl Unfiled {
    /// Reads a parameter: `builtin`, `builtin HASH`, `seeded` or null.
    ///
    /// # Errors
    /// For another word, and for another hash than that of what is inside this program.
    pub fn read<'de, D: Deserializer<'de>>(deserializer: D, hash: &str) -> Result<Option<Self>, D::Error> {
        let Some(text) = Option::<Cow<'de, str>>::deserialize(deserializer)? else {
            return Ok(None);
        };
        match text.split_once(' ').unwrap_or((&text, hash)) {
            (SEEDED, _) if text == SEEDED => Ok(Some(Self::Seeded)),
            (BUILTIN, own) if own == hash => Ok(Some(Self::Builtin(own.to_owned()))),
            (BUILTIN, other) => Err(serde::de::Error::custom(format!(
                "these are the built-in weights of another version of rogs ({other}); this one has {hash}"
            ))),
            _ => Err(serde::de::Error::custom(format!(
                "unknown weights `{text}`, expected `{BUILTIN}` or `{SEEDED}`"
            ))),
        }
    }
}

impl fmt::Display for Unfiled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Builtin(hash) => write!(f, "{BUILTIN} {hash}"),
            Self::Seeded => f.write_str(SEEDED),
        }
    }
}

impl Serialize for Unfiled {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl JsonSchema for Unfiled {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Unfiled".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "string", "pattern": "^(builtin( [0-9a-f]{64})?|seeded)$" })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    static ONE: Bundled = Bundled::new("one", b"1");

    fn read(value: &Value) -> Result<Option<Unfiled>, String> {
        Unfiled::read(value, ONE.hash()).map_err(|error| error.to_string())
    }

    #[test]
    fn what_is_inside_the_program_is_known_by_its_hash() {
        let own = Unfiled::Builtin(ONE.hash().to_owned());
        assert_eq!(read(&json!("builtin")), Ok(Some(own.clone())));
        assert_eq!(read(&serde_json::to_value(&own).unwrap()), Ok(Some(own)));
        assert_eq!(read(&json!("seeded")), Ok(Some(Unfiled::Seeded)));
        assert_eq!(read(&Value::Null), Ok(None));
        let other = read(&json!("builtin 00ff")).unwrap_err();
        assert!(other.contains("another version of rogs (00ff)"), "{other}");
        for wrong in ["seeded 00ff", "", "built-in"] {
            let error = read(&json!(wrong)).unwrap_err();
            assert!(error.contains("expected `builtin` or `seeded`"), "{wrong}: {error}");
        }
    }
}
