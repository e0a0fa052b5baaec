//! Named arrays in files: numpy's `.npz` and safetensors.

use std::path::{Path, PathBuf};

use safetensors::{Dtype, SafeTensors};

use crate::outside::OutsideError;
use crate::outside::zip::Zip;

/// Largest safetensors file that is read, bytes.
const MAX_FILE: u64 = 1 << 34;
/// Longest header of a `.npy` member that is believed, bytes.
const MAX_HEADER: usize = 1 << 16;
/// Most dimensions of an array.
const MAX_DIMENSIONS: usize = 8;

/// An array of numbers, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Its name in the file, for messages.
    pub name: String,
    /// Lengths of its dimensions.
    pub shape: Vec<usize>,
    /// Its values.
    pub values: Values,
}

/// Values as the file has them: bytes stay bytes, for 8-bit images are scaled, all other types become f32 (integers up to
/// 2^24 exactly).
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// 8-bit unsigned.
    Bytes(Vec<u8>),
    /// Everything else.
    Floats(Vec<f32>),
}

impl Array {
    /// The values as numbers.
    #[must_use]
    pub fn into_floats(self) -> Vec<f32> {
        match self.values {
            Values::Bytes(bytes) => bytes.into_iter().map(f32::from).collect(),
            Values::Floats(floats) => floats,
        }
    }

    /// The values as colours: bytes are divided by 255.
    #[must_use]
    pub fn into_colours(self) -> Vec<f32> {
        match self.values {
            Values::Bytes(bytes) => bytes.into_iter().map(|byte| f32::from(byte) / 255.0).collect(),
            Values::Floats(floats) => floats,
        }
    }

    /// Fails unless the array has one of the shapes; 0 stands for any length.
    pub(crate) fn expect_shape(&self, path: &Path, shapes: &[&[usize]]) -> Result<(), OutsideError> {
        let fits = |shape: &&[usize]| {
            shape.len() == self.shape.len()
                && shape
                    .iter()
                    .zip(&self.shape)
                    .all(|(own, found)| *own == 0 || own == found)
        };
        if shapes.iter().any(fits) {
            return Ok(());
        }
        let text = |shape: &[usize]| {
            let part = |&length: &usize| {
                if length == 0 {
                    "*".to_owned()
                } else {
                    length.to_string()
                }
            };
            format!("[{}]", shape.iter().map(part).collect::<Vec<_>>().join(", "))
        };
        let wanted: Vec<String> = shapes.iter().map(|shape| text(shape)).collect();
        let what = format!(
            "`{}` has shape {}, expected {}",
            self.name,
            text(&self.shape),
            wanted.join(" or ")
        );
        Err(OutsideError::file(path, what))
    }
}

/// A file of named arrays.
#[derive(Debug)]
pub struct ArrayFile {
    path: PathBuf,
    content: Content,
}

#[derive(Debug)]
enum Content {
    Npz(Zip),
    Safetensors(Vec<u8>),
}

impl ArrayFile {
    /// Opens a `.npz` or `.safetensors` file.
    ///
    /// # Errors
    /// When it cannot be read or is neither.
    pub fn open(path: &Path) -> Result<Self, OutsideError> {
        let content = if path.extension().is_some_and(|extension| extension == "safetensors") {
            let wrong = |error: &dyn std::fmt::Display| OutsideError::file(path, error.to_string());
            let length = std::fs::metadata(path).map_err(|error| wrong(&error))?.len();
            if length > MAX_FILE {
                return Err(wrong(&"it is larger than 16 GiB"));
            }
            let bytes = std::fs::read(path).map_err(|error| wrong(&error))?;
            SafeTensors::deserialize(&bytes).map_err(|error| wrong(&error))?;
            Content::Safetensors(bytes)
        } else {
            Content::Npz(Zip::open(path)?)
        };
        Ok(Self {
            path: path.to_owned(),
            content,
        })
    }

