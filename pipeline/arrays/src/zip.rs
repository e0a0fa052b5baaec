//! The part of the ZIP format that `.npz` files use: stored and deflated members, ZIP64 sizes, checksums.
//!
//! Nothing is allocated beyond what the file's length, its [`budget`](crate::budget), the member's declared size and
//! [`MAX_MEMBER`] allow. Written archives are plainer: [`write_npz`](crate::write_npz).

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use crate::budget::within_budget;
use crate::error::{Error, Result};

/// Largest member that is read, bytes.
const MAX_MEMBER: u64 = 1 << 33;
/// Longest directory that is read, bytes.
const MAX_DIRECTORY: u64 = 1 << 26;
/// End record without its comment.
const END_LENGTH: usize = 22;
/// Longest tail in which the end record can lie, with its ZIP64 locator.
const MAX_TAIL: u64 = 65_535 + END_LENGTH as u64 + 20;

/// A member of an archive.
#[derive(Debug, Clone, Copy)]
struct Member {
    method: u16,
    crc: u32,
    packed: u64,
    size: u64,
    header_at: u64,
}

/// An opened archive.
#[derive(Debug)]
pub(crate) struct Zip {
    path: PathBuf,
    length: u64,
    members: BTreeMap<String, Member>,
}

impl Zip {
    /// Reads the directory of an archive.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let mut zip = Self {
            path: path.to_owned(),
            length: 0,
            members: BTreeMap::new(),
        };
        let mut file = zip.file()?;
        zip.length = file.metadata().map_err(|error| zip.io(error))?.len();
        let tail_at = zip.length.saturating_sub(MAX_TAIL);
        let tail = zip.bytes(&mut file, tail_at, zip.length - tail_at)?;
        let end = (0..(tail.len() + 1).saturating_sub(END_LENGTH))
            .rev()
            .find(|&at| tail[at..].starts_with(b"PK\x05\x06"))
            .ok_or_else(|| zip.damaged("it has no directory: the file is cut off or no `.npz`"))?;
        let (mut count, mut size, mut at) = (
            u64::from(u16_at(&tail, end + 10)),
            u64::from(u32_at(&tail, end + 12)),
            u64::from(u32_at(&tail, end + 16)),
        );
        let locator = end.checked_sub(20).filter(|&at| tail[at..].starts_with(b"PK\x06\x07"));
        if let Some(locator) = locator {
            let record = zip.bytes(&mut file, u64_at(&tail, locator + 8), 56)?;
            if !record.starts_with(b"PK\x06\x06") {
                return Err(zip.damaged("its ZIP64 record is not where it should be"));
            }
            (count, size, at) = (u64_at(&record, 32), u64_at(&record, 40), u64_at(&record, 48));
        }
        if size > MAX_DIRECTORY {
            return Err(zip.damaged("its directory is too long"));
        }
        let directory = zip.bytes(&mut file, at, size)?;
        zip.read_directory(&directory, count)?;
        // Unpacked bytes, the numbers made of them, and the parts that those are cut into.
        let unpacked = zip.members.values().map(|member| member.size);
        let needed = unpacked.fold(0_u64, |sum, size| sum.saturating_add(size.saturating_mul(3)));
        let hint = "save it with `numpy.savez` instead of `savez_compressed`, or in parts";
        within_budget(path, zip.length, needed, hint)?;
        Ok(zip)
    }

    /// Names of the members, ascending.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.members.keys().map(String::as_str)
    }

    /// The bytes of a member; `None` when there is none of this name.
    pub(crate) fn read(&self, name: &str) -> Result<Option<Vec<u8>>> {
        let Some(&member) = self.members.get(name) else {
            return Ok(None);
        };
        let wrong = |what: &str| self.damaged(&format!("member `{name}` {what}"));
        if member.size > MAX_MEMBER || member.packed > MAX_MEMBER {
            return Err(wrong("is larger than 8 GiB"));
        }
        let mut file = self.file()?;
        let header = self.bytes(&mut file, member.header_at, 30)?;
        if !header.starts_with(b"PK\x03\x04") {
            return Err(wrong("is not where the directory says"));
        }
        let skip = 30 + u64::from(u16_at(&header, 26)) + u64::from(u16_at(&header, 28));
        let packed = self.bytes(&mut file, member.header_at.saturating_add(skip), member.packed)?;
        let bytes = match member.method {
            0 => packed,
            8 => miniz_oxide::inflate::decompress_to_vec_with_limit(&packed, member.size as usize)
                .map_err(|_| wrong("cannot be unpacked"))?,
            other => return Err(wrong(&format!("is packed by method {other}; use numpy.savez"))),
        };
        if bytes.len() as u64 != member.size || crc32fast::hash(&bytes) != member.crc {
            return Err(wrong("is damaged: length or checksum differ"));
        }
        Ok(Some(bytes))
    }

    fn read_directory(&mut self, directory: &[u8], count: u64) -> Result<()> {
        let mut rest = directory;
        for _ in 0..count {
            if rest.len() < 46 || !rest.starts_with(b"PK\x01\x02") {
                return Err(self.damaged("its directory is damaged"));
            }
            let (name, extra, comment) = (u16_at(rest, 28), u16_at(rest, 30), u16_at(rest, 32));
            let (name, extra, comment) = (usize::from(name), usize::from(extra), usize::from(comment));
            let next = 46 + name + extra + comment;
            if rest.len() < next {
                return Err(self.damaged("its directory is cut off"));
            }
            let mut member = Member {
                method: u16_at(rest, 10),
                crc: u32_at(rest, 16),
                packed: u64::from(u32_at(rest, 20)),
                size: u64::from(u32_at(rest, 24)),
                header_at: u64::from(u32_at(rest, 42)),
            };
            let fields = [&mut member.size, &mut member.packed, &mut member.header_at];
            widen(&rest[46 + name..46 + name + extra], fields);
            let key = String::from_utf8_lossy(&rest[46..46 + name]).into_owned();
            if self.members.insert(key.clone(), member).is_some() {
                return Err(self.damaged(&format!("it has two members `{key}`")));
            }
            rest = &rest[next..];
        }
        Ok(())
    }

    fn file(&self) -> Result<File> {
        rogs_files::open(&self.path).map_err(|error| self.io(error))
    }

    fn bytes(&self, file: &mut File, at: u64, length: u64) -> Result<Vec<u8>> {
        if at.checked_add(length).is_none_or(|end| end > self.length) {
            return Err(self.damaged("it is cut off, or its directory points beyond its end"));
        }
        file.seek(SeekFrom::Start(at)).map_err(|error| self.io(error))?;
        let mut bytes = vec![0; length as usize];
        file.read_exact(&mut bytes).map_err(|error| self.io(error))?;
        Ok(bytes)
    }

    fn io(&self, error: std::io::Error) -> Error {
        Error::io(&self.path, error)
    }

    fn damaged(&self, what: &str) -> Error {
        Error::wrong(&self.path, what)
    }
}

