//! Writing checkpoints tensor by tensor, so that a file may be larger than memory.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

use serde_json::{Value, json};

use super::header::ElementType;
use crate::{Error, Result};

/// A tensor to be written: its name, shape, and values on demand.
pub struct TensorSource<'a> {
    /// Name.
    pub name: String,
    /// Shape.
    pub shape: Vec<usize>,
    /// Values, row-major; called once.
    pub values: Box<dyn FnOnce() -> Result<Vec<f32>> + 'a>,
}

/// Writes a safetensors file, whole or not at all.
///
/// # Errors
/// When writing fails or a tensor cannot be had or has other values than its shape says.
pub fn write(
    path: &Path,
    metadata: &BTreeMap<String, String>,
    element: ElementType,
    mut tensors: Vec<TensorSource<'_>>,
) -> Result<()> {
    let io = |source| Error::Io {
        path: path.to_owned(),
        source,
    };
    tensors.sort_by(|a, b| a.name.cmp(&b.name));
    let header = header(metadata, element, &tensors);
    rogs_files::try_write_with(path, |out| {
        out.write_all(&(header.len() as u64).to_le_bytes())
            .and_then(|()| out.write_all(&header))
            .map_err(io)?;
        for TensorSource { name, shape, values } in tensors {
            let values = values()?;
            if values.len() != shape.iter().product::<usize>() {
                return Err(Error::WrongShape {
                    name,
                    found: vec![values.len()],
                    expected: shape,
                });
            }
            out.write_all(&element.narrow(&values)).map_err(io)?;
        }
        Ok(())
    })
}

/// The header: metadata, then tensors in the order of their data, padded with spaces to a multiple of 8.
fn header(metadata: &BTreeMap<String, String>, element: ElementType, tensors: &[TensorSource<'_>]) -> Vec<u8> {
    let mut entries = serde_json::Map::new();
    entries.insert("__metadata__".into(), json!(metadata));
    let mut start = 0;
    for tensor in tensors {
        let end = start + tensor.shape.iter().product::<usize>() * element.bytes();
        let entry = json!({ "dtype": element.name(), "shape": tensor.shape, "data_offsets": [start, end] });
        entries.insert(tensor.name.clone(), entry);
        start = end;
    }
    let mut header = Value::Object(entries).to_string().into_bytes();
    header.resize(header.len().next_multiple_of(8), b' ');
    header
}
