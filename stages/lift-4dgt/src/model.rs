//! The network of a worker: from weights files, or generated from a seed where that is asked for.

use std::path::Path;

use rogs_4dgt::{FourDgt, FourDgtConfig, Loaded, open_encoder, open_network, seeded_encoder, seeded_network};
use rogs_schemas::records::field::WeightsInfo;
use rogs_tensors::{Error, device};
use rogs_vit::EncoderSizes;
use rogs_worker::{StageError, StageResult};

use crate::params::{Configuration, Lift4dgtParams, OnlySeeded};

/// A network and what is known about its weights.
pub struct Model {
    /// The network.
    pub network: FourDgt,
    /// Where the weights of the network and of its image encoder come from.
    pub weights: Vec<WeightsInfo>,
}

/// Loads network and image encoder.
///
/// # Errors
/// When a file cannot be read or is another one, there is none and random values are not asked for, or the two do not fit
/// together.
pub fn load_model(params: &Lift4dgtParams, weights: Option<&Path>, encoder: Option<&Path>) -> StageResult<Model> {
    let device = device::open(params.device).map_err(stage_error)?;
    let (config, sizes) = sizes(params.configuration);
    let (network, of_network) = one(
        ("4DGT", "4dgt"),
        weights,
        params.weights,
        |path| open_network(path, &device),
        || seeded_network(config, params.seed, &device),
    )?;
    let (encoder, of_encoder) = one(
        ("DINOv2", "dinov2"),
        encoder,
        params.encoder,
        |path| open_encoder(path, &device),
        || seeded_encoder(sizes, params.seed, &device),
    )?;
    let network = FourDgt::new(network.sizes, network.parameters, encoder.sizes, encoder.parameters);
    Ok(Model {
        network: network.map_err(stage_error)?,
        weights: vec![of_network, of_encoder],
    })
}

/// One of the two: its name in words and in `[weights]`, its file, or what is asked for without one.
fn one<S>(
    (words, key): (&str, &str),
    file: Option<&Path>,
    asked: Option<OnlySeeded>,
    open: impl FnOnce(&Path) -> rogs_4dgt::Result<Loaded<S>>,
    seeded: impl FnOnce() -> Loaded<S>,
) -> StageResult<(Loaded<S>, WeightsInfo)> {
    let (loaded, name, hash) = match (file, asked) {
        (Some(path), _) => {
            let loaded = open(path).map_err(stage_error)?;
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            (loaded, format!("{name}: "), hash_of(path)?)
        }
        (None, Some(OnlySeeded)) => (seeded(), String::new(), String::new()),
        (None, None) => {
            return Err(StageError::bad_params(format!("{words} has no weights in this program")).with_hint(format!(
                "name its file under [weights]: {key} = \"FILE\" (docs/baselines.md); or ask for random ones: {key} = \"seeded\""
            )));
        }
    };
    let info = WeightsInfo {
        trained: loaded.trained,
        configuration: words.to_owned(),
        description: format!("{name}{}", loaded.provenance),
        hash,
    };
    Ok((loaded, info))
}

/// Sizes of seeded networks.
fn sizes(configuration: Configuration) -> (FourDgtConfig, EncoderSizes) {
    let full = EncoderSizes::vit_b(0);
    match configuration {
        Configuration::Full => (FourDgtConfig::full(), full),
        Configuration::Compact => (
            FourDgtConfig {
                name: "compact".into(),
                width: 192,
                blocks: 2,
                heads: 4,
                head_hidden: 16,
                encoder_width: 96,
            },
            EncoderSizes {
                width: 96,
                heads: 4,
                blocks: 2,
                ..full
            },
        ),
    }
}

fn hash_of(path: &Path) -> StageResult<String> {
    let io = |error: std::io::Error| StageError::io(format!("{}: {error}", path.display()));
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(rogs_files::open(path).map_err(io)?).map_err(io)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// A network error as a failure of the stage.
pub(crate) fn stage_error(error: Error) -> StageError {
    match error {
        Error::Weights(rogs_weights::Error::Io { .. }) => StageError::io(error.to_string()),
        Error::BadConfiguration(_) | Error::Device(_) => StageError::bad_params(error.to_string()),
        _ => StageError::bad_input(error.to_string()),
    }
}
