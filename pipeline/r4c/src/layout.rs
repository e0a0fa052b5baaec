//! The fixed blocks: prologue, index entry, footer, and their limits (`docs/spec/r4c.md` section 3).

use rogs_schemas::key::CacheKey;
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_64;

/// Length of prologue and of footer.
pub(crate) const EDGE: u64 = 64;
/// Smallest possible file: prologue and footer.
pub const MIN_FILE: u64 = 2 * EDGE;
/// Largest file that is opened by default.
pub const MAX_FILE: u64 = 64 << 30;
/// Largest schema or index block, stored and decoded.
pub const MAX_BLOCK: u64 = 16 << 20;
/// Largest decoded chunk.
pub const MAX_CHUNK: u64 = 256 << 20;
/// Most chunks of a file.
pub const MAX_CHUNKS: u64 = 1 << 18;

const MAGIC: [u8; 8] = *b"\x89R4C\r\n\x1a\n";
const END_MAGIC: [u8; 4] = *b"C4R.";

/// The next multiple of 8; `None` on overflow.
pub(crate) fn align8(offset: u64) -> Option<u64> {
    offset.checked_next_multiple_of(8)
}

/// First bytes of the BLAKE3 of a schema's name.
pub(crate) fn schema_id(name: &str) -> [u8; 16] {
    let mut id = [0; 16];
    id.copy_from_slice(&blake3::hash(name.as_bytes()).as_bytes()[..16]);
    id
}

/// First 64 bytes of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Prologue {
    pub(crate) container: (u16, u16),
    pub(crate) required_features: u32,
    pub(crate) schema_id: [u8; 16],
    pub(crate) schema_version: (u16, u16),
    pub(crate) key: CacheKey,
}

impl Prologue {
    pub(crate) fn to_bytes(self) -> [u8; 64] {
        let mut bytes = [0; 64];
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..10].copy_from_slice(&self.container.0.to_le_bytes());
        bytes[10..12].copy_from_slice(&self.container.1.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.required_features.to_le_bytes());
        bytes[16..32].copy_from_slice(&self.schema_id);
        bytes[32..34].copy_from_slice(&self.schema_version.0.to_le_bytes());
        bytes[34..36].copy_from_slice(&self.schema_version.1.to_le_bytes());
        bytes[40..56].copy_from_slice(&self.key.0);
        let hash = xxh3_64(&bytes[..56]);
        bytes[56..].copy_from_slice(&hash.to_le_bytes());
        bytes
    }

    /// The prologue, or the offset and name of the check that failed.
    pub(crate) fn from_bytes(bytes: &[u8; 64]) -> Result<Self, (u64, String)> {
        if bytes[..8] != MAGIC {
            return Err((0, "it does not begin with the magic of a container".into()));
        }
        if u64_at(bytes, 56) != xxh3_64(&bytes[..56]) {
            return Err((56, "the checksum of the prologue does not match".into()));
        }
        if u32_at(bytes, 36) != 0 {
            return Err((36, "reserved bytes are not zero".into()));
        }
        let mut prologue = Self {
            container: (u16_at(bytes, 8), u16_at(bytes, 10)),
            required_features: u32_at(bytes, 12),
            schema_id: [0; 16],
            schema_version: (u16_at(bytes, 32), u16_at(bytes, 34)),
            key: CacheKey([0; 16]),
        };
        prologue.schema_id.copy_from_slice(&bytes[16..32]);
        prologue.key.0.copy_from_slice(&bytes[40..56]);
        Ok(prologue)
    }
}

/// Last 64 bytes of a file: the commit record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Footer {
    pub(crate) schema_offset: u64,
    pub(crate) schema_stored: u64,
    pub(crate) index_offset: u64,
    pub(crate) index_stored: u64,
    pub(crate) schema_decoded: u32,
    pub(crate) index_decoded: u32,
    pub(crate) blocks_hash: u64,
    pub(crate) file_length: u64,
}

