//! Reading a container: every check before what it protects, no allocation before its size is known to be allowed.

use std::fs::File;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use rogs_files::fault_injection::{self, Operation};
use rogs_schemas::key::{CacheKey, ContentHash, Provenance};
use rogs_schemas::{FileInfo, SchemaId};
use serde::de::DeserializeOwned;
use xxhash_rust::xxh3::xxh3_64;

use crate::compress::{self, Buffer, Scratch};
use crate::content::{ChunkContent, content_hash};
use crate::error::{Error, Result};
use crate::layout::{
    EDGE, ENTRY_BYTES, FLAG_CONSTANT, Footer, IndexEntry, MAX_BLOCK, MAX_CHUNK, MAX_CHUNKS, MAX_FILE, MIN_FILE,
    Prologue, align8, blocks_hash, schema_id,
};
use crate::stream::{Codec, Element, StreamInfo, StreamSpec};
use crate::writer::{Schema, required_features, value_spec};
use crate::{CONTAINER_VERSION, FEATURE_PLANES, META_CONTENT, META_PROVENANCE, codec};

/// What a reader is willing to meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Longest file, bytes.
    pub file: u64,
    /// Largest sum of decoded chunks, bytes.
    pub decoded: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            file: MAX_FILE,
            decoded: 16 << 30,
        }
    }
}

/// What the header of a whole file says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileHeader {
    /// Schema name.
    pub schema: String,
    /// Schema version: breaking, additive.
    pub version: (u16, u16),
    /// The cache key it carries.
    pub key: CacheKey,
    /// Provenance and content hash.
    pub info: FileInfo,
    /// Length, bytes.
    pub length: u64,
}

/// Opens a file and checks everything but its chunks: cheap, and enough to decide whether an output is whole and which
/// key it has.
///
/// # Errors
/// When the file is missing or damaged.
pub fn read_header(path: &Path) -> Result<FileHeader> {
    Ok(Reader::open(path)?.header())
}

/// Reads only the cache key: the first and the last 64 bytes of the file, with their checksums, and its length.
/// A file that was cut off or never finished has none; what lies between is not looked at.
///
/// # Errors
/// When the file is missing, cut off, or no container.
pub fn read_key(path: &Path) -> Result<CacheKey> {
    let io = |source| Error::Io {
        action: "opening",
        path: path.to_owned(),
        source,
    };
    let damaged = |offset: u64, check: String| Error::Damaged {
        path: path.to_owned(),
        offset,
        check,
    };
    fault_injection::at(Operation::Open, path).map_err(io)?;
    let file = rogs_files::open(path).map_err(io)?;
    let status = file.metadata().map_err(io)?;
    let length = status.len();
    if !status.is_file() || length < MIN_FILE {
        return Err(damaged(0, format!("not a container file ({length} bytes)")));
    }
    let footer = Footer::from_bytes(&edge(&file, length - EDGE).map_err(io)?)
        .map_err(|(at, check)| damaged(length - EDGE + at, check))?;
    if footer.file_length != length {
        return Err(damaged(
            length - 16,
            format!("it should be {} bytes long, not {length}", footer.file_length),
        ));
    }
    let prologue = Prologue::from_bytes(&edge(&file, 0).map_err(io)?).map_err(|(at, check)| damaged(at, check))?;
    Ok(prologue.key)
}

/// Checks every byte of a file: [`read_header`], all chunks, and the content hash.
///
/// # Errors
/// When anything is damaged.
pub fn verify(path: &Path) -> Result<FileHeader> {
    let reader = Reader::open(path)?;
    reader.check_all(|_, _| ())?;
    Ok(reader.header())
}

impl Reader {
    /// Decodes every chunk, checks that their content is the one that the file says it has, and returns what `look` makes
    /// of each, in file order.
    pub(crate) fn check_all<T: Send>(&self, look: impl Fn(&IndexEntry, &[u8]) -> T + Sync) -> Result<Vec<T>> {
        let chunks: Result<Vec<(ChunkContent, T)>> = self
            .entries
            .par_iter()
            .map(|entry| {
                let mut bytes = self.buffer::<u8>(entry.decoded as usize)?;
                self.decode_chunk(entry, &mut bytes)?;
                let content = ChunkContent {
                    stream: entry.stream,
                    coordinates: entry.coordinates,
                    elements: entry.elements,
                    hash: *blake3::hash(&bytes).as_bytes(),
                };
                Ok((content, look(entry, &bytes)))
            })
            .collect();
        let (chunks, looked): (Vec<_>, Vec<_>) = chunks?.into_iter().unzip();
        let version = self.prologue.schema_version;
        let content = content_hash(&self.schema.name, version, &self.schema.streams, chunks.into_iter());
        if content != self.content {
            return Err(self.damaged(self.footer.schema_offset, "the content hash does not match the streams"));
        }
        Ok(looked)
    }
}

