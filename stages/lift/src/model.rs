//! The network of a worker: from a weights file, or generated from a seed.

use std::path::Path;

use burn::tensor::Device;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::WeightsInfo;
use rogs_stage1::{LoadedStage1, Stage1, Stage1Config, open_stage1, read_stage1, seeded};
use rogs_tensors::device;
use rogs_weights::{TensorFile, TrainingDomain, Unfiled};
use rogs_worker::{StageError, StageResult};

use crate::bundled::{BUILTIN, BUILTIN_SIZE};
use crate::params::LiftParams;
use crate::stage_error;

/// A network and what is known about its weights.
pub struct Model {
    /// The network.
    pub network: Stage1,
    /// Where its weights come from.
    pub info: WeightsInfo,
    /// The narrow kind of clips that the weights were trained on, where they name one.
    pub domain: Option<TrainingDomain>,
    /// Height and width of the images that the weights are for, pixels, where that is known.
    pub made_for: Option<[u32; 2]>,
}

impl Model {
    /// What a person should know when the images of this clip are not of the size that the weights are for.
    #[must_use]
    pub fn other_size(&self, clip: &Clip) -> Option<String> {
        let [height, width] = self.made_for.filter(|size| *size != [clip.height, clip.width])?;
        Some(format!(
            "the built-in weights were trained on images of {width}x{height} pixels, and this clip has {}x{}: expect a worse \
             field; `height = {height}` and `width = {width}` under [ingest] give their size",
            clip.width, clip.height
        ))
    }

    /// What a person should know when this clip is not of the kind that the weights were trained on.
    #[must_use]
    pub fn out_of_distribution(&self, clip: &Clip) -> Option<String> {
        let domain = self.domain.filter(|_| !clip.is_procedural())?;
        Some(format!(
            "OUT OF DISTRIBUTION: these weights have seen {domain} only ({}), and `{}` is none; look at the renders, and take \
             no number for what the method can do",
            self.info.description, clip.clip_id
        ))
    }
}

/// Loads the network of a weights file; without one the built-in network, or where `params.weights` asks for it one that is
/// generated from the seed.
///
/// # Errors
/// When the file cannot be read or is not a Stage-1 checkpoint, or the configuration is not known or not the built-in one.
pub fn load_model(params: &LiftParams, weights: Option<&Path>) -> StageResult<Model> {
    let device = device::open(params.device).map_err(stage_error)?;
    let mut model = match weights {
        Some(path) => read(path, &device)?,
        None if params.weights == Some(Unfiled::Seeded) => generated(params, &device)?,
        None => builtin(params, &device)?,
    };
    model.network.precision = params.precision.into();
    Ok(model)
}

fn read(path: &Path, device: &Device) -> StageResult<Model> {
    let loaded = open_stage1(path, device).map_err(stage_error)?;
    let mut hasher = blake3::Hasher::new();
    let io = |error: std::io::Error| StageError::io(format!("{}: {error}", path.display()));
    hasher.update_reader(rogs_files::open(path).map_err(io)?).map_err(io)?;
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    Ok(model_of(loaded, &file, hasher.finalize().to_hex().to_string()))
}

fn builtin(params: &LiftParams, device: &Device) -> StageResult<Model> {
    let file = TensorFile::bundled(&BUILTIN).map_err(stage_error)?;
    let loaded = read_stage1(file, device).map_err(stage_error)?;
    let own = &loaded.network.config.name;
    let asked = &params.configuration;
    if *asked != LiftParams::default().configuration && asked != own {
        let text = format!("`configuration = \"{asked}\"`: the built-in network is `{own}`");
        return Err(StageError::bad_params(text).with_hint(
            "name a weights file under [weights]: lift = \"FILE\"; or ask for random weights: lift = \"seeded\"",
        ));
    }
    Ok(model_of(
        loaded,
        &format!("built-in {}", BUILTIN.name),
        BUILTIN.hash().to_owned(),
    ))
}

/// A model of a checkpoint that goes by a name.
fn model_of(loaded: LoadedStage1, name: &str, hash: String) -> Model {
    let made_for = (hash == BUILTIN.hash()).then_some(BUILTIN_SIZE);
    let info = WeightsInfo {
        trained: loaded.trained,
        configuration: loaded.network.config.name.clone(),
        description: format!("{name}: {}", loaded.provenance),
        hash,
    };
    Model {
        network: loaded.network,
        info,
        domain: loaded.domain,
        made_for,
    }
}

fn generated(params: &LiftParams, device: &Device) -> StageResult<Model> {
    let config = Stage1Config::by_name(&params.configuration).map_err(stage_error)?;
    let network = seeded::network(&config, params.seed, device).map_err(stage_error)?;
    let info = WeightsInfo {
        trained: false,
        configuration: config.name,
        description: format!("generated from seed {}", params.seed),
        hash: String::new(),
    };
    Ok(Model {
        network,
        info,
        domain: None,
        made_for: None,
    })
}
