//! A container taken apart: prologue, then schema and index as they are before compression, then chunks.

use xxhash_rust::xxh3::xxh3_64;

pub struct Parts {
    pub prologue: [u8; 64],
    pub schema: Vec<u8>,
    pub index: Vec<u8>,
    pub chunks: Vec<u8>,
}

impl Parts {
    /// Prologue, lengths of schema and index (u16 each), schema, index, chunks.
    pub fn from_input(bytes: &[u8]) -> Option<Self> {
        let (prologue, rest) = bytes.split_first_chunk::<64>()?;
        let (schema, rest) = rest.split_first_chunk::<2>()?;
        let (index, rest) = rest.split_first_chunk::<2>()?;
        let (schema, rest) = rest.split_at_checked(u16::from_le_bytes(*schema).into())?;
        let (index, chunks) = rest.split_at_checked(u16::from_le_bytes(*index).into())?;
        Some(Self {
            prologue: *prologue,
            schema: schema.to_vec(),
            index: index.to_vec(),
            chunks: chunks.to_vec(),
        })
    }

    /// The file, with the checksums of prologue, blocks, footer and stored chunks right.
    pub fn file(&self) -> Vec<u8> {
        let mut file = self.prologue.to_vec();
        let hash = xxh3_64(&file[..56]);
        file[56..].copy_from_slice(&hash.to_le_bytes());
        file.extend(&self.chunks);
        let mut index = self.index.clone();
        if let Some((_, entries)) = index.split_at_mut_checked(8) {
            for entry in entries.as_chunks_mut::<64>().0 {
                let at = u64::from_le_bytes([24, 25, 26, 27, 28, 29, 30, 31].map(|byte| entry[byte])) as usize;
                let stored = u32::from_le_bytes([32, 33, 34, 35].map(|byte| entry[byte])) as usize;
                if let Some(bytes) = at.checked_add(stored).and_then(|end| file.get(at..end)) {
                    entry[48..56].copy_from_slice(&xxh3_64(bytes).to_le_bytes());
                }
            }
        }
        let blocks = [&self.schema, &index].map(|block| zstd::bulk::compress(block, 1).unwrap_or_default());
        let mut footer = Vec::new();
        for block in &blocks {
            file.resize(file.len().next_multiple_of(8), 0);
            footer.extend((file.len() as u64).to_le_bytes());
            footer.extend((block.len() as u64).to_le_bytes());
            file.extend(block);
        }
        file.resize(file.len().next_multiple_of(8), 0);
        footer.extend((self.schema.len() as u32).to_le_bytes());
        footer.extend((index.len() as u32).to_le_bytes());
        footer.extend(xxh3_64(&blocks.concat()).to_le_bytes());
        footer.extend((file.len() as u64 + 64).to_le_bytes());
        let crc = crc32c::crc32c(&footer);
        footer.extend(crc.to_le_bytes());
        footer.extend(b"C4R.");
        file.extend(footer);
        file
    }
}
