//! Named arrays in files: numpy's `.npz` and safetensors.

use std::path::{Path, PathBuf};

use safetensors::SafeTensors;

use crate::dtype::{Dtype, Values};
use crate::error::{Error, Result};
use crate::zip::Zip;
use crate::{npy, shape};

/// Largest safetensors file that is read, bytes.
const MAX_FILE: u64 = 1 << 34;

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
    Npz(Zip),
    Safetensors(Vec<u8>),
}

impl ArrayFile {
    /// Opens a `.npz` or `.safetensors` file.
    ///
    /// # Errors
    /// When it cannot be read or is neither.
    pub fn open(path: &Path) -> Result<Self> {
        let content = if path.extension().is_some_and(|extension| extension == "safetensors") {
            let length = std::fs::metadata(path).map_err(|error| Error::io(path, error))?.len();
            if length > MAX_FILE {
                return Err(Error::wrong(path, "it is larger than 16 GiB"));
            }
            let bytes = std::fs::read(path).map_err(|error| Error::io(path, error))?;
            SafeTensors::deserialize(&bytes).map_err(|error| Error::wrong(path, error.to_string()))?;
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
            let what = format!(
                "it has no array `{}`; it has: {}",
                names.join("` or `"),
                self.names().join(", ")
            );
            Error::wrong(&self.path, what)
        })
    }

    fn get(&self, name: &str) -> Result<Option<Array>> {
        let wrong = |what: String| Error::wrong(&self.path, format!("array `{name}`: {what}"));
        let (shape, values) = match &self.content {
            Content::Npz(zip) => match zip.read(&format!("{name}.npy"))? {
                None => return Ok(None),
                Some(bytes) => {
                    let (dtype, shape, data) = npy::parse(&bytes).map_err(wrong)?;
                    (shape, dtype.values(data))
                }
            },
            Content::Safetensors(bytes) => {
                let file = SafeTensors::deserialize(bytes).map_err(|error| wrong(error.to_string()))?;
                let Ok(tensor) = file.tensor(name) else { return Ok(None) };
                let dtype = Dtype::of_safetensors(tensor.dtype()).map_err(wrong)?;
                (tensor.shape().to_vec(), dtype.values(tensor.data()))
            }
        };
        let name = name.to_owned();
        Ok(Some(Array { name, shape, values }))
    }
}
