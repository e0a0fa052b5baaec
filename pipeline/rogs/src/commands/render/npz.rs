//! `.npz` files for Python: a zip archive of `.npy` arrays, stored without compression, little endian, C order.

use std::io::{self, Write};
use std::path::Path;

/// A named array, encoded as a `.npy` file.
pub(super) struct Array {
    name: &'static str,
    bytes: Vec<u8>,
}

impl Array {
    /// An array of f32 values.
    pub(super) fn f32(name: &'static str, shape: &[usize], values: &[f32]) -> Self {
        let mut bytes = header("<f4", shape);
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        Self { name, bytes }
    }

    /// An array of f64 values.
    pub(super) fn f64(name: &'static str, shape: &[usize], values: &[f64]) -> Self {
        let mut bytes = header("<f8", shape);
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        Self { name, bytes }
    }
}

/// Header of a `.npy` file, version 1.0.
fn header(kind: &str, shape: &[usize]) -> Vec<u8> {
    let sizes: Vec<String> = shape.iter().map(|size| format!("{size},")).collect();
    let mut text = format!(
        "{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}",
        sizes.join(" ")
    );
    // Magic, version and length take 10 bytes, the line break one; data begin at a multiple of 64.
    let length = (10 + text.len() + 1).next_multiple_of(64) - 10;
    text += &" ".repeat(length - 1 - text.len());
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

/// Writes an archive. It appears under its name only when it is complete.
///
/// # Errors
/// When the operating system refuses, or when the arrays together exceed the 4 GiB of a plain zip archive.
pub(super) fn write(path: &Path, arrays: &[Array]) -> io::Result<()> {
    let partial = path.with_extension("npz.partial");
    let written = std::fs::File::create(&partial).and_then(|file| {
        let mut file = io::BufWriter::new(file);
        archive(&mut file, arrays)?;
        file.flush()
    });
    match written {
        Ok(()) => std::fs::rename(&partial, path),
        Err(error) => {
            // The half file is of no use to anyone; the first error is the one to report.
            let _ = std::fs::remove_file(&partial);
            Err(error)
        }
    }
}

fn archive(out: &mut impl Write, arrays: &[Array]) -> io::Result<()> {
    let limit = |size: usize| {
        u32::try_from(size)
            .map_err(|_| io::Error::other("the arrays exceed the 4 GiB of a zip archive; render smaller images"))
    };
    let (mut offset, mut directory) = (0_usize, Vec::new());
    for array in arrays {
        let name = format!("{}.npy", array.name);
        let length = limit(array.bytes.len())?;
        // What the entry and its line in the directory have in common: version needed 2.0, no flags, stored, the first
        // day that zip can say, checksum, sizes, length of the name, no extra field.
        let mut common = vec![20, 0, 0, 0, 0, 0, 0, 0, 0x21, 0];
        common.extend(checksum(&array.bytes).to_le_bytes());
        common.extend(length.to_le_bytes());
        common.extend(length.to_le_bytes());
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
        out.write_all(&array.bytes)?;
        offset += 4 + common.len() + name.len() + array.bytes.len();
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

/// CRC-32 of zip (reflected, polynomial 0xedb88320).
fn checksum(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut index = 0;
        while index < 256 {
            let mut value = index as u32;
            let mut bit = 0;
            while bit < 8 {
                value = (value >> 1) ^ if value & 1 == 1 { 0xedb8_8320 } else { 0 };
                bit += 1;
            }
            table[index] = value;
            index += 1;
        }
        table
    };
    !bytes
        .iter()
        .fold(!0, |crc: u32, &byte| (crc >> 8) ^ TABLE[usize::from(crc as u8 ^ byte)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_zip() {
        assert_eq!(checksum(b"123456789"), 0xcbf4_3926);
        assert_eq!(checksum(b""), 0);
    }

    #[test]
    fn headers_are_aligned_and_spell_shapes_as_numpy_does() {
        for (shape, text) in [(vec![], "()"), (vec![3], "(3,)"), (vec![2, 4, 5], "(2, 4, 5,)")] {
            let bytes = header("<f4", &shape);
            assert_eq!(bytes.len() % 64, 0);
            let spelled = String::from_utf8_lossy(&bytes[10..]).into_owned();
            assert!(spelled.contains(&format!("'shape': {text}, }}")), "{spelled}");
            assert_eq!(usize::from(u16::from_le_bytes([bytes[8], bytes[9]])), bytes.len() - 10);
        }
    }
}
