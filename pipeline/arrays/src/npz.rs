//! Writing numpy's `.npz` format: a ZIP archive of `.npy` files, stored without compression.

use std::io::{Error, Result, Write};
use std::path::Path;

use crate::dtype::Scalar;
use crate::npy::npy_bytes;

/// A named array, encoded as a `.npy` file.
#[derive(Debug, Clone)]
pub struct NamedArray {
    name: String,
    npy: Vec<u8>,
}

impl NamedArray {
    /// An array of this shape, row-major.
    #[must_use]
    pub fn new<T: Scalar>(name: &str, shape: &[usize], values: &[T]) -> Self {
        Self {
            name: format!("{name}.npy"),
            npy: npy_bytes(shape, values),
        }
    }
}

/// Writes an archive of arrays.
///
/// # Errors
/// When the operating system refuses, or the arrays together exceed the 4 GiB of a plain ZIP archive.
pub fn write_npz(path: &Path, arrays: &[NamedArray]) -> rogs_files::Result<()> {
    rogs_files::write_with(path, |out| archive(out, arrays))
}

/// Time and date of the members: the first day that ZIP can say.
const NO_TIME: [u8; 4] = [0, 0, 0x21, 0];

fn archive(out: &mut impl Write, arrays: &[NamedArray]) -> Result<()> {
    let limit =
        |size: usize| u32::try_from(size).map_err(|_| Error::other("the arrays exceed the 4 GiB of a zip archive"));
    let (mut offset, mut directory) = (0_usize, Vec::new());
    for NamedArray { name, npy } in arrays {
        let length = limit(npy.len())?.to_le_bytes();
        // What the member and its line in the directory have in common: version needed 2.0, no flags, stored, time,
        // checksum, sizes (packed and plain), length of the name, no extra field.
        let mut common = vec![20, 0, 0, 0, 0, 0];
        common.extend(NO_TIME);
        common.extend(crc32fast::hash(npy).to_le_bytes());
        common.extend(length);
        common.extend(length);
        common.extend((name.len() as u16).to_le_bytes());
        common.extend([0, 0]);
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&common);
        // No comment, first disk, no attributes.
        directory.extend([0; 10]);
        directory.extend(limit(offset)?.to_le_bytes());
        directory.extend(name.as_bytes());
        out.write_all(b"PK\x03\x04")?;
        out.write_all(&common)?;
        out.write_all(name.as_bytes())?;
        out.write_all(npy)?;
        offset += 4 + common.len() + name.len() + npy.len();
    }
    out.write_all(&directory)?;
    out.write_all(b"PK\x05\x06\0\0\0\0")?;
    let count = (arrays.len() as u16).to_le_bytes();
    out.write_all(&count)?;
    out.write_all(&count)?;
    out.write_all(&limit(directory.len())?.to_le_bytes())?;
    out.write_all(&limit(offset)?.to_le_bytes())?;
    out.write_all(&[0, 0])
}
