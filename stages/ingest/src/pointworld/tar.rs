//! Tar archives: where their files lie. Only headers are read, so that a shard of a gigabyte costs as many reads as it
//! has files.

use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::Path;

use rogs_worker::StageResult;

use crate::fault::{io_error, wrong};

/// Bytes of a header, and what file lengths are rounded up to.
const BLOCK: u64 = 512;
/// Most bytes of an extended header.
const MAX_EXTENDED: u64 = 1 << 16;
/// Most files of an archive.
const MAX_FILES: usize = 1 << 22;

/// A file in an archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TarFile {
    /// Name, with folders.
    pub(super) name: String,
    /// First byte.
    pub(super) offset: u64,
    /// Bytes.
    pub(super) length: u64,
}

/// The files of an archive, in their order.
pub(super) fn index(path: &Path) -> StageResult<Vec<TarFile>> {
    let io = |error: std::io::Error| io_error(path, &error);
    let mut file = rogs_files::open(path).map_err(io)?;
    let end = file.metadata().map_err(io)?.len();
    let (mut files, mut at, mut named) = (Vec::new(), 0, None);
    loop {
        if at + BLOCK > end {
            return Err(wrong(path, "it is cut off: an archive ends in a block of zeros"));
        }
        let mut header = [0; BLOCK as usize];
        file.seek(SeekFrom::Start(at)).map_err(io)?;
        file.read_exact(&mut header).map_err(io)?;
        if header.iter().all(|&byte| byte == 0) {
            return Ok(files);
        }
        let bad = |what: &str| wrong(path, format!("no tar archive: {what} at byte {at}"));
        let length = checked_length(&header).ok_or_else(|| bad("a damaged header"))?;
        let offset = at + BLOCK;
        let after = length
            .checked_next_multiple_of(BLOCK)
            .and_then(|length| offset.checked_add(length));
        at = after.filter(|&after| after <= end).ok_or_else(|| {
            wrong(
                path,
                format!("it is cut off: the file at byte {offset} has {length} bytes"),
            )
        })?;
        let mut extended = || -> StageResult<Vec<u8>> {
            if length > MAX_EXTENDED {
                return Err(wrong(
                    path,
                    format!("an extended header of {length} bytes is impossible"),
                ));
            }
            let mut bytes = vec![0; length as usize];
            file.seek(SeekFrom::Start(offset)).map_err(io)?;
            file.read_exact(&mut bytes).map_err(io)?;
            Ok(bytes)
        };
        match header[156] {
            b'x' => named = pax_path(&extended()?).or(named),
            b'L' => named = Some(text(&extended()?)),
            b'0' | 0 => {
                if files.len() == MAX_FILES {
                    return Err(wrong(path, format!("it has more than {MAX_FILES} files")));
                }
                files.push(TarFile {
                    name: named.take().unwrap_or_else(|| name(&header)),
                    offset,
                    length,
                });
            }
            // Folders, links and what holds for all files.
            _ => named = None,
        }
    }
}

/// The length that a header gives, once its checksum is right.
fn checked_length(header: &[u8; BLOCK as usize]) -> Option<u64> {
    let sum: u64 = header
        .iter()
        .enumerate()
        .map(|(at, &byte)| {
            // The checksum itself counts as blanks.
            u64::from(if (148..156).contains(&at) { b' ' } else { byte })
        })
        .sum();
    (octal(&header[148..156])? == sum).then(|| number(&header[124..136]))?
}

/// An octal number, or from 8 GiB on a binary one.
fn number(field: &[u8]) -> Option<u64> {
    match field.split_first()? {
        (0x80, rest) => rest
            .iter()
            .try_fold(0_u64, |sum, &byte| sum.checked_mul(256)?.checked_add(u64::from(byte))),
        _ => octal(field),
    }
}

fn octal(field: &[u8]) -> Option<u64> {
    let text = std::str::from_utf8(field).ok()?;
    u64::from_str_radix(text.trim_matches(['\0', ' ']), 8).ok()
}

fn text(field: &[u8]) -> String {
    let end = field.iter().position(|&byte| byte == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).into_owned()
}

fn name(header: &[u8; BLOCK as usize]) -> String {
    let (own, prefix) = (text(&header[..100]), text(&header[345..500]));
    let posix = header[257..263] == *b"ustar\0" && !prefix.is_empty();
    if posix { format!("{prefix}/{own}") } else { own }
}

/// The path in an extended header: records `LENGTH KEY=VALUE` and a line end.
fn pax_path(bytes: &[u8]) -> Option<String> {
    let mut rest = bytes;
    while let Some(blank) = rest.iter().position(|&byte| byte == b' ') {
        let length: usize = std::str::from_utf8(&rest[..blank]).ok()?.parse().ok()?;
        let record = rest.get(blank + 1..length)?;
        if let Some(value) = record.strip_prefix(b"path=") {
            return Some(String::from_utf8_lossy(value.strip_suffix(b"\n").unwrap_or(value)).into_owned());
        }
        rest = &rest[length..];
    }
    None
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;

    fn header(name: &str, length: usize, kind: u8) -> Vec<u8> {
        let mut header = vec![0; 512];
        header[..name.len()].copy_from_slice(name.as_bytes());
        header[124..136].copy_from_slice(format!("{length:011o}\0").as_bytes());
        header[156] = kind;
        header[257..263].copy_from_slice(b"ustar\0");
        header[148..156].fill(b' ');
        let sum: u32 = header.iter().map(|&byte| u32::from(byte)).sum();
        header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
        header
    }

    fn archive() -> Vec<u8> {
        let mut bytes = header("short.npy", 5, b'0');
        bytes.extend(b"hello");
        bytes.resize(1024, 0);
        // As Python writes times with fractions, and names beyond 100 letters.
        let records = b"20 mtime=1.50000000\n19 path=a/long.npy\n";
        bytes.extend(header("pax", records.len(), b'x'));
        bytes.extend(records);
        bytes.resize(2048, 0);
        bytes.extend(header("cut", 0, b'0'));
        bytes.resize(bytes.len() + 1024, 0);
        bytes
    }

    fn index_of(name: &str, bytes: &[u8]) -> Result<Vec<TarFile>, String> {
        let path = std::env::temp_dir().join(format!("rogs-tar-{name}-{}", std::process::id()));
        std::fs::write(&path, bytes).unwrap();
        let found = index(&path).map_err(|error| error.to_string());
        std::fs::remove_file(&path).unwrap();
        found
    }

    #[test]
    fn files_are_found_with_their_long_names() {
        let files = index_of("good", &archive()).unwrap();
        let found: Vec<_> = files
            .iter()
            .map(|file| (file.name.as_str(), file.offset, file.length))
            .collect();
        assert_eq!(found, [("short.npy", 512, 5), ("a/long.npy", 2560, 0)]);
    }

    #[test]
    fn archives_that_are_cut_off_or_damaged_are_refused() {
        let bytes = archive();
        for length in [0, 511, 700, 1024, 2048, 2560] {
            let error = index_of("cut", &bytes[..length]).unwrap_err();
            assert!(error.contains("cut off"), "{length}: {error}");
        }
        let mut damaged = bytes.clone();
        damaged[3] ^= 1;
        assert!(
            index_of("damaged", &damaged)
                .unwrap_err()
                .contains("a damaged header at byte 0")
        );
        assert!(index_of("text", &[b'x'; 2048]).unwrap_err().contains("no tar archive"));
    }
}
