//! Reading `.npy` files: version 1 and 2, C order, little endian.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use rogs_worker::StageResult;

use crate::checks::{io_error, wrong};

/// An open `.npy` file whose header is read.
pub(crate) struct Npy {
    path: PathBuf,
    file: File,
    start: u64,
    kind: Kind,
    /// Shape.
    pub(crate) shape: Vec<u64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    F32,
    F64,
    U8,
    I32,
    U32,
    I64,
    U64,
}

impl Kind {
    fn size(self) -> u64 {
        match self {
            Self::U8 => 1,
            Self::F32 | Self::I32 | Self::U32 => 4,
            Self::F64 | Self::I64 | Self::U64 => 8,
        }
    }

    fn parse(descr: &str) -> Option<Self> {
        Some(match descr {
            "<f4" => Self::F32,
            "<f8" => Self::F64,
            "|u1" | "|b1" => Self::U8,
            "<i4" => Self::I32,
            "<u4" => Self::U32,
            "<i8" => Self::I64,
            "<u8" => Self::U64,
            _ => return None,
        })
    }

    fn value(self, bytes: &[u8]) -> f64 {
        let mut word = [0; 8];
        word[..bytes.len()].copy_from_slice(bytes);
        let low = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
        match self {
            Self::U8 => f64::from(word[0]),
            Self::F32 => f64::from(f32::from_bits(low)),
            Self::I32 => f64::from(low as i32),
            Self::U32 => f64::from(low),
            Self::F64 => f64::from_le_bytes(word),
            // Indices and flags: far below 2^53.
            Self::I64 => i64::from_le_bytes(word) as f64,
            Self::U64 => u64::from_le_bytes(word) as f64,
        }
    }
}

impl Npy {
    /// Opens a file and reads its header; the file must be as long as its shape says.
    pub(crate) fn open(path: &Path) -> StageResult<Self> {
        let mut file = File::open(path).map_err(|error| io_error(path, &error))?;
        let length = file.metadata().map_err(|error| io_error(path, &error))?.len();
        let mut edge = [0; 12];
        let read = |file: &mut File, bytes: &mut [u8]| {
            file.read_exact(bytes)
                .map_err(|_| wrong(path, "it is too short for a .npy file"))
        };
        read(&mut file, &mut edge[..10])?;
        if edge[..6] != *b"\x93NUMPY" || !(1..=2).contains(&edge[6]) {
            return Err(wrong(path, "it is not a .npy file of version 1 or 2"));
        }
        let (header_start, header_length) = if edge[6] == 1 {
            (10, u64::from(u16::from_le_bytes([edge[8], edge[9]])))
        } else {
            read(&mut file, &mut edge[10..])?;
            (
                12,
                u64::from(u32::from_le_bytes([edge[8], edge[9], edge[10], edge[11]])),
            )
        };
        if header_length > 65_536 {
            return Err(wrong(path, format!("a header of {header_length} bytes is impossible")));
        }
        let mut header = vec![0; header_length as usize];
        read(&mut file, &mut header)?;
        let header = String::from_utf8_lossy(&header).into_owned();
        let (kind, shape) = parse_header(&header).map_err(|what| wrong(path, what))?;
        let count = shape.iter().try_fold(1u64, |product, &dim| product.checked_mul(dim));
        let start = header_start + header_length;
        let expected = count
            .and_then(|count| count.checked_mul(kind.size()))
            .and_then(|bytes| bytes.checked_add(start));
        if expected != Some(length) {
            return Err(wrong(
                path,
                format!("the file has {length} bytes, which does not fit its shape {shape:?}"),
            ));
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            start,
            kind,
            shape,
        })
    }

    /// Demands a shape; `None` stands for any length.
    pub(crate) fn expect_shape(&self, expected: &[Option<u64>]) -> StageResult<()> {
        let fits = self.shape.len() == expected.len()
            && self
                .shape
                .iter()
                .zip(expected)
                .all(|(found, wanted)| wanted.is_none_or(|wanted| wanted == *found));
        if fits {
            return Ok(());
        }
        let text: Vec<String> = expected
            .iter()
            .map(|dim| dim.map_or("any".into(), |dim| dim.to_string()))
            .collect();
        Err(wrong(
            &self.path,
            format!("the shape is {:?}, expected [{}]", self.shape, text.join(", ")),
        ))
    }

    /// Demands floating-point values.
    pub(crate) fn expect_floats(&self) -> StageResult<()> {
        match self.kind {
            Kind::F32 | Kind::F64 => Ok(()),
            other => Err(wrong(
                &self.path,
                format!("the values are {other:?}, expected f32 or f64"),
            )),
        }
    }

    /// All values of entry `index` along the first axis.
    pub(crate) fn entry(&mut self, index: u64) -> StageResult<Vec<f64>> {
        let length: u64 = self.shape.iter().skip(1).product();
        if self.shape.first().is_none_or(|&first| index >= first) {
            return Err(wrong(
                &self.path,
                format!("there is no entry {index} in shape {:?}", self.shape),
            ));
        }
        self.read(index * length, length)
    }

    /// All values.
    pub(crate) fn all(&mut self) -> StageResult<Vec<f64>> {
        self.read(0, self.shape.iter().product())
    }

    fn read(&mut self, from: u64, count: u64) -> StageResult<Vec<f64>> {
        // The file is at least as long: its length was checked.
        let size = self.kind.size();
        let mut bytes = vec![0; (count * size) as usize];
        let seek = self.file.seek(SeekFrom::Start(self.start + from * size));
        seek.and_then(|_| self.file.read_exact(&mut bytes))
            .map_err(|error| io_error(&self.path, &error))?;
        Ok(bytes
            .chunks_exact(size as usize)
            .map(|word| self.kind.value(word))
            .collect())
    }
}