impl Footer {
    pub(crate) fn to_bytes(self) -> [u8; 64] {
        let mut bytes = [0; 64];
        bytes[..8].copy_from_slice(&self.schema_offset.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.schema_stored.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.index_offset.to_le_bytes());
        bytes[24..32].copy_from_slice(&self.index_stored.to_le_bytes());
        bytes[32..36].copy_from_slice(&self.schema_decoded.to_le_bytes());
        bytes[36..40].copy_from_slice(&self.index_decoded.to_le_bytes());
        bytes[40..48].copy_from_slice(&self.blocks_hash.to_le_bytes());
        bytes[48..56].copy_from_slice(&self.file_length.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[..56]);
        bytes[56..60].copy_from_slice(&crc.to_le_bytes());
        bytes[60..].copy_from_slice(&END_MAGIC);
        bytes
    }

    /// The footer, or the offset inside it and name of the check that failed.
    pub(crate) fn from_bytes(bytes: &[u8; 64]) -> Result<Self, (u64, String)> {
        if bytes[60..] != END_MAGIC {
            return Err((
                60,
                "it does not end as a container does: it is cut off or was never finished".into(),
            ));
        }
        if u32_at(bytes, 56) != crc32c::crc32c(&bytes[..56]) {
            return Err((56, "the checksum of the footer does not match".into()));
        }
        Ok(Self {
            schema_offset: u64_at(bytes, 0),
            schema_stored: u64_at(bytes, 8),
            index_offset: u64_at(bytes, 16),
            index_stored: u64_at(bytes, 24),
            schema_decoded: u32_at(bytes, 32),
            index_decoded: u32_at(bytes, 36),
            blocks_hash: u64_at(bytes, 40),
            file_length: u64_at(bytes, 48),
        })
    }
}

/// XXH3-64 of the stored schema block followed by the stored index block.
pub(crate) fn blocks_hash(schema: &[u8], index: &[u8]) -> u64 {
    let mut hasher = xxhash_rust::xxh3::Xxh3::new();
    hasher.update(schema);
    hasher.update(index);
    hasher.digest()
}

/// Flag of an entry: all scalars are equal and the payload is one scalar, stored raw.
pub(crate) const FLAG_CONSTANT: u16 = 1;

/// Bytes of an encoded entry.
pub(crate) const ENTRY_BYTES: u64 = 64;

/// One chunk in the index; 64 bytes when encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct IndexEntry {
    pub(crate) stream: u32,
    pub(crate) ordinal: u32,
    pub(crate) coordinates: [u32; 4],
    pub(crate) offset: u64,
    pub(crate) stored: u32,
    pub(crate) decoded: u32,
    pub(crate) elements: u32,
    pub(crate) codec: u16,
    pub(crate) flags: u16,
    pub(crate) stored_hash: u64,
    pub(crate) decoded_crc: u32,
    pub(crate) reserved: u32,
}

fn u16_at(bytes: &[u8; 64], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8; 64], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn u64_at(bytes: &[u8; 64], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | (u64::from(u32_at(bytes, at + 4)) << 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_takes_64_bytes() {
        let entry = IndexEntry {
            stream: 1,
            ordinal: 2,
            coordinates: [3, 4, 5, 6],
            offset: 7,
            stored: 8,
            decoded: 9,
            elements: 10,
            codec: 11,
            flags: 12,
            stored_hash: 13,
            decoded_crc: 14,
            reserved: 0,
        };
        let bytes = crate::codec::encode(&vec![entry]).unwrap();
        assert_eq!(bytes.len() as u64, 8 + ENTRY_BYTES);
        assert_eq!(bytes[8 + 24], 7, "the offset is at byte 24 of an entry");
        assert_eq!(bytes[8 + 48], 13, "the hash is at byte 48 of an entry");
    }

    #[test]
    fn edges_survive_their_bytes() {
        let prologue = Prologue {
            container: (1, 0),
            required_features: 0,
            schema_id: schema_id("rogs.clip"),
            schema_version: (1, 2),
            key: CacheKey([7; 16]),
        };
        assert_eq!(Prologue::from_bytes(&prologue.to_bytes()), Ok(prologue));
        let footer = Footer {
            schema_offset: 64,
            schema_stored: 5,
            index_offset: 72,
            index_stored: 6,
            schema_decoded: 7,
            index_decoded: 8,
            blocks_hash: 9,
            file_length: 144,
        };
        assert_eq!(Footer::from_bytes(&footer.to_bytes()), Ok(footer));
    }
}
