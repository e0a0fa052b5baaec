//! The network behind a run: from a weights file, or seeded.

use std::path::Path;

use rogs_schemas::records::field::WeightsInfo;
use rogs_stage2::{
    Device, Refiner, RefinerConfig, read_parameters, read_weights, seeded_parameters, verify_parameters,
};
use rogs_tensors::device;
use rogs_weights::{TensorFile, Unfiled};
use rogs_worker::{StageError, StageResult};

use crate::RefineParams;
use crate::bundled::BUILTIN;

/// A network and where it comes from.
pub struct LoadedRefiner {
    /// The network.
    pub refiner: Refiner,
    /// What to write into outputs.
    pub info: WeightsInfo,
    /// What a person must know about the weights.
    pub warnings: Vec<String>,
}

/// The preset of the bundled refiner.
const BUILTIN_PRESET: &str = "ci";

/// Loads a weights file; without one the built-in refiner, or where `params.weights` asks for it a seeded one.
///
/// # Errors
/// When the file cannot be read or does not fit the preset, or the preset is not that of the built-in refiner.
pub fn load_refiner(params: &RefineParams, weights: Option<&Path>) -> StageResult<LoadedRefiner> {
    let (config, _) = params.resolve()?;
    let device = device::open(params.device).map_err(|error| StageError::bad_params(error.to_string()))?;
    match weights {
        Some(path) => from_file(params, &config, path, &device),
        None if params.weights == Some(Unfiled::Seeded) => seeded(params, &config, &device),
        None => builtin(&config, &device),
    }
}

fn builtin(config: &RefinerConfig, device: &Device) -> StageResult<LoadedRefiner> {
    if config.name != BUILTIN_PRESET {
        let text = format!(
            "`preset = \"{}\"`: the built-in refiner is `{BUILTIN_PRESET}`",
            config.name
        );
        return Err(StageError::bad_params(text).with_hint(
            "name a weights file under [weights]: refine = \"FILE\"; or ask for random weights: refine = \"seeded\"",
        ));
    }
    let damaged = |error: rogs_tensors::Error| StageError::internal(format!("the built-in refiner: {error}"));
    let file = TensorFile::bundled(&BUILTIN).map_err(|error| damaged(error.into()))?;
    let parameters = read_parameters(&file, config, device).map_err(damaged)?;
    let refiner = Refiner::load(&parameters, config).map_err(damaged)?;
    let info = WeightsInfo {
        trained: true,
        configuration: config.name.clone(),
        description: format!("built-in {}", BUILTIN.name),
        hash: BUILTIN.hash().to_owned(),
    };
    Ok(LoadedRefiner {
        refiner,
        info,
        warnings: Vec::new(),
    })
}

fn seeded(params: &RefineParams, config: &RefinerConfig, device: &Device) -> StageResult<LoadedRefiner> {
    let parameters =
        seeded_parameters(config, params.seed, device).map_err(|error| StageError::bad_params(error.to_string()))?;
    let refiner = Refiner::load(&parameters, config).map_err(|error| StageError::internal(error.to_string()))?;
    let info = WeightsInfo {
        trained: false,
        configuration: config.name.clone(),
        description: format!("UNTRAINED: seeded weights, seed {}, last layer zero", params.seed),
        hash: String::new(),
    };
    let warning = "the Stage-2 network is UNTRAINED (seeded weights, asked for by `refine = \"seeded\"`): its last layer is zero, so the correction is \
                   exactly zero and the refined field equals the Stage-1 field";
    Ok(LoadedRefiner {
        refiner,
        info,
        warnings: vec![warning.to_owned()],
    })
}

fn from_file(
    params: &RefineParams,
    config: &RefinerConfig,
    path: &Path,
    device: &Device,
) -> StageResult<LoadedRefiner> {
    let shown = path.display();
    let wrong = |error: rogs_tensors::Error| {
        StageError::bad_input(format!("weights `{shown}`: {error}")).with_hint(format!(
            "the file must hold the Stage-2 tensors of the preset `{}`",
            config.name
        ))
    };
    let mut parameters = read_weights(path, config, device).map_err(wrong)?;
    let filled = verify_parameters(&mut parameters, config, params.seed).map_err(wrong)?;
    let refiner = Refiner::load(&parameters, config).map_err(wrong)?;
    let hash = rogs_r4c::source::hash_file(path)?.to_string();
    let name = path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default();
    let trained = filled.is_empty();
    let mut warnings = Vec::new();
    let mut description = name;
    if !trained {
        let names = filled.join(", ");
        warnings.push(format!(
            "the weights file lacks {names}: they are UNTRAINED (seeded), so the refinement as a whole is untrained"
        ));
        description = format!(
            "{description}, UNTRAINED in part: seeded {names} (seed {})",
            params.seed
        );
    }
    let info = WeightsInfo {
        trained,
        configuration: config.name.clone(),
        description,
        hash,
    };
    Ok(LoadedRefiner {
        refiner,
        info,
        warnings,
    })
}
