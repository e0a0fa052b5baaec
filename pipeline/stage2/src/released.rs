//! The released ReSplat models: every tensor of the initial network and of the refiner by name and shape, and the import
//! of such a file (`docs/spec/stage2.md` sections A.7 and A.9).

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_weights::{
    ElementType, KIND, PROVENANCE, ParameterSource, Renamed, TRAINED, TensorSource, Verification, open_any, verify,
    write,
};

use crate::{Error, Result};

/// Metadata value of a Stage-2 file.
pub const STAGE2: &str = "stage2";
/// Metadata key: which released model a Stage-2 file was imported from.
pub const RELEASED: &str = "rogs.released";

/// Name, shape in the DL3DV models, shape in the RE10K model, separated by tabs.
const TENSORS: &str = include_str!("released.tsv");

/// A layout of the released models with the base backbone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReleasedModel {
    /// Base, DL3DV: one Gaussian per 4x4 pixels.
    Dl3dv,
    /// Base, RealEstate10K: one Gaussian per pixel, the layout that the paper's refiner has.
    Re10k,
}

impl ReleasedModel {
    /// Names for [`Self::by_name`].
    pub const NAMES: [&'static str; 2] = ["resplat-dl3dv", "resplat-re10k"];

    /// A layout by its name.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn by_name(name: &str) -> Result<Self> {
        match name {
            "resplat-dl3dv" => Ok(Self::Dl3dv),
            "resplat-re10k" => Ok(Self::Re10k),
            _ => Err(Error::BadConfiguration(format!(
                "there is no released Stage-2 model `{name}`; there are {}",
                Self::NAMES.join(", ")
            ))),
        }
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Dl3dv => Self::NAMES[0],
            Self::Re10k => Self::NAMES[1],
        }
    }

    /// Name and shape of every tensor: initial network and refiner. The counters of normalisations
    /// (`num_batches_tracked`), which a file may have, are not parameters.
    #[must_use]
    pub fn tensors(self) -> BTreeMap<String, Vec<usize>> {
        let column = match self {
            Self::Dl3dv => 1,
            Self::Re10k => 2,
        };
        let lines = TENSORS.lines().filter(|line| !line.starts_with('#'));
        let entry = |line: &str| {
            let fields: Vec<&str> = line.split('\t').collect();
            let shape = fields
                .get(column)?
                .split(',')
                .map(str::parse)
                .collect::<std::result::Result<_, _>>();
            Some(((*fields.first()?).to_owned(), shape.ok()?))
        };
        lines.filter_map(entry).collect()
    }
}

/// Compares the tensors of a source with those of a released model.
#[must_use]
pub fn verify_released(source: &dyn ParameterSource, model: ReleasedModel) -> Verification {
    let mut report = verify(source, &model.tensors());
    report.unexpected.retain(|name| !name.ends_with(".num_batches_tracked"));
    report
}

/// What to import and how.
#[derive(Debug, Clone)]
pub struct ReleasedImport {
    /// The released file (`.pth`, `.pt`, `.ckpt`, `.safetensors`).
    pub input: PathBuf,
    /// Where our file goes.
    pub output: PathBuf,
    /// The layout that it must have.
    pub model: ReleasedModel,
    /// How numbers are stored in our file.
    pub element: ElementType,
    /// For people: where the file comes from. The file's name is noted as well.
    pub provenance: String,
    /// Leave out tensors that the layout does not know, instead of failing.
    pub drop_unexpected: bool,
}

/// Imports a released model whole: names as they are there (prefix `encoder.`), every shape checked. Returns the number of
/// tensors written. The refine stage reads its tensors from the file; what the adaptation adds (`update_obs_proj`,
/// `update_gate`) is not in it.
///
/// # Errors
/// When the file cannot be read or its tensors are not those of the layout; nothing is written then.
pub fn import_released(request: &ReleasedImport) -> Result<usize> {
    let source = Renamed::without_folders(open_any(&request.input)?);
    let mut report = verify_released(&source, request.model);
    if request.drop_unexpected {
        report.unexpected.clear();
    }
    report.into_result(&request.input)?;
    let source = &source;
    let tensors: Vec<TensorSource<'_>> = request
        .model
        .tensors()
        .into_iter()
        .map(|(name, shape)| {
            let own = name.clone();
            TensorSource {
                name,
                shape,
                values: Box::new(move || source.values(&own)),
            }
        })
        .collect();
    let written = tensors.len();
    let file = request.input.file_name().unwrap_or_default().to_string_lossy();
    let metadata = [
        (KIND, STAGE2.to_owned()),
        (RELEASED, request.model.name().to_owned()),
        (TRAINED, "true".to_owned()),
        (PROVENANCE, format!("imported from {file}; {}", request.provenance)),
    ];
    let metadata = metadata.map(|(key, value)| (key.to_owned(), value)).into();
    write(&request.output, &metadata, request.element, tensors)?;
    Ok(written)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{RefinerConfig, parameter_shapes, weights::OWN_PARAMETERS};

    #[test]
    fn the_table_holds_the_released_models_whole() {
        for model in [ReleasedModel::Dl3dv, ReleasedModel::Re10k] {
            let tensors = model.tensors();
            assert_eq!(tensors.len(), 701 + 131, "{model:?}");
            assert_eq!(ReleasedModel::by_name(model.name()).unwrap(), model);
        }
        // The refiner of the RE10K model is the paper preset, without what the adaptation adds.
        let (released, paper) = (
            ReleasedModel::Re10k.tensors(),
            parameter_shapes(&RefinerConfig::preset("paper").unwrap()),
        );
        for (name, shape) in paper
            .iter()
            .filter(|(name, _)| !OWN_PARAMETERS.contains(&name.as_str()))
        {
            assert_eq!(released.get(name), Some(shape), "{name}");
        }
        assert!(
            ReleasedModel::by_name("movies")
                .unwrap_err()
                .to_string()
                .contains("resplat-re10k")
        );
    }
}
