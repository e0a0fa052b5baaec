//! What a container file says of itself: its schema, how it was made, what it holds.

use crate::key::{ContentHash, Provenance};

/// Name and version of a record schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SchemaId {
    /// Name, for example `rogs.clip`.
    pub name: &'static str,
    /// Breaking version.
    pub major: u16,
    /// Additive version.
    pub minor: u16,
}

impl std::fmt::Display for SchemaId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}.{}", self.name, self.major, self.minor)
    }
}

/// What a file says besides its record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileInfo {
    /// How it was made.
    pub provenance: Provenance,
    /// Hash of its decoded content.
    pub content: ContentHash,
}
