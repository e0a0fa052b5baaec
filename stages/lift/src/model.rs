//! The network of a worker: from a weights file, or generated from a seed.

use std::path::Path;

use burn::tensor::Device;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::WeightsInfo;
use rogs_stage1::open_stage1;
use rogs_stage1::{Stage1, Stage1Config, seeded};
use rogs_tensors::device;
use rogs_worker::{StageError, StageResult};

use crate::params::LiftParams;
use crate::stage_error;

/// The bundled checkpoint: the `compact-sweep` network in bfloat16, trained on procedural clips only. Its
/// model card is `stages/lift/weights/README.md`.
pub static COMPACT_WEIGHTS: &[u8] = include_bytes!("../weights/compact-stage1.safetensors");

/// A network and what is known about its weights.
pub struct Model {
    /// The network.
    pub network: Stage1,
    /// Where its weights come from.
    pub info: WeightsInfo,
    /// Whether the weights have seen nothing but procedural clips.
    pub procedural_only: bool,
}

impl Model {
    /// What a person should know when this clip is not of the kind that the weights were trained on.
    #[must_use]
    pub fn out_of_distribution(&self, clip: &Clip) -> Option<String> {
        (self.procedural_only && !clip.is_procedural()).then(|| {
            format!(
                "OUT OF DISTRIBUTION: these weights have seen procedural clips only ({}), and `{}` is none; look at the \
                 renders, and take no number for what the method can do",
                self.info.description, clip.clip_id
            )
        })
    }
}

/// Loads the network of a weights file, or generates weights from the seed when there is none.
///
/// # Errors
/// When the file cannot be read or is not a Stage-1 checkpoint, or the configuration is not known.
pub fn load_model(params: &LiftParams, weights: Option<&Path>) -> StageResult<Model> {
    let device = device::open(params.device).map_err(stage_error)?;
    let mut model = match weights {
        Some(path) => read(path, &device)?,
        None => generated(params, &device)?,
    };
    model.network.precision = params.precision.into();
    Ok(model)
}

fn read(path: &Path, device: &Device) -> StageResult<Model> {
    let loaded = open_stage1(path, device).map_err(stage_error)?;
    let mut hasher = blake3::Hasher::new();
    let io = |error: std::io::Error| StageError::io(format!("{}: {error}", path.display()));
    hasher
        .update_reader(std::fs::File::open(path).map_err(io)?)
        .map_err(io)?;
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let info = WeightsInfo {
        trained: loaded.trained,
        configuration: loaded.network.config.name.clone(),
        description: format!("{file}: {}", loaded.provenance),
        hash: hasher.finalize().to_hex().to_string(),
    };
    Ok(Model {
        network: loaded.network,
        info,
        procedural_only: loaded.procedural_only,
    })
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
        procedural_only: false,
    })
}
