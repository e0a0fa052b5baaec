//! Stage-1 checkpoints: opening, verifying, what they say of themselves.

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;
use rogs_tensors::device::is_cpu;
use rogs_tensors::parameters::{Parameters, resident};
use rogs_weights::{
    CONFIGURATION, KIND, PROVENANCE, ParameterSource, TRAINED, TensorFile, TrainingDomain, Verification, verify,
};

use crate::{Result, Stage1, Stage1Config, layout};

/// Kind of a Stage-1 checkpoint.
pub const STAGE1: &str = "stage1";
/// Networks of at most this many parameters are held in memory; larger ones are read from the mapped file as they run. A
/// GPU holds any in its own memory, so that a clip costs no uploads of weights.
const RESIDENT_PARAMETERS: usize = 64 << 20;

/// Metadata of a Stage-1 checkpoint.
#[must_use]
pub fn stage1_metadata(config: &Stage1Config, trained: bool, provenance: &str) -> BTreeMap<String, String> {
    let configuration = serde_json::to_string(config).unwrap_or_default();
    let pairs = [
        (KIND, STAGE1),
        (CONFIGURATION, &configuration),
        (TRAINED, if trained { "true" } else { "false" }),
        (PROVENANCE, provenance),
    ];
    pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).into()
}

/// A Stage-1 network from one of our checkpoints.
pub struct LoadedStage1 {
    /// The network.
    pub network: Stage1,
    /// Whether the file says its weights are trained.
    pub trained: bool,
    /// What the file says about its origin.
    pub provenance: String,
    /// The narrow kind of clips that the weights were trained on, where the file names one.
    pub domain: Option<TrainingDomain>,
}

/// Opens a Stage-1 checkpoint and checks every name and shape against its configuration.
///
/// # Errors
/// When the file cannot be read, is not a Stage-1 checkpoint, or its tensors are not those of its configuration.
pub fn open_stage1(path: &Path, device: &Device) -> Result<LoadedStage1> {
    read_stage1(TensorFile::open(path)?, device)
}

/// The same from an open file.
///
/// # Errors
/// As for [`open_stage1`].
pub fn read_stage1(file: TensorFile, device: &Device) -> Result<LoadedStage1> {
    let path = file.path().to_owned();
    let bad = |reason: String| rogs_weights::Error::BadFile {
        path: path.clone(),
        reason,
    };
    let metadata = file.metadata();
    let kind = metadata.get(KIND).ok_or_else(|| {
        bad("this is not a checkpoint of this program (no `rogs.kind` in its metadata); bring it in with `rogs weights import`".into())
    })?;
    if kind != STAGE1 {
        return Err(bad(format!("it holds the weights of `{kind}`, not of the Stage-1 network")).into());
    }
    let configuration = metadata
        .get(CONFIGURATION)
        .ok_or_else(|| bad("its metadata has no `rogs.configuration`".into()))?;
    let config: Stage1Config = serde_json::from_str(configuration)
        .map_err(|error| bad(format!("its configuration cannot be understood: {error}")))?;
    config.validate()?;
    let report = verify_stage1(&file, &config);
    report.into_result(&path)?;
    let domain = TrainingDomain::of(metadata);
    let (trained, provenance) = (
        metadata.get(TRAINED).is_some_and(|value| value == "true"),
        metadata.get(PROVENANCE).cloned().unwrap_or_default(),
    );
    let parameters = if file.len() <= RESIDENT_PARAMETERS || !is_cpu(device) {
        resident(&file, device)?
    } else {
        Parameters::streaming(Box::new(file), device)
    };
    Ok(LoadedStage1 {
        network: Stage1::new(config, parameters)?,
        trained,
        provenance,
        domain,
    })
}

/// Compares the tensors of a source with those a Stage-1 configuration has: all released ones are needed; the FK branch,
/// the gate of what is held and low-rank updates may be there (whole).
#[must_use]
pub fn verify_stage1(source: &dyn ParameterSource, config: &Stage1Config) -> Verification {
    let needed = layout::released(config);
    let mut optional = Vec::new();
    if source.shape("fk_branch.conv1.weight").is_some() {
        optional.extend(layout::fk_branch(config));
    }
    if source.shape("held.conv1.weight").is_some() {
        optional.extend(layout::held());
    }
    if let Some(rank) = layout::lora_rank(source) {
        optional.extend(layout::lora(config, rank));
    }
    let expected: BTreeMap<String, Vec<usize>> = needed
        .into_iter()
        .chain(optional)
        .map(|spec| (spec.name, spec.shape))
        .collect();
    verify(source, &expected)
}