    /// Where it lies.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Names of the arrays, ascending.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = match &self.content {
            Content::Npz(zip) => zip
                .names()
                .filter_map(|name| name.strip_suffix(".npy"))
                .map(String::from)
                .collect(),
            Content::Safetensors(bytes) => SafeTensors::deserialize(bytes)
                .map(|file| file.names().into_iter().map(String::from).collect())
                .unwrap_or_default(),
        };
        names.sort();
        names
    }

    /// An array by the first of several names that is there.
    ///
    /// # Errors
    /// When it is damaged or of a type that is not understood.
    pub fn find(&self, names: &[&str]) -> Result<Option<Array>, OutsideError> {
        for name in names {
            if let Some(array) = self.get(name)? {
                return Ok(Some(array));
            }
        }
        Ok(None)
    }

    /// The same for an array that must be there.
    ///
    /// # Errors
    /// When it is not there, too.
    pub fn need(&self, names: &[&str]) -> Result<Array, OutsideError> {
        self.find(names)?.ok_or_else(|| {
            let what = format!(
                "it has no array `{}`; it has: {}",
                names.join("` or `"),
                self.names().join(", ")
            );
            OutsideError::file(&self.path, what)
        })
    }

    fn get(&self, name: &str) -> Result<Option<Array>, OutsideError> {
        let wrong = |what: String| OutsideError::file(&self.path, format!("array `{name}`: {what}"));
        let (shape, values) = match &self.content {
            Content::Npz(zip) => match zip.read(&format!("{name}.npy"))? {
                None => return Ok(None),
                Some(bytes) => npy(&bytes).map_err(wrong)?,
            },
            Content::Safetensors(bytes) => {
                let file = SafeTensors::deserialize(bytes).map_err(|error| wrong(error.to_string()))?;
                let Ok(tensor) = file.tensor(name) else { return Ok(None) };
                let values = numbers(kind(tensor.dtype()).map_err(wrong)?, tensor.data());
                (tensor.shape().to_vec(), values)
            }
        };
        let name = name.to_owned();
        Ok(Some(Array { name, shape, values }))
    }
}

/// Types of numbers that are understood.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    U8,
    I8,
    U16,
    I16,
    F16,
    U32,
    I32,
    F32,
    U64,
    I64,
    F64,
}

impl Kind {
    const fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }
}

fn kind(dtype: Dtype) -> Result<Kind, String> {
    Ok(match dtype {
        Dtype::BOOL | Dtype::U8 => Kind::U8,
        Dtype::I8 => Kind::I8,
        Dtype::U16 => Kind::U16,
        Dtype::I16 => Kind::I16,
        Dtype::F16 => Kind::F16,
        Dtype::U32 => Kind::U32,
        Dtype::I32 => Kind::I32,
        Dtype::F32 => Kind::F32,
        Dtype::U64 => Kind::U64,
        Dtype::I64 => Kind::I64,
        Dtype::F64 => Kind::F64,
        other => return Err(format!("type {other:?} is not understood; use 32-bit floats")),
    })
}

/// A `.npy` file: shape and values.
fn npy(bytes: &[u8]) -> Result<(Vec<usize>, Values), String> {
    let cut = || "it is cut off".to_owned();
    let version = bytes
        .get(6)
        .filter(|_| bytes.starts_with(b"\x93NUMPY"))
        .ok_or("it is no numpy array")?;
    let (length, start) = match version {
        1 => (usize::from(u16::from_le_bytes(part(bytes, 8).ok_or_else(cut)?)), 10),
        2 | 3 => (u32::from_le_bytes(part(bytes, 8).ok_or_else(cut)?) as usize, 12),
        other => return Err(format!("numpy format version {other} is not understood")),
    };
    if length > MAX_HEADER {
        return Err("its header is too long".to_owned());
    }
    let header = bytes.get(start..start + length).ok_or_else(cut)?;
    let header = String::from_utf8_lossy(header);
    let value = |key: &str| {
        let after = header.split_once(&format!("'{key}':"))?.1.trim_start();
        Some(after)
    };
    let missing = || format!("its header is not understood: `{}`", header.trim());
    if value("fortran_order").ok_or_else(missing)?.starts_with("True") {
        return Err("it is in Fortran order; save numpy.ascontiguousarray of it".to_owned());
    }
    let kind = match value("descr")
        .ok_or_else(missing)?
        .split('\'')
        .nth(1)
        .unwrap_or_default()
    {
        "|u1" | "|b1" => Kind::U8,
        "|i1" => Kind::I8,
        "<u2" => Kind::U16,
        "<i2" => Kind::I16,
        "<f2" => Kind::F16,
        "<u4" => Kind::U32,
        "<i4" => Kind::I32,
        "<f4" => Kind::F32,
        "<u8" => Kind::U64,
        "<i8" => Kind::I64,
        "<f8" => Kind::F64,
        other => return Err(format!("type `{other}` is not understood; use 32-bit floats")),
    };
    let list = value("shape").ok_or_else(missing)?;
    let list = list
        .strip_prefix('(')
        .and_then(|list| list.split_once(')'))
        .ok_or_else(missing)?
        .0;
    let lengths = list.split(',').map(str::trim).filter(|text| !text.is_empty());
    let shape: Vec<usize> = lengths
        .map(|text| text.parse().map_err(|_| missing()))
        .collect::<Result<_, String>>()?;
    if shape.len() > MAX_DIMENSIONS {
        return Err(format!("it has {} dimensions", shape.len()));
    }
    let count = shape
        .iter()
        .try_fold(1usize, |count, &length| count.checked_mul(length));
    let data = &bytes[start + length..];
    match count.and_then(|count| count.checked_mul(kind.bytes())) {
        Some(needed) if needed == data.len() => Ok((shape, numbers(kind, data))),
        _ => Err(format!("shape {shape:?} does not fit its {} bytes", data.len())),
    }
}

