//! Our checkpoints of the network and of its image encoder, and seeded ones.

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;
use rogs_tensors::device::is_cpu;
use rogs_tensors::parameters::{Parameters, resident};
use rogs_vit::EncoderSizes;
use rogs_weights::{
    CONFIGURATION, KIND, PROVENANCE, ParameterSource, ParameterSpec, Seeded, TRAINED, TensorFile, Verification, verify,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::config::FourDgtConfig;
use crate::{Result, layout};

/// Kind of a checkpoint of the network.
pub const FOUR_DGT: &str = "4dgt";
/// Kind of a checkpoint of its image encoder.
pub const ENCODER: &str = "dinov2";
/// Networks of at most this many parameters are held in memory; larger ones are read from the mapped file as they run. A
/// GPU holds any in its own memory.
const RESIDENT_PARAMETERS: usize = 64 << 20;

/// Sizes and parameters, and what is known of them.
pub struct Loaded<S> {
    /// Sizes.
    pub sizes: S,
    /// Parameters.
    pub parameters: Parameters,
    /// Whether they are trained.
    pub trained: bool,
    /// Where they come from, for people.
    pub provenance: String,
}

/// Opens a checkpoint of the network and checks every name and shape.
///
/// # Errors
/// When the file cannot be read, is another one, or its tensors are not those of its configuration.
pub fn open_network(path: &Path, device: &Device) -> Result<Loaded<FourDgtConfig>> {
    let sizes_of = |sizes: &FourDgtConfig| -> Result<_> {
        sizes.validate()?;
        Ok(layout::network(sizes))
    };
    open(path, device, FOUR_DGT, sizes_of)
}

/// Opens a checkpoint of the image encoder and checks every name and shape.
///
/// # Errors
/// As [`open_network`].
pub fn open_encoder(path: &Path, device: &Device) -> Result<Loaded<EncoderSizes>> {
    let sizes_of = |sizes: &EncoderSizes| -> Result<_> {
        sizes.validate()?;
        Ok(layout::encoder(sizes))
    };
    open(path, device, ENCODER, sizes_of)
}

/// The network with seeded values, drawn tensor by tensor as it runs.
#[must_use]
pub fn seeded_network(config: FourDgtConfig, seed: u64, device: &Device) -> Loaded<FourDgtConfig> {
    let list = layout::network(&config);
    seeded(config, list, seed, device)
}

/// The image encoder with seeded values.
#[must_use]
pub fn seeded_encoder(sizes: EncoderSizes, seed: u64, device: &Device) -> Loaded<EncoderSizes> {
    seeded(sizes, layout::encoder(&sizes), seed, device)
}

fn seeded<S>(sizes: S, list: Vec<ParameterSpec>, seed: u64, device: &Device) -> Loaded<S> {
    Loaded {
        sizes,
        parameters: Parameters::streaming(Box::new(Seeded::new(list, seed)), device),
        trained: false,
        provenance: format!("generated from seed {seed}"),
    }
}

/// Metadata of a checkpoint.
pub(crate) fn metadata<S: Serialize>(kind: &str, sizes: &S, provenance: &str) -> BTreeMap<String, String> {
    let configuration = serde_json::to_string(sizes).unwrap_or_default();
    let pairs = [
        (KIND, kind),
        (CONFIGURATION, &configuration),
        (TRAINED, "true"),
        (PROVENANCE, provenance),
    ];
    pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).into()
}

/// Compares the tensors of a source with those of a list.
#[must_use]
pub fn compare(source: &dyn ParameterSource, list: &[ParameterSpec]) -> Verification {
    let expected = list.iter().map(|spec| (spec.name.clone(), spec.shape.clone()));
    verify(source, &expected.collect())
}

fn open<S: DeserializeOwned>(
    path: &Path,
    device: &Device,
    kind: &str,
    list: impl Fn(&S) -> Result<Vec<ParameterSpec>>,
) -> Result<Loaded<S>> {
    let file = TensorFile::open(path)?;
    let bad = |reason: String| rogs_weights::Error::BadFile {
        path: path.to_owned(),
        reason,
    };
    let metadata = file.metadata();
    let is = metadata.get(KIND).map(String::as_str);
    if is != Some(kind) {
        let found = is.map_or("a file of somebody else".to_owned(), |is| {
            format!("a checkpoint of `{is}`")
        });
        return Err(bad(format!(
            "this is {found}, not a checkpoint of `{kind}`; bring a released file in with \
             `rogs weights import FILE --configuration {kind} --out {kind}.safetensors`"
        ))
        .into());
    }
    let configuration = metadata
        .get(CONFIGURATION)
        .ok_or_else(|| bad("its metadata has no `rogs.configuration`".into()))?;
    let sizes: S = serde_json::from_str(configuration)
        .map_err(|error| bad(format!("its configuration cannot be understood: {error}")))?;
    compare(&file, &list(&sizes)?).into_result(path)?;
    let (trained, provenance) = (
        metadata.get(TRAINED).is_some_and(|value| value == "true"),
        metadata.get(PROVENANCE).cloned().unwrap_or_default(),
    );
    let parameters = if file.len() <= RESIDENT_PARAMETERS || !is_cpu(device) {
        resident(&file, device)?
    } else {
        Parameters::streaming(Box::new(file), device)
    };
    Ok(Loaded {
        sizes,
        parameters,
        trained,
        provenance,
    })
}
