//! Writing and reading records: the only way data gets into and out of a container file.

use std::path::Path;

use rogs_schemas::key::Provenance;
use rogs_schemas::{FileInfo, SchemaId};

use crate::error::Result;
use crate::{Reader, Writer};

/// A type that lies on disk as one container file.
pub trait Record: Sized {
    /// Its schema.
    const SCHEMA: SchemaId;

    /// Adds the record's streams to the writer.
    ///
    /// # Errors
    /// When arrays do not have the sizes that the record's own counts say.
    fn encode(&self, writer: &mut Writer) -> Result<()>;

    /// Rebuilds the record from the streams.
    ///
    /// # Errors
    /// When a stream is missing, damaged, or contradicts the others.
    fn decode(reader: &Reader) -> Result<Self>;
}

/// Writes a record beside its place, flushes it to disk and renames it, so that no reader meets half a file.
///
/// # Errors
/// On I/O errors and on records whose arrays contradict each other; nothing is left at `path` then.
pub fn write_record<T: Record>(path: &Path, record: &T, provenance: &Provenance) -> Result<FileInfo> {
    let mut writer = Writer::new(T::SCHEMA, provenance);
    record.encode(&mut writer)?;
    let content = writer.commit(path)?;
    Ok(FileInfo {
        provenance: provenance.clone(),
        content,
    })
}

/// Reads and checks a record.
///
/// # Errors
/// When the file is missing, damaged, of another schema, or of a newer version.
pub fn read_record<T: Record>(path: &Path) -> Result<(T, FileInfo)> {
    let reader = Reader::open(path)?;
    reader.expect_schema(T::SCHEMA)?;
    let record = T::decode(&reader)?;
    Ok((
        record,
        FileInfo {
            provenance: reader.provenance().clone(),
            content: reader.content_hash(),
        },
    ))
}