/// An open, checked container.
#[derive(Debug)]
pub struct Reader {
    path: PathBuf,
    file: File,
    prologue: Prologue,
    footer: Footer,
    schema: Schema,
    entries: Vec<IndexEntry>,
    provenance: Provenance,
    content: ContentHash,
}

impl Reader {
    /// Opens and checks a file: everything but its chunks, which are checked when they are read.
    ///
    /// # Errors
    /// When the file is missing, damaged, or of a newer container version.
    pub fn open(path: &Path) -> Result<Self> {
        Self::open_with(path, Limits::default())
    }

    /// [`Reader::open`] with other limits.
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub fn open_with(path: &Path, limits: Limits) -> Result<Self> {
        let io = |action| {
            move |source| Error::Io {
                action,
                path: path.to_owned(),
                source,
            }
        };
        let damaged = |offset: u64, check: String| Error::Damaged {
            path: path.to_owned(),
            offset,
            check,
        };
        fault_injection::at(Operation::Open, path).map_err(io("opening"))?;
        let file = rogs_files::open(path).map_err(io("opening"))?;
        let status = file.metadata().map_err(io("opening"))?;
        let length = status.len();
        if !status.is_file() {
            return Err(damaged(0, "it is not a file".into()));
        }
        if length < MIN_FILE || length > limits.file {
            return Err(damaged(
                0,
                format!(
                    "a length of {length} bytes is impossible ({MIN_FILE} to {})",
                    limits.file
                ),
            ));
        }
        let start = Prologue::from_bytes(&edge(&file, 0).map_err(io("reading"))?);
        let footer =
            Footer::from_bytes(&edge(&file, length - EDGE).map_err(io("reading"))?).map_err(|(at, check)| {
                match (at, &start) {
                    (60, Err((0, _))) => damaged(0, "it is no .r4c file: it neither begins nor ends as one".into()),
                    _ => damaged(length - EDGE + at, check),
                }
            })?;
        if footer.file_length != length {
            return Err(damaged(
                length - 16,
                format!("it should be {} bytes long, not {length}", footer.file_length),
            ));
        }
        let prologue = start.map_err(|(at, check)| damaged(at, check))?;
        if prologue.container.0 > CONTAINER_VERSION.0 || prologue.required_features & !FEATURE_PLANES != 0 {
            return Err(Error::WrongKind {
                path: path.to_owned(),
                found: format!(
                    "container version {}.{} with required features {:#x}",
                    prologue.container.0, prologue.container.1, prologue.required_features
                ),
                expected: format!(
                    "at most version {} without such features; a newer program wrote it",
                    CONTAINER_VERSION.0
                ),
            });
        }
        check_footer(&footer).map_err(|(at, check)| damaged(length - EDGE + at, check))?;

        // Both blocks with their padding lie back to back and end at the footer.
        let mut blocks = vec![0; (length - EDGE - footer.schema_offset) as usize];
        read_at(&file, &mut blocks, footer.schema_offset).map_err(io("reading"))?;
        let (schema_block, index_block) = blocks.split_at((footer.index_offset - footer.schema_offset) as usize);
        let (schema_block, schema_padding) = schema_block.split_at(footer.schema_stored as usize);
        let (index_block, index_padding) = index_block.split_at(footer.index_stored as usize);
        if schema_padding.iter().chain(index_padding).any(|&byte| byte != 0) {
            return Err(damaged(
                footer.schema_offset,
                "padding beside schema or index is not zero".into(),
            ));
        }
        if blocks_hash(schema_block, index_block) != footer.blocks_hash {
            return Err(damaged(
                footer.schema_offset,
                "the checksum of schema and index does not match".into(),
            ));
        }
        let schema: Schema = compress::decompress_block(schema_block, footer.schema_decoded as usize)
            .and_then(|bytes| codec::decode(&bytes))
            .map_err(|what| damaged(footer.schema_offset, format!("schema: {what}")))?;
        let index = compress::decompress_block(index_block, footer.index_decoded as usize)
            .map_err(|what| damaged(footer.index_offset, format!("index: {what}")))?;
        let entries = decode_index(&index).map_err(|what| damaged(footer.index_offset, format!("index: {what}")))?;
        let (provenance, content) = check_schema(&schema, &prologue)
            .map_err(|what| damaged(footer.schema_offset, format!("schema: {what}")))?;
        check_entries(&schema.streams, &entries, footer.schema_offset, limits.decoded)
            .map_err(|what| damaged(footer.index_offset, format!("index: {what}")))?;
        Ok(Self {
            path: path.to_owned(),
            file,
            prologue,
            footer,
            schema,
            entries,
            provenance,
            content,
        })
    }

