//! Cache keys, content hashes and provenance: what makes an output up to date.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Key of one unit output: a 128-bit truncated BLAKE3 over everything that determines its bytes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct CacheKey(pub [u8; 16]);

/// BLAKE3 (256 bit) of decoded content: the identity of data, independent of compression.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct ContentHash(pub [u8; 32]);

macro_rules! hex_newtype {
    ($name:ident, $bytes:expr) => {
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!(stringify!($name), "({})"), self)
            }
        }

        impl FromStr for $name {
            type Err = String;

            fn from_str(text: &str) -> Result<Self, String> {
                let wrong = || format!("expected {} hexadecimal digits: `{text}`", 2 * $bytes);
                if text.len() != 2 * $bytes || !text.is_ascii() {
                    return Err(wrong());
                }
                let mut bytes = [0; $bytes];
                for (index, byte) in bytes.iter_mut().enumerate() {
                    *byte = u8::from_str_radix(&text[2 * index..2 * index + 2], 16).map_err(|_| wrong())?;
                }
                Ok(Self(bytes))
            }
        }

        impl Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl JsonSchema for $name {
            fn schema_name() -> Cow<'static, str> {
                stringify!($name).into()
            }

            fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
                schemars::json_schema!({ "type": "string", "pattern": format!("^[0-9a-f]{{{}}}$", 2 * $bytes) })
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                String::deserialize(deserializer)?
                    .parse()
                    .map_err(serde::de::Error::custom)
            }
        }
    };
}

hex_newtype!(CacheKey, 16);
hex_newtype!(ContentHash, 32);

/// What determines a stage's output for one clip. Its canonical JSON is hashed into the [`CacheKey`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct KeyMaterial {
    /// Stage name, `lift`.
    pub stage: String,
    /// Version of the stage's behaviour; raised by hand whenever its bytes change.
    pub stage_version: u32,
    /// Schema name and versions of the output, `rogs.field 1.0`.
    pub schema: String,
    /// Canonical JSON of the stage's parameters, defaults filled in.
    pub params: String,
    /// Per input role: the key of an upstream output, or the content hash of a source (episode, robot, weights).
    pub inputs: BTreeMap<String, String>,
}

impl KeyMaterial {
    /// The cache key of this material.
    #[must_use]
    pub fn key(&self) -> CacheKey {
        let mut hasher = blake3::Hasher::new();
        // Every part is length-prefixed, so that no two different materials hash the same bytes.
        let mut part = |text: &str| {
            hasher.update(&(text.len() as u64).to_le_bytes());
            hasher.update(text.as_bytes());
        };
        part("rogs-key-1");
        part(&self.stage);
        part(&self.stage_version.to_string());
        part(&self.schema);
        part(&self.params);
        for (role, id) in &self.inputs {
            part(role);
            part(id);
        }
        let mut key = [0; 16];
        key.copy_from_slice(&hasher.finalize().as_bytes()[..16]);
        CacheKey(key)
    }
}

/// What a file says about its own making. Stored in the container's metadata.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Provenance {
    /// What the key was made of.
    pub material: KeyMaterial,
    /// Content hash of each input file as it was read, by role.
    pub input_content: BTreeMap<String, ContentHash>,
}

impl Provenance {
    /// The cache key of the file.
    #[must_use]
    pub fn key(&self) -> CacheKey {
        self.material.key()
    }
}