/// Replaces 32-bit fields that are all ones by the values of the ZIP64 extra field, in its order.
fn widen(mut extra: &[u8], fields: [&mut u64; 3]) {
    while extra.len() >= 4 {
        let (id, length) = (u16_at(extra, 0), usize::from(u16_at(extra, 2)));
        let Some(body) = extra.get(4..4 + length) else { return };
        if id == 1 {
            let mut values = body.chunks_exact(8).map(|eight| u64_at(eight, 0));
            for field in fields.into_iter().filter(|field| **field == u64::from(u32::MAX)) {
                *field = values.next().unwrap_or(u64::MAX);
            }
            return;
        }
        extra = &extra[4 + length..];
    }
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from(u16_at(bytes, at)) | u32::from(u16_at(bytes, at + 2)) << 16
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | u64::from(u32_at(bytes, at + 4)) << 32
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;
    use crate::{NamedArray, write_npz};

    #[test]
    fn damaged_archives_are_an_error_never_a_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        let arrays = [
            NamedArray::new("frames", &[3], &[0_u32, 8, 16]),
            NamedArray::new("means", &[2, 3], &[0.5_f32; 6]),
        ];
        write_npz(&path, &arrays).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let read = || -> Result<usize> {
            let zip = Zip::open(&path)?;
            let names: Vec<String> = zip.names().map(str::to_owned).collect();
            names.iter().try_for_each(|name| zip.read(name).map(|_| ()))?;
            Ok(names.len())
        };
        assert_eq!(read().unwrap(), 2);
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(read().is_err(), "cut to {length} bytes");
        }
        let mut refused = 0;
        for at in 0..whole.len() {
            for bits in [0xff, 0x80, 0x01] {
                let mut bytes = whole.clone();
                bytes[at] ^= bits;
                std::fs::write(&path, bytes).unwrap();
                refused += usize::from(read().is_err());
            }
        }
        assert!(refused > whole.len(), "only {refused} damaged archives were refused");
        std::fs::write(&path, b"PK\x05\x06").unwrap();
        assert!(Zip::open(&path).unwrap_err().to_string().contains("no directory"));
    }
}