    /// Refuses other schemas and other breaking versions. A newer additive version is read; its additions are ignored.
    ///
    /// # Errors
    /// [`Error::WrongKind`].
    pub fn expect_schema(&self, schema: SchemaId) -> Result<()> {
        let (major, minor) = self.prologue.schema_version;
        if self.schema.name == schema.name && major == schema.major {
            return Ok(());
        }
        let found = format!("{} {major}.{minor}", self.schema.name);
        Err(Error::WrongKind {
            path: self.path.clone(),
            found,
            expected: schema.to_string(),
        })
    }

    /// What the header says.
    #[must_use]
    pub fn header(&self) -> FileHeader {
        FileHeader {
            schema: self.schema.name.clone(),
            version: self.prologue.schema_version,
            key: self.prologue.key,
            info: FileInfo {
                provenance: self.provenance.clone(),
                content: self.content,
            },
            length: self.footer.file_length,
        }
    }

    /// How it was made.
    #[must_use]
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// Hash of the decoded content.
    #[must_use]
    pub fn content_hash(&self) -> ContentHash {
        self.content
    }

    /// All streams of the file.
    #[must_use]
    pub fn streams(&self) -> &[StreamInfo] {
        &self.schema.streams
    }

    /// True when the file has a stream of this name.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.schema.streams.iter().any(|stream| stream.name == name)
    }

    /// Coordinates and element counts of a stream's chunks, in order.
    ///
    /// # Errors
    /// When the stream is missing.
    pub fn chunks(&self, name: &str) -> Result<Vec<([u32; 4], u32)>> {
        let (number, _) = self.find(name)?;
        Ok(self
            .entries_of(number)
            .iter()
            .map(|entry| (entry.coordinates, entry.elements))
            .collect())
    }

    /// A small structured value written by [`Writer::value`](crate::Writer::value).
    ///
    /// # Errors
    /// When the stream is missing or damaged.
    pub fn value<T: DeserializeOwned>(&self, name: &'static str) -> Result<T> {
        let bytes = self.stream::<u8>(&value_spec(name), &[])?;
        codec::decode(&bytes).map_err(|what| self.inconsistent(format!("`{name}`: {what}")))
    }

    /// A whole stream: its chunks one behind the other. Chunks are decompressed in parallel.
    ///
    /// # Errors
    /// When the stream is missing, damaged, or of another type, shape, unit or frame.
    pub fn stream<T: Element>(&self, spec: &StreamSpec, shape: &[u32]) -> Result<Vec<T>> {
        let number = self.matching::<T>(spec, shape)?;
        let mut values = self.buffer::<T>(self.decoded_bytes(number) / size_of::<T>())?;
        self.fill(number, bytemuck::cast_slice_mut(&mut values))?;
        Ok(values)
    }

    /// Bytes of a whole stream when decoded. The sum was checked against the limit when the file was opened.
    fn decoded_bytes(&self, number: u32) -> usize {
        self.entries_of(number).iter().map(|entry| entry.decoded as usize).sum()
    }

    /// The decoded bytes of a whole stream, whatever its type.
    ///
    /// # Errors
    /// When the stream is missing or damaged.
    pub fn stream_bytes(&self, name: &str) -> Result<Vec<u8>> {
        let (number, _) = self.find(name)?;
        let mut bytes = self.buffer::<u8>(self.decoded_bytes(number))?;
        self.fill(number, &mut bytes)?;
        Ok(bytes)
    }

    fn fill(&self, number: u32, mut rest: &mut [u8]) -> Result<()> {
        let mut targets = Vec::new();
        for entry in self.entries_of(number) {
            let (target, after) = rest.split_at_mut(entry.decoded as usize);
            targets.push((entry, target));
            rest = after;
        }
        targets
            .into_par_iter()
            .map(|(entry, target)| self.decode_chunk(entry, target))
            .collect()
    }

    /// One chunk of a stream, by its coordinates. Only its bytes are read.
    ///
    /// # Errors
    /// As [`Reader::stream`], and when there is no such chunk.
    pub fn read_chunk<T: Element>(&self, spec: &StreamSpec, shape: &[u32], coordinates: [u32; 4]) -> Result<Vec<T>> {
        let entries = self.entries_of(self.matching::<T>(spec, shape)?);
        let entry = entries
            .iter()
            .find(|entry| entry.coordinates == coordinates)
            .ok_or_else(|| self.inconsistent(format!("stream `{}` has no chunk {coordinates:?}", spec.name)))?;
        let mut values = self.buffer::<T>(entry.decoded as usize / size_of::<T>())?;
        self.decode_chunk(entry, bytemuck::cast_slice_mut(&mut values))?;
        Ok(values)
    }

    /// The decoded bytes of chunk `ordinal` of a stream, whatever its type.
    ///
    /// # Errors
    /// When the stream or the chunk is missing or damaged.
    pub fn chunk_bytes(&self, name: &str, ordinal: usize) -> Result<Vec<u8>> {
        let (number, _) = self.find(name)?;
        let entry = self.entries_of(number).get(ordinal);
        let entry = entry.ok_or_else(|| self.inconsistent(format!("stream `{name}` has no chunk {ordinal}")))?;
        let mut bytes = self.buffer::<u8>(entry.decoded as usize)?;
        self.decode_chunk(entry, &mut bytes)?;
        Ok(bytes)
    }

    /// An error about what the streams say.
    #[must_use]
    pub fn inconsistent(&self, what: impl std::fmt::Display) -> Error {
        self.damaged(EDGE, format!("record `{}`: {what}", self.schema.name))
    }

    pub(crate) fn entries(&self) -> &[IndexEntry] {
        &self.entries
    }

    pub(crate) fn container_version(&self) -> (u16, u16) {
        self.prologue.container
    }

    /// Decodes a chunk of bytes whatever its type; `out` has the decoded length.
    pub(crate) fn decode_chunk(&self, entry: &IndexEntry, out: &mut [u8]) -> Result<()> {
        compress::with_scratch(|scratch| {
            let mut memory = scratch.stored();
            let decoded = self.decode_through(scratch, &mut memory, entry, out);
            scratch.give_back(memory);
            decoded
        })
    }

    fn decode_through(
        &self,
        scratch: &mut Scratch,
        memory: &mut Buffer,
        entry: &IndexEntry,
        out: &mut [u8],
    ) -> Result<()> {
        let info = &self.schema.streams[entry.stream as usize];
        let fail = |check: &str| {
            let place = format!("stream `{}`, chunk {:?}", info.name, entry.coordinates);
            self.damaged(entry.offset, format!("{place}: {check}"))
        };
        // With the padding behind it, which ends at the latest where the schema begins.
        let padded = u64::from(entry.stored).next_multiple_of(8) as usize;
        let stored = memory.take(padded).map_err(|_| self.no_memory())?;
        read_at(&self.file, stored, entry.offset).map_err(|source| Error::Io {
            action: "reading",
            path: self.path.clone(),
            source,
        })?;
        let (stored, padding) = stored.split_at(entry.stored as usize);
        if padding.iter().any(|&byte| byte != 0) {
            return Err(fail("padding is not zero"));
        }
        if xxh3_64(stored) != entry.stored_hash {
            return Err(fail("the checksum of the stored bytes does not match"));
        }
        let crc = if entry.flags & FLAG_CONSTANT != 0 {
            for scalar in out.chunks_exact_mut(stored.len()) {
                scalar.copy_from_slice(stored);
            }
            crc32c::crc32c(out)
        } else {
            let codec = Codec::from_number(entry.codec).ok_or_else(|| fail("unknown codec"))?;
            scratch
                .decompress(codec, info.dtype, info.stride as usize, stored, out)
                .map_err(|what| fail(&what))?
        };
        if crc != entry.decoded_crc {
            return Err(fail("the checksum of the decoded bytes does not match"));
        }
        Ok(())
    }

    /// A zeroed buffer; an error instead of an abort when there is no memory.
    pub(crate) fn buffer<T: bytemuck::Pod>(&self, length: usize) -> Result<Vec<T>> {
        let mut values = bytemuck::allocation::try_zeroed_vec(length).map_err(|()| self.no_memory())?;
        crate::memory::prefer_large_pages(bytemuck::cast_slice_mut(&mut values));
        Ok(values)
    }

    fn no_memory(&self) -> Error {
        Error::Io {
            action: "finding memory to read",
            path: self.path.clone(),
            source: std::io::Error::from(std::io::ErrorKind::OutOfMemory),
        }
    }

    fn find(&self, name: &str) -> Result<(u32, &StreamInfo)> {
        let position = self.schema.streams.iter().position(|stream| stream.name == name);
        let number = position.ok_or_else(|| self.inconsistent(format!("stream `{name}` is missing")))?;
        Ok((number as u32, &self.schema.streams[number]))
    }

    fn matching<T: Element>(&self, spec: &StreamSpec, shape: &[u32]) -> Result<u32> {
        let (number, info) = self.find(spec.name)?;
        let as_declared = info.dtype == spec.dtype
            && info.dtype == T::DTYPE
            && info.shape == shape
            && info.unit == spec.unit
            && info.frame == spec.frame;
        if as_declared {
            return Ok(number);
        }
        Err(self.inconsistent(format!(
            "stream `{}` holds {:?} {:?} in {:?} of frame {:?}, expected {:?} {shape:?} in {:?} of frame {:?}",
            info.name, info.dtype, info.shape, info.unit, info.frame, spec.dtype, spec.unit, spec.frame
        )))
    }

    fn entries_of(&self, stream: u32) -> &[IndexEntry] {
        let start = self.entries.partition_point(|entry| entry.stream < stream);
        let end = self.entries.partition_point(|entry| entry.stream <= stream);
        &self.entries[start..end]
    }

    fn damaged(&self, offset: u64, check: impl Into<String>) -> Error {
        Error::Damaged {
            path: self.path.clone(),
            offset,
            check: check.into(),
        }
    }
}

