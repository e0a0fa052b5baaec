//! The chunk container (`.r4c`).

use std::path::Path;

use crate::error::Result;
use crate::key::{ContentHash, Provenance};
use crate::record::SchemaId;

/// Collects streams and commits them as one file.
pub struct Writer {}

impl Writer {
    /// An empty container of a schema.
    #[must_use]
    pub fn new(_schema: SchemaId, _provenance: &Provenance) -> Self {
        Self {}
    }

    /// Writes the file atomically.
    pub fn commit(self, _path: &Path) -> Result<ContentHash> {
        unimplemented!()
    }
}

/// An open, checked container.
pub struct Reader {}

impl Reader {
    /// Opens and checks a file.
    pub fn open(_path: &Path) -> Result<Self> {
        unimplemented!()
    }

    /// Refuses other schemas and newer versions.
    pub fn expect_schema(&self, _schema: SchemaId) -> Result<()> {
        unimplemented!()
    }

    /// How it was made.
    #[must_use]
    pub fn provenance(&self) -> &Provenance {
        unimplemented!()
    }

    /// Hash of the decoded content.
    #[must_use]
    pub fn content_hash(&self) -> ContentHash {
        unimplemented!()
    }
}
