//! The network of a worker: from a weights file, or generated from a seed.

use std::path::Path;

use burn::tensor::Device;
use rogs_networks::checkpoint;
use rogs_networks::stage1::{Stage1, Stage1Config, seeded};
use rogs_schemas::records::field::WeightsInfo;
use rogs_worker::{StageError, StageResult};

use crate::params::LiftParams;
use crate::stage_error;

/// The checkpoint that comes with the program: the `compact` network in bfloat16, trained on procedural clips only. Its
/// model card is `stages/lift/weights/README.md`.
pub static COMPACT_WEIGHTS: &[u8] = include_bytes!("../weights/compact-stage1.safetensors");

/// A network and what is known about its weights.
pub struct Model {
    /// The network.
    pub network: Stage1,
    /// Where its weights come from.
    pub info: WeightsInfo,
}

/// Loads the network of a weights file, or generates weights from the seed when there is none.
///
/// # Errors
/// When the file cannot be read or is no Stage-1 checkpoint, or the configuration is not known.
pub fn load_model(params: &LiftParams, weights: Option<&Path>) -> StageResult<Model> {
    let device = Device::flex();
    let Some(path) = weights else {
        return generated(params, &device);
    };
    let loaded = checkpoint::open_stage1(path, &device).map_err(stage_error)?;
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
    Ok(Model { network, info })
}