fn edge(file: &File, offset: u64) -> std::io::Result<[u8; EDGE as usize]> {
    let mut bytes = [0; EDGE as usize];
    read_at(file, &mut bytes, offset)?;
    Ok(bytes)
}

#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_at(file: &File, mut bytes: &mut [u8], mut offset: u64) -> std::io::Result<()> {
    while !bytes.is_empty() {
        let count = std::os::windows::fs::FileExt::seek_read(file, bytes, offset)?;
        if count == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        bytes = &mut bytes[count..];
        offset += count as u64;
    }
    Ok(())
}

/// Checks where the blocks lie: schema, index and footer follow each other without a hole.
fn check_footer(footer: &Footer) -> std::result::Result<(), (u64, String)> {
    let Footer {
        schema_offset,
        schema_stored,
        index_offset,
        index_stored,
        ..
    } = *footer;
    let sizes = [
        schema_stored,
        index_stored,
        u64::from(footer.schema_decoded),
        u64::from(footer.index_decoded),
    ];
    if sizes.iter().any(|&size| size > MAX_BLOCK) {
        return Err((8, format!("schema or index is larger than {MAX_BLOCK} bytes")));
    }
    let follows = |offset: u64, length: u64, next: u64| offset.checked_add(length).and_then(align8) == Some(next);
    let aligned = schema_offset >= EDGE && schema_offset.is_multiple_of(8);
    let footer_offset = footer.file_length - EDGE;
    if !aligned
        || !follows(schema_offset, schema_stored, index_offset)
        || !follows(index_offset, index_stored, footer_offset)
    {
        return Err((0, "schema and index do not lie between chunks and footer".into()));
    }
    Ok(())
}

