//! The network of a worker: from a weights file, or generated from a seed.

use std::path::Path;

use burn::tensor::Device;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::robot::RobotMaps;
use rogs_stage1::{LoadedStage1, Stage1, Stage1Config, open_stage1, read_stage1, seeded};
use rogs_tensors::device;
use rogs_weights::{Bundled, TensorFile, TrainingDomain, Unfiled};
use rogs_worker::{StageError, StageResult};

use crate::bundled::{BUILTIN, BUILTIN_SCENES, BUILTIN_SIZE, sees_robot};
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

/// The networks of a worker: one, or where nothing else is named those inside the program, of which each clip has the one
/// that suits it.
pub struct Models {
    own: Model,
    /// Whether clips in which no camera sees the robot have another network.
    by_clip: bool,
    /// That network, once there was such a clip.
    scenes: Option<Model>,
}

impl Models {
    /// Loads the network of [`load_model`]; an adapter of latents, which belongs to one network, rules out others.
    ///
    /// # Errors
    /// As [`load_model`].
    pub fn load(params: &LiftParams, weights: Option<&Path>, adapted: bool) -> StageResult<Self> {
        Ok(Self {
            own: load_model(params, weights)?,
            by_clip: weights.is_none() && !adapted && params.chooses_by_clip(),
            scenes: None,
        })
    }

    /// The network that does not depend on the clip.
    pub fn own_mut(&mut self) -> &mut Model {
        &mut self.own
    }

    /// The network of a clip with these robot maps.
    ///
    /// # Errors
    /// When the device cannot be opened.
    pub fn of_clip(&mut self, params: &LiftParams, robot: &RobotMaps) -> StageResult<&Model> {
        if !self.by_clip || sees_robot(robot) {
            return Ok(&self.own);
        }
        let scenes = match self.scenes.take() {
            Some(model) => model,
            None => load_builtin(params, &BUILTIN_SCENES)?,
        };
        Ok(self.scenes.insert(scenes))
    }
}

/// Loads the network of a weights file; without one the built-in network of `params.configuration`, by default that for clips
/// of robots, or where `params.weights` asks for it one that is generated from the seed.
///
/// # Errors
/// When the file cannot be read or is not a Stage-1 checkpoint, or the configuration is not known or not the built-in one.
pub fn load_model(params: &LiftParams, weights: Option<&Path>) -> StageResult<Model> {
    let device = device::open(params.device).map_err(stage_error)?;
    let mut model = match weights {
        Some(path) => read(path, &device)?,
        None if params.weights == Some(Unfiled::Seeded) => generated(params, &device)?,
        None => builtin(named(params)?, &device)?,
    };
    model.network.precision = params.precision.into();
    Ok(model)
}

/// Loads a network that is inside the program.
///
/// # Errors
/// When the device cannot be opened.
pub fn load_builtin(params: &LiftParams, file: &'static Bundled) -> StageResult<Model> {
    let device = device::open(params.device).map_err(stage_error)?;
    let mut model = builtin(file, &device)?;
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

/// The built-in file of the configuration that is asked for.
fn named(params: &LiftParams) -> StageResult<&'static Bundled> {
    match params.configuration.as_str() {
        "compact-wide" => Ok(&BUILTIN_SCENES),
        "compact-sweep" => Ok(&BUILTIN),
        _ if params.configuration == LiftParams::default().configuration => Ok(&BUILTIN),
        asked => {
            let text = format!(
                "`configuration = \"{asked}\"`: the built-in networks are `compact-sweep`, for robots, and `compact-wide`, \
                 for scenes without any in view"
            );
            Err(StageError::bad_params(text).with_hint(
                "name a weights file under [weights]: lift = \"FILE\"; or ask for random weights: lift = \"seeded\"",
            ))
        }
    }
}

fn builtin(bundled: &'static Bundled, device: &Device) -> StageResult<Model> {
    let file = TensorFile::bundled(bundled).map_err(stage_error)?;
    let loaded = read_stage1(file, device).map_err(stage_error)?;
    Ok(model_of(
        loaded,
        &format!("built-in {}", bundled.name),
        bundled.hash().to_owned(),
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
