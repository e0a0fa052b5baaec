//! Opening HDF5 files and finding what they hold.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use hdf5_reader::error::Error as Fault;
use hdf5_reader::{FilterRegistry, OpenOptions, RawAttribute};

use super::attribute::{self, Hdf5Value};
use super::{EXPANSION, MAX_CHUNK, MAX_HEADER, MAX_READ, lzf};
use crate::error::{Error, Result};

/// Number of h5py's LZF filter.
const LZF: u16 = 32000;

/// An open HDF5 file.
pub struct Hdf5File {
    path: PathBuf,
    pub(super) file: hdf5_reader::Hdf5File,
    length: u64,
}

impl Hdf5File {
    /// Opens a file; nothing but its header is read.
    ///
    /// # Errors
    /// When it cannot be read, is no HDF5 file or is cut off.
    pub fn open(path: &Path) -> Result<Self> {
        // The reader opens the file itself: here only regular files come to it.
        let file = rogs_files::open(path).map_err(|error| Error::io(path, error))?;
        let length = file.metadata().map_err(|error| Error::io(path, error))?.len();
        Self::opened(
            path,
            length,
            hdf5_reader::Hdf5File::open_with_options(path, options(length)),
        )
    }

    /// Reads a file that is in memory; `path` is its name for messages.
    ///
    /// # Errors
    /// As for [`open`](Self::open).
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        let length = bytes.len() as u64;
        Self::opened(
            path,
            length,
            hdf5_reader::Hdf5File::from_vec_with_options(bytes, options(length)),
        )
    }

    fn opened(path: &Path, length: u64, file: std::result::Result<hdf5_reader::Hdf5File, Fault>) -> Result<Self> {
        let file = file.map_err(|error| failed(path, "its header", error))?;
        let announced = file.superblock().eof_address;
        if announced > length && announced != u64::MAX {
            let what = format!("it is cut off: its header announces {announced} bytes, it has {length}");
            return Err(Error::wrong(path, what));
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            length,
        })
    }

    /// Where it lies.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Names of the groups in a group (`""` is the root), ascending.
    ///
    /// # Errors
    /// When there is no such group, or it is damaged.
    pub fn groups(&self, group: &str) -> Result<Vec<String>> {
        Ok(self.members(group)?.0)
    }

    /// Names of the data sets in a group (`""` is the root), ascending.
    ///
    /// # Errors
    /// When there is no such group, or it is damaged.
    pub fn datasets(&self, group: &str) -> Result<Vec<String>> {
        Ok(self.members(group)?.1)
    }

    /// Whether there is such a group.
    ///
    /// # Errors
    /// When the file is damaged on the way to it.
    pub fn has_group(&self, group: &str) -> Result<bool> {
        Ok(found(self.file.group(group))
            .map_err(|error| self.failed(group, error))?
            .is_some())
    }

    /// Most bytes that one read may make of this file.
    pub(super) fn limit(&self) -> u64 {
        limit(self.length)
    }

    pub(super) fn wrong(&self, at: &str, what: &str) -> Error {
        Error::wrong(&self.path, format!("`{at}`: {what}"))
    }

    pub(super) fn failed(&self, at: &str, error: Fault) -> Error {
        failed(&self.path, &format!("`{at}`"), error)
    }

    fn members(&self, group: &str) -> Result<(Vec<String>, Vec<String>)> {
        let found = found(self.file.group(group)).map_err(|error| self.failed(group, error))?;
        let found = found.ok_or_else(|| Error::wrong(&self.path, self.missing(group)))?;
        let (mut groups, mut datasets) = found.member_names().map_err(|error| self.failed(group, error))?;
        groups.sort();
        datasets.sort();
        Ok((groups, datasets))
    }

    /// What is missing, and what there is in the deepest group on the way that is there.
    pub(super) fn missing(&self, at: &str) -> String {
        const SHOWN: usize = 12;
        let mut there = at;
        while let Some((parent, _)) = there.rsplit_once('/') {
            there = parent;
            if self.file.group(there).is_ok() {
                break;
            }
        }
        let there = if there == at || self.file.group(there).is_err() {
            ""
        } else {
            there
        };
        let names = self.file.group(there).and_then(|group| group.member_names());
        let names: Vec<String> = names
            .map(|(groups, datasets)| [groups, datasets].concat())
            .unwrap_or_default();
        let holds = match names.len() {
            0 => "nothing".to_owned(),
            count if count > SHOWN => format!("{}, and {} more", names[..SHOWN].join(", "), count - SHOWN),
            _ => names.join(", "),
        };
        format!("it has no `{at}`; `/{there}` holds {holds}")
    }
}

fn limit(length: u64) -> u64 {
    length.saturating_mul(EXPANSION).min(MAX_READ)
}

fn options(length: u64) -> OpenOptions {
    let mut filters = FilterRegistry::new();
    filters.register(
        LZF,
        Box::new(|_, packed, _| lzf::unpack(packed, MAX_CHUNK).map_err(Fault::DecompressionError)),
    );
    OpenOptions {
        // Everything is read once.
        chunk_cache_bytes: 0,
        filter_registry: Some(filters),
        max_chunk_bytes: MAX_CHUNK,
        max_read_bytes: limit(length) as usize,
        max_object_header_bytes: MAX_HEADER,
        ..OpenOptions::default()
    }
}

/// `None` for what is not there.
pub(super) fn found<T>(result: std::result::Result<T, Fault>) -> std::result::Result<Option<T>, Fault> {
    fn absent(error: &Fault) -> bool {
        match error {
            Fault::Context { source, .. } => absent(source),
            Fault::GroupNotFound(_) | Fault::DatasetNotFound(_) => true,
            _ => false,
        }
    }
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if absent(&error) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Decoded attributes; the bytes that references refer to are bounded in sum.
pub(super) fn values_of(
    file: &Hdf5File,
    at: &str,
    raw: Vec<RawAttribute>,
    reference: usize,
    resolve: impl Fn(&[u8]) -> std::result::Result<Vec<u8>, Fault>,
) -> Result<BTreeMap<String, Hdf5Value>> {
    let mut left = file.limit();
    let mut bounded = |bytes: &[u8]| {
        let found = resolve(bytes).map_err(|error| error.to_string())?;
        left = left
            .checked_sub(found.len() as u64)
            .ok_or("more text than the file can hold")?;
        Ok(found)
    };
    let mut values = BTreeMap::new();
    for attribute in raw {
        let name = attribute.name().to_owned();
        let value = attribute::value(attribute.message(), reference, &mut bounded)
            .map_err(|what| file.wrong(at, &format!("attribute `{name}`: {what}")))?;
        values.insert(name, value);
    }
    Ok(values)
}

/// A failure of the reader, with what a person can do about it.
fn failed(path: &Path, at: &str, error: Fault) -> Error {
    match error {
        Fault::Context { source, .. } => failed(path, at, *source),
        Fault::Io(error) => Error::io(path, error),
        Fault::InvalidMagic => Error::wrong(path, "it is no HDF5 file"),
        Fault::UnexpectedEof { .. } | Fault::OffsetOutOfBounds(_) => {
            Error::wrong(path, format!("{at}: it is cut off or damaged: {error}"))
        }
        Fault::UnsupportedFilter(filter) => Error::wrong(
            path,
            format!(
                "{at} is packed by a filter that is not read ({filter}); pack it anew: `h5repack -f GZIP=4 IN OUT`"
            ),
        ),
        error => Error::wrong(path, format!("{at}: {error}")),
    }
}