fn part<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at + N)?.try_into().ok()
}

/// Little-endian values; the length is a multiple of the type's.
fn numbers(kind: Kind, data: &[u8]) -> Values {
    fn each<const N: usize>(data: &[u8], value: impl Fn([u8; N]) -> f32) -> Values {
        let (parts, _) = data.as_chunks::<N>();
        Values::Floats(parts.iter().map(|part| value(*part)).collect())
    }
    match kind {
        Kind::U8 => Values::Bytes(data.to_vec()),
        Kind::I8 => each(data, |[byte]| f32::from(byte as i8)),
        Kind::U16 => each(data, |b| f32::from(u16::from_le_bytes(b))),
        Kind::I16 => each(data, |b| f32::from(i16::from_le_bytes(b))),
        Kind::F16 => each(data, |b| half::f16::from_le_bytes(b).to_f32()),
        Kind::U32 => each(data, |b| u32::from_le_bytes(b) as f32),
        Kind::I32 => each(data, |b| i32::from_le_bytes(b) as f32),
        Kind::F32 => each(data, f32::from_le_bytes),
        Kind::U64 => each(data, |b| u64::from_le_bytes(b) as f32),
        Kind::I64 => each(data, |b| i64::from_le_bytes(b) as f32),
        Kind::F64 => each(data, |b| f64::from_le_bytes(b) as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A `.npy` of version 1.
    fn npy_bytes(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn numpy_headers_are_understood() {
        let header = "{'descr': '<i2', 'fortran_order': False, 'shape': (2, 1), }   \n";
        let (shape, values) = npy(&npy_bytes(header, &[1, 0, 255, 255])).unwrap();
        assert_eq!((shape, values), (vec![2, 1], Values::Floats(vec![1.0, -1.0])));
        let scalar = "{'descr': '<f8', 'fortran_order': False, 'shape': (), }";
        let (shape, values) = npy(&npy_bytes(scalar, &2.5f64.to_le_bytes())).unwrap();
        assert_eq!((shape, values), (vec![], Values::Floats(vec![2.5])));
    }

    #[test]
    fn wrong_arrays_say_what_is_wrong() {
        let why = |header: &str, data: &[u8]| npy(&npy_bytes(header, data)).unwrap_err();
        let huge = "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 99999999999), }";
        assert!(why(huge, &[0; 8]).contains("does not fit"));
        let fortran = "{'descr': '<f4', 'fortran_order': True, 'shape': (2,), }";
        assert!(why(fortran, &[0; 8]).contains("ascontiguousarray"));
        let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (2,), }";
        assert!(why(objects, &[0; 8]).contains("`|O`"));
        assert!(npy(b"\x93NUMPY\x01\x00\xff\xff{}").unwrap_err().contains("cut off"));
        assert!(npy(b"PK").unwrap_err().contains("no numpy array"));
    }
}
