//! Reading the refiner's parameters from weight files: `.safetensors`, and the released PyTorch `.pth`/`.pt`/`.ckpt`.
//!
//! Only tensors that the configuration names are read, so a released file that also holds the initial network costs no
//! more memory than the refiner, and no allocation is larger than the configuration says.

use std::path::Path;

use burn::store::pytorch_reader::{DType, PytorchReader, Tensor};
use burn::tensor::Device;
use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors};

use super::RefinerConfig;
use super::weights::parameter_shapes;
use rogs_weights::Error;

use crate::Result;
use rogs_tensors::parameters::Parameters;

/// Folders that checkpoints keep their tensors in.
const FOLDERS: [&str; 3] = ["", "state_dict.", "model."];

/// Reads the parameters of a configuration that a file has, by name, widened to f32. What is missing is for
/// [`super::verify_parameters`] to judge.
///
/// # Errors
/// When the file cannot be read, or one of its tensors has another shape or a type that is no floating-point number.
pub fn read_weights(path: &Path, config: &RefinerConfig, device: &Device) -> Result<Parameters> {
    config.validate()?;
    let extension = path
        .extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default();
    match extension.to_ascii_lowercase().as_str() {
        "safetensors" => read_safetensors(path, config, device),
        "pth" | "pt" | "ckpt" => read_pytorch(path, config, device),
        other => Err(bad(
            path,
            format!("weights are read from .safetensors, .pth, .pt or .ckpt files, not `.{other}`"),
        )),
    }
}

fn read_safetensors(path: &Path, config: &RefinerConfig, device: &Device) -> Result<Parameters> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io {
        path: path.to_owned(),
        source,
    })?;
    let file = SafeTensors::deserialize(&bytes).map_err(|error| bad(path, error.to_string()))?;
    let mut parameters = Parameters::new(device);
    for (name, expected) in parameter_shapes(config) {
        let Ok(view) = file.tensor(&name) else { continue };
        check_shape(&name, view.shape(), &expected)?;
        let values = match view.dtype() {
            Dtype::F32 => widen(view.data(), f32::from_le_bytes),
            Dtype::F64 => widen(view.data(), |bytes| f64::from_le_bytes(bytes) as f32),
            Dtype::F16 => widen(view.data(), |bytes| f16::from_le_bytes(bytes).to_f32()),
            Dtype::BF16 => widen(view.data(), |bytes| bf16::from_le_bytes(bytes).to_f32()),
            other => {
                return Err(bad(
                    path,
                    format!("the tensor `{name}` has the type {other:?}, not a floating-point type"),
                ));
            }
        };
        parameters.insert(&name, &expected, values)?;
    }
    Ok(parameters)
}

fn read_pytorch(path: &Path, config: &RefinerConfig, device: &Device) -> Result<Parameters> {
    let file = PytorchReader::new(path).map_err(|error| bad(path, error.to_string()))?;
    let mut parameters = Parameters::new(device);
    for (name, expected) in parameter_shapes(config) {
        let Some(tensor) = FOLDERS.iter().find_map(|folder| file.get(&format!("{folder}{name}"))) else {
            continue;
        };
        check_shape(&name, tensor.shape(), &expected)?;
        parameters.insert(&name, &expected, pytorch_values(path, &name, tensor)?)?;
    }
    Ok(parameters)
}

fn pytorch_values(path: &Path, name: &str, tensor: &Tensor) -> Result<Vec<f32>> {
    let bytes = || {
        tensor.read().map_err(|source| Error::Io {
            path: path.to_owned(),
            source,
        })
    };
    Ok(match tensor.dtype() {
        DType::F32 => widen(&bytes()?, f32::from_ne_bytes),
        DType::F64 => widen(&bytes()?, |bytes| f64::from_ne_bytes(bytes) as f32),
        DType::F16 => widen(&bytes()?, |bytes| f16::from_ne_bytes(bytes).to_f32()),
        DType::BF16 => widen(&bytes()?, |bytes| bf16::from_ne_bytes(bytes).to_f32()),
        other => {
            return Err(bad(
                path,
                format!("the tensor `{name}` has the type {other:?}, not a floating-point type"),
            ));
        }
    })
}

fn widen<const N: usize>(bytes: &[u8], value: impl Fn([u8; N]) -> f32) -> Vec<f32> {
    let (words, _) = bytes.as_chunks::<N>();
    words.iter().map(|&word| value(word)).collect()
}

fn check_shape(name: &str, found: &[usize], expected: &[usize]) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    let (name, found, expected) = (name.to_owned(), found.to_vec(), expected.to_vec());
    Err(Error::WrongShape { name, found, expected }.into())
}

fn bad(path: &Path, reason: String) -> crate::Error {
    let path = path.to_owned();
    Error::BadFile { path, reason }.into()
}