/// The dictionary `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }`.
fn parse_header(header: &str) -> Result<(Kind, Vec<u64>), String> {
    let after = |key: &str| {
        let at = header
            .find(&format!("'{key}'"))
            .ok_or_else(|| format!("the header has no `{key}`"))?;
        let rest = header[at + key.len() + 2..].trim_start();
        Ok::<&str, String>(
            rest.strip_prefix(':')
                .ok_or("the header is not a dictionary")?
                .trim_start(),
        )
    };
    let descr = after("descr")?;
    let descr = descr
        .strip_prefix('\'')
        .and_then(|rest| rest.split('\'').next())
        .ok_or("the value type is not plain")?;
    let kind = Kind::parse(descr).ok_or_else(|| format!("values of type `{descr}` are not supported"))?;
    if !after("fortran_order")?.starts_with("False") {
        return Err("the array is in Fortran order; save `numpy.ascontiguousarray(a)`".into());
    }
    let shape = after("shape")?
        .strip_prefix('(')
        .and_then(|rest| rest.split(')').next())
        .ok_or("the header has no shape")?;
    let dims = shape.split(',').map(str::trim).filter(|dim| !dim.is_empty());
    let lengths: Result<Vec<u64>, _> = dims.map(str::parse).collect();
    let lengths = lengths.map_err(|_| format!("the shape ({shape}) is not a list of lengths"))?;
    if lengths.len() > 8 {
        return Err(format!("{} dimensions are too many", lengths.len()));
    }
    Ok((kind, lengths))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_read_and_refused() {
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }  \n";
        assert_eq!(parse_header(header), Ok((Kind::F32, vec![3, 4])));
        assert_eq!(
            parse_header("{'descr': '|b1', 'fortran_order': False, 'shape': (), }"),
            Ok((Kind::U8, vec![]))
        );
        assert!(
            parse_header(&header.replace("False", "True"))
                .unwrap_err()
                .contains("Fortran")
        );
        assert!(
            parse_header(&header.replace("<f4", ">f4"))
                .unwrap_err()
                .contains("not supported")
        );
        assert!(parse_header("").is_err());
    }
}
