//! PyTorch checkpoints, by the reader of burn.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use pytorch_reader::{DType, PytorchReader, Tensor};

use crate::{ElementType, Error, ParameterSource, Result, StoredType};

/// A PyTorch checkpoint; tensors are read when asked for.
pub(crate) struct PytorchFile {
    path: PathBuf,
    tensors: BTreeMap<String, Tensor>,
}

impl PytorchFile {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let bad = |error: &dyn std::fmt::Display| Error::BadFile {
            path: path.to_owned(),
            reason: error.to_string(),
        };
        if !path.is_file() {
            let source = std::io::Error::new(std::io::ErrorKind::NotFound, "there is no such file");
            return Err(Error::Io {
                path: path.to_owned(),
                source,
            });
        }
        let reader = PytorchReader::new(path).map_err(|error| bad(&error))?;
        Ok(Self {
            path: path.to_owned(),
            tensors: reader.into_tensors().into_iter().collect(),
        })
    }
}

impl ParameterSource for PytorchFile {
    fn shape(&self, name: &str) -> Option<&[usize]> {
        self.tensors.get(name).map(Tensor::shape)
    }

    fn values(&self, name: &str) -> Result<Vec<f32>> {
        let tensor = self
            .tensors
            .get(name)
            .ok_or_else(|| Error::MissingTensor { name: name.to_owned() })?;
        let stored = match tensor.dtype() {
            DType::F32 => StoredType::Written(ElementType::F32),
            DType::BF16 => StoredType::Written(ElementType::BF16),
            DType::F16 => StoredType::Written(ElementType::F16),
            DType::F64 => StoredType::F64,
            other => StoredType::Other(format!("{other:?}")),
        };
        let bytes = tensor.read().map_err(|source| Error::Io {
            path: self.path.clone(),
            source,
        })?;
        // The reader hands numbers over in this machine's byte order, which every supported machine has little-endian.
        stored.to_f32(&bytes).map_err(|reason| Error::BadFile {
            path: self.path.clone(),
            reason: format!("the tensor `{name}` {reason}"),
        })
    }

    fn names(&self) -> Vec<&str> {
        self.tensors.keys().map(String::as_str).collect()
    }
}
