//! The content hash: BLAKE3 over the decoded streams, whatever the compression.

use rogs_schemas::key::ContentHash;

use crate::stream::StreamInfo;

/// What enters the hash of one chunk.
pub(crate) struct ChunkContent {
    pub(crate) stream: u32,
    pub(crate) coordinates: [u32; 4],
    pub(crate) elements: u32,
    pub(crate) hash: [u8; 32],
}

/// The hash of a container: schema name and version, each stream's name, dtype, shape, unit and frame, and each chunk's
/// coordinates, element count and BLAKE3 of its decoded bytes, in order.
pub(crate) fn content_hash(
    schema: &str,
    version: (u16, u16),
    streams: &[StreamInfo],
    chunks: impl Iterator<Item = ChunkContent>,
) -> ContentHash {
    let mut hasher = blake3::Hasher::new();
    let mut text = |bytes: &[u8]| {
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    text(b"rogs-content-1");
    text(schema.as_bytes());
    text(&version.0.to_le_bytes());
    text(&version.1.to_le_bytes());
    for stream in streams {
        text(stream.name.as_bytes());
        text(&[
            stream.dtype as u8,
            stream.unit as u8,
            stream.frame as u8,
            stream.shape.len() as u8,
        ]);
        for dim in &stream.shape {
            text(&dim.to_le_bytes());
        }
    }
    for chunk in chunks {
        hasher.update(&chunk.stream.to_le_bytes());
        for coordinate in chunk.coordinates {
            hasher.update(&coordinate.to_le_bytes());
        }
        hasher.update(&chunk.elements.to_le_bytes());
        hasher.update(&chunk.hash);
    }
    ContentHash(*hasher.finalize().as_bytes())
}
