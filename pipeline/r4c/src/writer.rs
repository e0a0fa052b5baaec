//! Writing a container: streams are compressed as they are added, the file is written at the end in one go.

use std::io::Write as _;
use std::path::Path;

use rayon::prelude::*;
use rogs_schemas::SchemaId;
use rogs_schemas::json::canonical_json;
use rogs_schemas::key::{CacheKey, ContentHash, Provenance};
use serde::Serialize;
use xxhash_rust::xxh3::xxh3_64;

use crate::compress;
use crate::content::{ChunkContent, content_hash};
use crate::error::{Error, Result};
use crate::layout::{
    EDGE, FLAG_CONSTANT, Footer, IndexEntry, MAX_BLOCK, MAX_CHUNK, MAX_CHUNKS, Prologue, align8, blocks_hash, schema_id,
};
use crate::stream::{Codec, Dtype, Element, Frame, StreamInfo, StreamSpec, Unit};
use crate::{CONTAINER_VERSION, FEATURE_PLANES, META_CONTENT, META_PROVENANCE, codec};

/// The schema block.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, serde::Deserialize)]
pub(crate) struct Schema {
    pub(crate) name: String,
    pub(crate) streams: Vec<StreamInfo>,
    /// Sorted by key.
    pub(crate) metadata: Vec<(String, String)>,
}

/// One chunk to add: its coordinates (for example view, time) and its elements.
pub type Chunk<'a, T> = ([u32; 4], &'a [T]);

/// Collects streams and commits them as one file.
pub struct Writer {
    schema: SchemaId,
    key: CacheKey,
    provenance: String,
    streams: Vec<StreamInfo>,
    chunks: Vec<Stored>,
}

struct Stored {
    entry: IndexEntry,
    content: [u8; 32],
    bytes: Vec<u8>,
}

/// The stream of a structured value: bytes of [`codec`].
pub(crate) fn value_spec(name: &'static str) -> StreamSpec {
    StreamSpec {
        name,
        dtype: Dtype::U8,
        unit: Unit::One,
        frame: Frame::None,
        codec: Codec::Zstd,
        fill: "",
    }
}

impl Writer {
    /// An empty container of a schema.
    #[must_use]
    pub fn new(schema: SchemaId, provenance: &Provenance) -> Self {
        Self {
            schema,
            key: provenance.key(),
            provenance: canonical_json(provenance),
            streams: Vec::new(),
            chunks: Vec::new(),
        }
    }

    /// Adds a small structured value as a stream of its own.
    ///
    /// # Errors
    /// When its encoding is too long, or the name is taken.
    pub fn value<T: Serialize>(&mut self, name: &'static str, value: &T) -> Result<()> {
        let bytes = codec::encode(value).map_err(|what| self.inconsistent(format!("`{name}`: {what}")))?;
        self.stream(&value_spec(name), &[], &[([0; 4], bytes.as_slice())])
    }

