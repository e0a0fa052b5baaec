//! Named arrays in files: numpy's `.npz`, safetensors, and `.npy`, whose one array has a name of ours.

use std::path::{Path, PathBuf};

use std::collections::BTreeMap;
use std::ops::Range;

use safetensors::SafeTensors;

use crate::dtype::{Dtype, Values};
use crate::error::{Error, Result};
use crate::zip::Zip;
use crate::{npy, shape};

/// Largest safetensors file that is read, bytes.
const MAX_FILE: u64 = 1 << 34;

/// What the array of a `.npy` file is called.
const ONLY: &str = "array";

/// Names of a file that a message lists, at most.
const MOST_NAMES: usize = 40;

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

    /// Fails unless the array has one of the shapes; [`ANY`](crate::ANY) stands for any length. `path` is the file that
    /// it was read from.
    ///
    /// # Errors
    /// When it has another shape.
    pub fn expect_shape(&self, path: &Path, shapes: &[&[usize]]) -> Result<()> {
        shape::mismatch(&self.shape, shapes).map_or(Ok(()), |what| {
            Err(Error::wrong(path, format!("array `{}`: {what}", self.name)))
        })
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
    Npy(Vec<u8>),
    Npz(Zip),
    Safetensors {
        bytes: Vec<u8>,
        /// What the header says, gone through once however many arrays there are.
        tensors: BTreeMap<String, Tensor>,
    },
}

/// Where an array lies in a safetensors file.
#[derive(Debug)]
struct Tensor {
    dtype: safetensors::Dtype,
    shape: Vec<usize>,
    data: Range<usize>,
}

/// The arrays of a safetensors file.
fn tensors(bytes: &[u8]) -> std::result::Result<BTreeMap<String, Tensor>, safetensors::SafeTensorError> {
    let (header, metadata) = SafeTensors::read_metadata(bytes)?;
    // The length of the header stands before it, in eight bytes.
    let begin = header + 8;
    let tensors = metadata.tensors().into_iter().map(|(name, info)| {
        let (from, to) = info.data_offsets;
        let tensor = Tensor {
            dtype: info.dtype,
            shape: info.shape.clone(),
            data: begin + from..begin + to,
        };
        (name, tensor)
    });
    Ok(tensors.collect())
}

impl ArrayFile {
    /// Opens a `.npz`, `.npy` or `.safetensors` file.
    ///
    /// # Errors
    /// When it cannot be read or is none of these.
    pub fn open(path: &Path) -> Result<Self> {
        let ends = |ending: &str| {
            path.extension()
                .is_some_and(|extension| extension.eq_ignore_ascii_case(ending))
        };
        let whole = || {
            let length = std::fs::metadata(path).map_err(|error| Error::io(path, error))?.len();
            if length > MAX_FILE {
                return Err(Error::wrong(path, "it is larger than 16 GiB"));
            }
            rogs_files::read(path).map_err(|error| Error::io(path, error))
        };
        let content = if ends("npy") {
            Content::Npy(whole()?)
        } else if ends("safetensors") {
            let bytes = whole()?;
            // The whole file is checked: what the header says covers it, without a gap.
            SafeTensors::deserialize(&bytes).map_err(|error| Error::wrong(path, error.to_string()))?;
            let tensors = tensors(&bytes).map_err(|error| Error::wrong(path, error.to_string()))?;
            Content::Safetensors { bytes, tensors }
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
        match &self.content {
            Content::Npy(_) => vec![ONLY.to_owned()],
            Content::Npz(zip) => {
                let names = zip.names().filter_map(|name| name.strip_suffix(".npy"));
                let mut names: Vec<String> = names.map(String::from).collect();
                names.sort();
                names
            }
            Content::Safetensors { tensors, .. } => tensors.keys().cloned().collect(),
        }
    }

    /// An array by the first of several names that is there.
    ///
    /// # Errors
    /// When it is damaged or of a type that is not understood.
    pub fn find(&self, names: &[&str]) -> Result<Option<Array>> {
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
    pub fn need(&self, names: &[&str]) -> Result<Array> {
        self.find(names)?.ok_or_else(|| {
            let own = self.names();
            let more = if own.len() > MOST_NAMES { ", ..." } else { "" };
            let some: Vec<&str> = own.iter().take(MOST_NAMES).map(String::as_str).collect();
            let what = format!(
                "it has no array `{}`; it has: {}{more}",
                names.join("` or `"),
                some.join(", ")
            );
            Error::wrong(&self.path, what)
        })
    }

    fn get(&self, name: &str) -> Result<Option<Array>> {
        let wrong = |what: String| Error::wrong(&self.path, format!("array `{name}`: {what}"));
        let (shape, values) = match &self.content {
            Content::Npy(_) if name != ONLY => return Ok(None),
            Content::Npy(bytes) => {
                let (dtype, shape, data) = npy::parse(bytes).map_err(|what| Error::wrong(&self.path, what))?;
                (shape, dtype.values(&data))
            }
            Content::Npz(zip) => match zip.read(&format!("{name}.npy"))? {
                None => return Ok(None),
                Some(bytes) => {
                    let (dtype, shape, data) = npy::parse(&bytes).map_err(wrong)?;
                    (shape, dtype.values(&data))
                }
            },
            Content::Safetensors { bytes, tensors } => {
                let Some(tensor) = tensors.get(name) else {
                    return Ok(None);
                };
                let dtype = Dtype::of_safetensors(tensor.dtype).map_err(wrong)?;
                let data = bytes.get(tensor.data.clone());
                let data = data.ok_or_else(|| wrong("it lies beyond the end of the file".to_owned()))?;
                (tensor.shape.clone(), dtype.values(data))
            }
        };
        let name = name.to_owned();
        Ok(Some(Array { name, shape, values }))
    }
}
