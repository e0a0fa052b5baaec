//! A safetensors file, mapped or inside the program.

use std::collections::BTreeMap;
use std::fs::File;
use std::ops::Deref;
use std::path::{Path, PathBuf};

use memmap2::Mmap;

use super::header::{self, MAX_HEADER_BYTES, TensorEntry};
use crate::{Bundled, ParameterSource};
use crate::{Error, Result};

/// A safetensors file mapped into memory, or one inside the program.
pub struct TensorFile {
    path: PathBuf,
    bytes: Bytes,
    data_start: usize,
    tensors: BTreeMap<String, TensorEntry>,
    metadata: BTreeMap<String, String>,
}

/// Where the bytes of a file are.
enum Bytes {
    Mapped(Mmap),
    Bundled(&'static [u8]),
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Bundled(bytes) => bytes,
        }
    }
}

impl TensorFile {
    /// Maps a file and reads its header.
    ///
    /// # Errors
    /// When it cannot be read or is damaged.
    pub fn open(path: &Path) -> Result<Self> {
        let io = |source| Error::Io {
            path: path.to_owned(),
            source,
        };
        let file = rogs_files::open(path).map_err(io)?;
        Self::read(path, Bytes::Mapped(map_read_only(&file).map_err(io)?))
    }

    /// A file inside the program, under its name.
    ///
    /// # Errors
    /// When it is damaged.
    pub fn bundled(file: &Bundled) -> Result<Self> {
        Self::read(Path::new(file.name), Bytes::Bundled(file.bytes))
    }

    fn read(path: &Path, bytes: Bytes) -> Result<Self> {
        let bad = |reason: String| Error::BadFile {
            path: path.to_owned(),
            reason,
        };
        let Some(length) = bytes.first_chunk::<8>().map(|bytes| u64::from_le_bytes(*bytes)) else {
            return Err(bad("it is too short to be a safetensors file".into()));
        };
        if length > MAX_HEADER_BYTES || length > (bytes.len() - 8) as u64 {
            return Err(bad(format!(
                "it claims a header of {length} bytes: not a safetensors file, or cut short"
            )));
        }
        let data_start = 8 + length as usize;
        let (tensors, metadata) = header::parse(&bytes[8..data_start], bytes.len() - data_start).map_err(bad)?;
        Ok(Self {
            path: path.to_owned(),
            bytes,
            data_start,
            tensors,
            metadata,
        })
    }

    /// Tensors by name.
    #[must_use]
    pub fn tensors(&self) -> &BTreeMap<String, TensorEntry> {
        &self.tensors
    }

    /// Metadata of the header.
    #[must_use]
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// Number of values of all tensors.
    #[must_use]
    pub fn len(&self) -> usize {
        self.tensors
            .values()
            .map(|entry| entry.shape.iter().product::<usize>())
            .sum()
    }

    /// True when the file has no value.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl ParameterSource for TensorFile {
    fn shape(&self, name: &str) -> Option<&[usize]> {
        self.tensors.get(name).map(|entry| entry.shape.as_slice())
    }

    fn values(&self, name: &str) -> Result<Vec<f32>> {
        let entry = self
            .tensors
            .get(name)
            .ok_or_else(|| Error::MissingTensor { name: name.to_owned() })?;
        let start = self.data_start + entry.start;
        let bytes = &self.bytes[start..start + entry.bytes];
        entry.stored.to_f32(bytes).map_err(|reason| Error::BadFile {
            path: self.path.clone(),
            reason: format!("the tensor `{name}` {reason}"),
        })
    }

    fn names(&self) -> Vec<&str> {
        self.tensors.keys().map(String::as_str).collect()
    }
}

/// Maps a file for reading.
// Mapping needs unsafe because the kernel would show a concurrent change of the file. Values are copied out and every
// bit pattern is a valid number, so such a change can give wrong numbers but nothing worse; a file that is cut shorter
// while it is used ends the process with SIGBUS, as documented for checkpoints: do not write to one in use.
#[allow(unsafe_code)]
fn map_read_only(file: &File) -> std::io::Result<Mmap> {
    // SAFETY: the map is private to this module and only read, see above.
    unsafe { Mmap::map(file) }
}
