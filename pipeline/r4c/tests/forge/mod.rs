//! Taking a container apart and putting it together again with right checksums, so that only one thing is wrong.

use xxhash_rust::xxh3::xxh3_64;

/// The parts of a container.
#[derive(Clone)]
pub(crate) struct Parts {
    pub(crate) prologue: [u8; 64],
    /// All chunks with their padding.
    pub(crate) chunks: Vec<u8>,
    /// Schema block, decoded.
    pub(crate) schema: Vec<u8>,
    /// Index block, decoded: count, then 64 bytes an entry.
    pub(crate) index: Vec<u8>,
}

/// Offsets inside an index entry.
pub(crate) const COORDINATES: usize = 8;
pub(crate) const OFFSET: usize = 24;
pub(crate) const STORED: usize = 32;
pub(crate) const DECODED: usize = 36;
pub(crate) const ELEMENTS: usize = 40;
pub(crate) const CODEC: usize = 44;
pub(crate) const FLAGS: usize = 46;
pub(crate) const HASH: usize = 48;
pub(crate) const RESERVED: usize = 60;

fn word(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

impl Parts {
    pub(crate) fn of(file: &[u8]) -> Self {
        let footer = &file[file.len() - 64..];
        let block = |at: usize, stored: usize, decoded: usize| {
            let (at, stored) = (word(footer, at) as usize, word(footer, stored) as usize);
            let decoded = u32::from_le_bytes(footer[decoded..decoded + 4].try_into().unwrap()) as usize;
            zstd::bulk::decompress(&file[at..at + stored], decoded).unwrap()
        };
        Self {
            prologue: file[..64].try_into().unwrap(),
            chunks: file[64..word(footer, 0) as usize].to_vec(),
            schema: block(0, 8, 32),
            index: block(16, 24, 36),
        }
    }

    /// The file, with every checksum right.
    pub(crate) fn file(&self) -> Vec<u8> {
        self.file_with(|index| zstd::bulk::compress(index, 3).unwrap(), self.index.len() as u32)
    }

    /// The file with an index block made by `compress` that announces `decoded` bytes.
    pub(crate) fn file_with(&self, compress: impl Fn(&[u8]) -> Vec<u8>, decoded: u32) -> Vec<u8> {
        let schema = zstd::bulk::compress(&self.schema, 3).unwrap();
        let index = compress(&self.index);
        let mut file = self.prologue.to_vec();
        let prologue_hash = xxh3_64(&file[..56]);
        file[56..].copy_from_slice(&prologue_hash.to_le_bytes());
        file.extend(&self.chunks);
        let schema_at = file.len() as u64;
        file.extend(&schema);
        file.resize(file.len().next_multiple_of(8), 0);
        let index_at = file.len() as u64;
        file.extend(&index);
        file.resize(file.len().next_multiple_of(8), 0);
        let mut hashed = schema.clone();
        hashed.extend(&index);
        let mut footer = Vec::new();
        for value in [schema_at, schema.len() as u64, index_at, index.len() as u64] {
            footer.extend(value.to_le_bytes());
        }
        footer.extend((self.schema.len() as u32).to_le_bytes());
        footer.extend(decoded.to_le_bytes());
        footer.extend(xxh3_64(&hashed).to_le_bytes());
        footer.extend((file.len() as u64 + 64).to_le_bytes());
        footer.extend(crc32c::crc32c(&footer).to_le_bytes());
        footer.extend(b"C4R.");
        file.extend(footer);
        file
    }

    /// One index entry.
    pub(crate) fn entry(&mut self, number: usize) -> &mut [u8] {
        &mut self.index[8 + 64 * number..][..64]
    }

    pub(crate) fn entries(&self) -> usize {
        word(&self.index, 0) as usize
    }
}

/// Overwrites bytes of an entry.
pub(crate) fn set(entry: &mut [u8], at: usize, bytes: &[u8]) {
    entry[at..at + bytes.len()].copy_from_slice(bytes);
}
