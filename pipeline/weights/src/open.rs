//! Weights files by their extension.

use std::path::Path;

use crate::{Error, ParameterSource, Result, TensorFile};

/// Extensions of weights files, lower case.
pub const EXTENSIONS: [&str; 4] = ["safetensors", "pth", "pt", "ckpt"];

/// Whether the extension of a file is that of a weights file.
#[must_use]
pub fn is_weights_file(path: &Path) -> bool {
    EXTENSIONS.contains(&extension(path).as_str())
}

/// A weights file of any supported format, its tensors under the names it uses.
///
/// # Errors
/// When the file cannot be read, or its extension is not one of [`EXTENSIONS`].
pub fn open_any(path: &Path) -> Result<Box<dyn ParameterSource>> {
    match extension(path).as_str() {
        "safetensors" => Ok(Box::new(TensorFile::open(path)?)),
        "pth" | "pt" | "ckpt" => open_pytorch(path),
        other => Err(Error::BadFile {
            path: path.to_owned(),
            reason: format!("weights are read from .safetensors, .pth, .pt and .ckpt files, not from `.{other}`"),
        }),
    }
}

#[cfg(feature = "pytorch")]
fn open_pytorch(path: &Path) -> Result<Box<dyn ParameterSource>> {
    Ok(Box::new(crate::pytorch::PytorchFile::open(path)?))
}

#[cfg(not(feature = "pytorch"))]
fn open_pytorch(path: &Path) -> Result<Box<dyn ParameterSource>> {
    Err(Error::BadFile {
        path: path.to_owned(),
        reason: "this program was built without the reader of PyTorch files; use `rogs`, or a .safetensors file".into(),
    })
}

fn extension(path: &Path) -> String {
    path.extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase()
}
