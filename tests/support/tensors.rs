//! Arrays of a safetensors file, for goldens.
#![allow(dead_code, reason = "every test takes what it needs")]

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

/// The arrays and the metadata of a file.
pub(crate) struct Tensors {
    arrays: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
    pub(crate) metadata: HashMap<String, String>,
}

impl Tensors {
    /// All arrays as f32.
    pub(crate) fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("`{}`: {error}", path.display()));
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let read = |(name, view): (String, TensorView<'_>)| (name, (view.shape().to_vec(), values(&view)));
        Self {
            arrays: file.tensors().into_iter().map(read).collect(),
            metadata: header.metadata().clone().unwrap_or_default(),
        }
    }

    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.arrays.keys().map(String::as_str)
    }

    pub(crate) fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    pub(crate) fn shape(&self, name: &str) -> &[usize] {
        &self.arrays[name].0
    }

    pub(crate) fn values(&self, name: &str) -> &[f32] {
        &self.arrays.get(name).unwrap_or_else(|| panic!("no tensor {name}")).1
    }
}

fn values(view: &TensorView<'_>) -> Vec<f32> {
    let (fours, eights) = (view.data().as_chunks::<4>().0, view.data().as_chunks::<8>().0);
    match view.dtype() {
        Dtype::F32 => fours.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect(),
        Dtype::I32 => fours.iter().map(|bytes| i32::from_le_bytes(*bytes) as f32).collect(),
        Dtype::I64 => eights.iter().map(|bytes| i64::from_le_bytes(*bytes) as f32).collect(),
        Dtype::U8 => view.data().iter().map(|&byte| f32::from(byte)).collect(),
        other => panic!("unexpected type {other:?}"),
    }
}