fn decode_index(bytes: &[u8]) -> std::result::Result<Vec<IndexEntry>, String> {
    let count = match bytes.first_chunk::<8>() {
        Some(count) => u64::from_le_bytes(*count),
        None => return Err("it has no count".into()),
    };
    if count > MAX_CHUNKS || bytes.len() as u64 != 8 + ENTRY_BYTES * count {
        return Err(format!("{count} chunks in {} bytes", bytes.len()));
    }
    codec::decode(bytes)
}

fn check_schema(schema: &Schema, prologue: &Prologue) -> std::result::Result<(Provenance, ContentHash), String> {
    if schema_id(&schema.name) != prologue.schema_id {
        return Err(format!(
            "the name {:?} does not belong to the schema id of the prologue",
            schema.name
        ));
    }
    for (number, stream) in schema.streams.iter().enumerate() {
        if let Some(problem) = stream.problem() {
            return Err(problem);
        }
        if schema.streams[..number].iter().any(|other| other.name == stream.name) {
            return Err(format!("two streams are named `{}`", stream.name));
        }
    }
    if required_features(&schema.streams) != prologue.required_features {
        return Err("the codecs do not fit the features that the prologue announces".into());
    }
    if !schema.metadata.is_sorted_by(|a, b| a.0 < b.0) {
        return Err("metadata keys are not sorted".into());
    }
    let metadata = |key: &str| {
        let found = schema.metadata.iter().find(|(name, _)| name == key);
        found
            .map(|(_, value)| value.as_str())
            .ok_or_else(|| format!("metadata has no `{key}`"))
    };
    let provenance: Provenance =
        serde_json::from_str(metadata(META_PROVENANCE)?).map_err(|error| format!("provenance: {error}"))?;
    if provenance.key() != prologue.key {
        return Err(format!(
            "the provenance has key {}, the prologue {}",
            provenance.key(),
            prologue.key
        ));
    }
    let content = metadata(META_CONTENT)?
        .parse()
        .map_err(|error| format!("content hash: {error}"))?;
    Ok((provenance, content))
}