    /// Adds a stream with all of its chunks, in the order they will have in the file. `shape` is that of one element
    /// (empty for scalars); every chunk holds whole elements. Chunks are compressed in parallel.
    ///
    /// # Errors
    /// When the stream's description or a chunk's length is impossible, or the name is taken.
    pub fn stream<T: Element>(&mut self, spec: &StreamSpec, shape: &[u32], chunks: &[Chunk<'_, T>]) -> Result<()> {
        let info = spec.info(shape);
        let problem = info.problem().or_else(|| {
            (T::DTYPE != info.dtype).then(|| {
                format!(
                    "stream `{}` is declared {:?}, given {:?}",
                    info.name,
                    info.dtype,
                    T::DTYPE
                )
            })
        });
        if let Some(problem) = problem {
            return Err(self.inconsistent(problem));
        }
        if self.streams.iter().any(|stream| stream.name == info.name) {
            return Err(self.inconsistent(format!("stream `{}` is added twice", info.name)));
        }
        if (self.chunks.len() + chunks.len()) as u64 > MAX_CHUNKS {
            return Err(self.inconsistent(format!("more than {MAX_CHUNKS} chunks")));
        }
        let stream = self.streams.len() as u32;
        let stored: std::result::Result<Vec<Stored>, String> = chunks
            .par_iter()
            .enumerate()
            .map(|(ordinal, (coordinates, elements))| {
                let bytes = bytemuck::cast_slice(elements);
                store(&info, stream, ordinal as u32, *coordinates, bytes)
            })
            .collect();
        let stored = stored.map_err(|what| self.inconsistent(what))?;
        self.chunks.extend(stored);
        self.streams.push(info);
        Ok(())
    }

    /// Writes the file atomically and returns the hash of its decoded content.
    ///
    /// # Errors
    /// When the operating system refuses; nothing is left behind then.
    pub fn commit(mut self, path: &Path) -> Result<ContentHash> {
        let version = (self.schema.major, self.schema.minor);
        let contents = self.chunks.iter().map(|chunk| ChunkContent {
            stream: chunk.entry.stream,
            coordinates: chunk.entry.coordinates,
            elements: chunk.entry.elements,
            hash: chunk.content,
        });
        let content = content_hash(self.schema.name, version, &self.streams, contents);
        let mut offset = EDGE;
        for chunk in &mut self.chunks {
            chunk.entry.offset = offset;
            // At most 2^18 chunks of at most 2^28 bytes: no overflow.
            offset = (offset + chunk.bytes.len() as u64).next_multiple_of(8);
        }
        let metadata = vec![
            (META_CONTENT.to_owned(), content.to_string()),
            (META_PROVENANCE.to_owned(), self.provenance.clone()),
        ];
        let required_features = required_features(&self.streams);
        let schema = Schema {
            name: self.schema.name.to_owned(),
            streams: std::mem::take(&mut self.streams),
            metadata,
        };
        let entries: Vec<IndexEntry> = self.chunks.iter().map(|chunk| chunk.entry).collect();
        let (schema, schema_decoded) = self.block(&schema)?;
        let (index, index_decoded) = self.block(&entries)?;
        let schema_offset = offset;
        let index_offset = (schema_offset + schema.len() as u64).next_multiple_of(8);
        let footer_offset = (index_offset + index.len() as u64).next_multiple_of(8);
        let prologue = Prologue {
            container: CONTAINER_VERSION,
            required_features,
            schema_id: schema_id(self.schema.name),
            schema_version: version,
            key: self.key,
        };
        let footer = Footer {
            schema_offset,
            schema_stored: schema.len() as u64,
            index_offset,
            index_stored: index.len() as u64,
            schema_decoded,
            index_decoded,
            blocks_hash: blocks_hash(&schema, &index),
            file_length: footer_offset + EDGE,
        };
        rogs_files::write_with(path, |file| {
            file.write_all(&prologue.to_bytes())?;
            for bytes in self.chunks.iter().map(|chunk| &chunk.bytes).chain([&schema, &index]) {
                file.write_all(bytes)?;
                let padded = align8(bytes.len() as u64).unwrap_or(u64::MAX);
                file.write_all(&[0; 7][..(padded - bytes.len() as u64) as usize])?;
            }
            file.write_all(&footer.to_bytes())
        })?;
        Ok(content)
    }

    /// Stored bytes and decoded length of a schema or index block.
    fn block<T: Serialize>(&self, value: &T) -> Result<(Vec<u8>, u32)> {
        let bytes = codec::encode(value).map_err(|what| self.inconsistent(what))?;
        let stored = compress::compress_block(&bytes).map_err(|error| self.inconsistent(error.to_string()))?;
        if stored.len() as u64 > MAX_BLOCK {
            return Err(self.inconsistent(format!("a block of {} bytes", stored.len())));
        }
        Ok((stored, bytes.len() as u32))
    }

    /// An error about the record being written.
    #[must_use]
    pub fn inconsistent(&self, what: impl Into<String>) -> Error {
        Error::Inconsistent {
            schema: self.schema.name,
            what: what.into(),
        }
    }
}

/// Feature bits that a reader of these streams must know.
pub(crate) fn required_features(streams: &[StreamInfo]) -> u32 {
    let planes = streams.iter().any(|stream| stream.codec == Codec::PlanesZstd);
    if planes { FEATURE_PLANES } else { 0 }
}

fn store(
    info: &StreamInfo,
    stream: u32,
    ordinal: u32,
    coordinates: [u32; 4],
    bytes: &[u8],
) -> std::result::Result<Stored, String> {
    let place = || format!("chunk {coordinates:?} of stream `{}`", info.name);
    let element = info.element_bytes().unwrap_or(0) as usize;
    let whole = if element == 0 {
        bytes.is_empty()
    } else {
        bytes.len().is_multiple_of(element)
    };
    if !whole || bytes.len() as u64 > MAX_CHUNK {
        return Err(format!(
            "{} has {} bytes, elements have {element}",
            place(),
            bytes.len()
        ));
    }
    let canonical = compress::canonical(info.dtype, bytes);
    let size = info.dtype.size();
    let (codec, flags, payload) = if compress::is_constant(&canonical, size) {
        (Codec::Raw, FLAG_CONSTANT, canonical[..size].to_vec())
    } else {
        let stride = info.stride as usize;
        let compressed = compress::with_scratch(|scratch| scratch.compress(info.codec, info.dtype, stride, &canonical))
            .map_err(|error| format!("{}: {error}", place()))?;
        match compressed {
            Some(compressed) => (info.codec, 0, compressed),
            None => (Codec::Raw, 0, canonical.to_vec()),
        }
    };
    let entry = IndexEntry {
        stream,
        ordinal,
        coordinates,
        offset: 0,
        stored: payload.len() as u32,
        decoded: canonical.len() as u32,
        elements: canonical.len().checked_div(element).unwrap_or(0) as u32,
        codec: codec.number(),
        flags,
        stored_hash: xxh3_64(&payload),
        decoded_crc: crc32c::crc32c(&canonical),
        reserved: 0,
    };
    Ok(Stored {
        entry,
        content: *blake3::hash(&canonical).as_bytes(),
        bytes: payload,
    })
}
