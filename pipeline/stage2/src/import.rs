//! Reading the refiner's parameters from weights files, ours and the released ones.
//!
//! Only tensors that the configuration names are read, so a released file that also holds the initial network costs no
//! more memory than the refiner, and no allocation is larger than the configuration says.

use std::path::Path;

use burn::tensor::Device;
use rogs_tensors::parameters::Parameters;
use rogs_weights::{Error, ParameterSource, open_any};

use super::RefinerConfig;
use super::weights::parameter_shapes;
use crate::Result;

/// Folders that checkpoints keep their tensors in.
const FOLDERS: [&str; 3] = ["", "state_dict.", "model."];

/// Reads the parameters of a configuration that a file has, by name, widened to f32. What is missing is for
/// [`super::verify_parameters`] to judge.
///
/// # Errors
/// When the file cannot be read, or one of its tensors has another shape or a type that is not a floating-point one.
pub fn read_weights(path: &Path, config: &RefinerConfig, device: &Device) -> Result<Parameters> {
    config.validate()?;
    read_parameters(&*open_any(path)?, config, device)
}

/// The same from an open source.
///
/// # Errors
/// As for [`read_weights`].
pub fn read_parameters(file: &dyn ParameterSource, config: &RefinerConfig, device: &Device) -> Result<Parameters> {
    config.validate()?;
    let mut parameters = Parameters::new(device);
    for (name, expected) in parameter_shapes(config) {
        let names = FOLDERS.map(|folder| format!("{folder}{name}"));
        let Some((own, found)) = names.iter().find_map(|own| Some((own, file.shape(own)?))) else {
            continue;
        };
        if found != expected {
            return Err(Error::WrongShape {
                name,
                found: found.to_vec(),
                expected,
            }
            .into());
        }
        parameters.insert(&name, &expected, file.values(own)?)?;
    }
    Ok(parameters)
}