/// Checks that the chunks fill the space between prologue and schema in order, and that their sizes agree.
fn check_entries(
    streams: &[StreamInfo],
    entries: &[IndexEntry],
    end: u64,
    budget: u64,
) -> std::result::Result<(), String> {
    let mut offset = EDGE;
    let mut decoded = 0u64;
    let mut expected = (0, 0);
    for (number, entry) in entries.iter().enumerate() {
        let fail = |what: String| format!("chunk {number}: {what}");
        let stream = streams
            .get(entry.stream as usize)
            .ok_or_else(|| fail(format!("stream {}", entry.stream)))?;
        let next_stream = entry.stream > expected.0 && entry.ordinal == 0;
        if (entry.stream, entry.ordinal) != expected && !next_stream {
            return Err(fail(format!(
                "stream {} ordinal {} is out of order",
                entry.stream, entry.ordinal
            )));
        }
        expected = (entry.stream, entry.ordinal + 1);
        if entry.offset != offset {
            return Err(fail(format!("it begins at {} instead of {offset}", entry.offset)));
        }
        let after = offset
            .checked_add(u64::from(entry.stored))
            .and_then(align8)
            .filter(|&after| after <= end);
        offset = after.ok_or_else(|| fail("it reaches beyond the chunks".into()))?;
        let size = stream
            .element_bytes()
            .and_then(|bytes| bytes.checked_mul(u64::from(entry.elements)));
        if size != Some(u64::from(entry.decoded)) || u64::from(entry.decoded) > MAX_CHUNK {
            return Err(fail(format!(
                "{} elements of stream `{}` in {} bytes",
                entry.elements, stream.name, entry.decoded
            )));
        }
        let constant = entry.flags == FLAG_CONSTANT;
        let codec_fits = entry.codec == Codec::Raw.number() || (entry.codec == stream.codec.number() && !constant);
        let scalar = stream.dtype.size() as u32;
        let stored_fits = match (constant, entry.codec) {
            (true, _) => entry.stored == scalar && entry.decoded > scalar,
            (false, 0) => entry.stored == entry.decoded,
            (false, _) => entry.stored < entry.decoded,
        };
        if entry.flags > FLAG_CONSTANT || entry.reserved != 0 || !codec_fits || !stored_fits {
            return Err(fail(format!(
                "codec {}, flags {}, {} stored bytes for {}",
                entry.codec, entry.flags, entry.stored, entry.decoded
            )));
        }
        decoded += u64::from(entry.decoded);
        if decoded > budget {
            return Err(fail(format!(
                "the chunks decode to more than the limit of {budget} bytes"
            )));
        }
    }
    if offset != end {
        return Err(format!("the chunks end at {offset}, the schema begins at {end}"));
    }
    Ok(())
}
