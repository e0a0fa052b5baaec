//! The chunk container (`.r4c`): one file holds one unit's output as named streams cut into chunks.
//!
//! ```text
//! prologue   64 bytes    magic, versions, schema id, content key, XXH3
//! chunks                 payloads, back to back, each at a multiple of 8, padding zero
//! schema     zstd        streams (dtype, shape, unit, frame, codec) and metadata
//! index      zstd        u64 count, then 64 bytes a chunk
//! footer     64 bytes    where schema and index are, checksums, file length: the commit record
//! ```
//!
//! All integers are little endian. Checksums: XXH3-64 of what is stored, CRC-32C of what it decodes to. The identity of
//! a file's data is the [`ContentHash`](rogs_schemas::ContentHash) of its decoded streams, which does not depend on zstd.
//! A file without a whole footer counts as absent. Nothing here is appended to or changed in place.
//!
//! Writing and reading through [`Record`] is all a stage needs; [`Reader::read_chunk`] fetches one chunk
//! by touching only its bytes, and [`inspect`] describes any file.

#[cfg(target_endian = "big")]
compile_error!("the container is read and written in place on little-endian machines only");

pub mod codec;
mod compress;
mod content;
mod error;
mod inspect;
mod layout;
pub mod ledger;
mod memory;
mod reader;
mod record;
mod records;
pub mod source;
mod stream;
mod transpose;
mod writer;

pub use error::{Error, Result};
pub use inspect::{ChunkTotals, InspectReport, StreamReport, inspect};
pub use layout::{MAX_BLOCK, MAX_CHUNK, MAX_CHUNKS, MAX_FILE, MIN_FILE};
pub use reader::{FileHeader, Limits, Reader, read_header, read_key, verify};
pub use record::{Record, read_record, write_record};
pub use records::{FieldFile, read_refinement_of};
pub use stream::{Codec, Dtype, Element, Frame, StreamInfo, StreamSpec, Unit};
pub use writer::{Chunk, Writer};

/// Container version this code writes, and the largest major version it reads.
pub const CONTAINER_VERSION: (u16, u16) = (1, 0);

/// Required-feature bit: some stream has [`Codec::PlanesZstd`].
pub const FEATURE_PLANES: u32 = 1;

/// Metadata key of the provenance (canonical JSON).
pub(crate) const META_PROVENANCE: &str = "provenance";
/// Metadata key of the content hash (hex).
pub(crate) const META_CONTENT: &str = "content";
