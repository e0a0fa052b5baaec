//! Weights files: our own checkpoints, and the import of others.
//!
//! A checkpoint is a safetensors file whose metadata says what network it holds (`rogs.kind`, `rogs.configuration`),
//! whether it was trained (`rogs.trained`) and where it comes from (`rogs.provenance`). It is mapped into memory, so that
//! opening one costs nothing and a network can be run without holding all of it.

mod average;
mod file;
mod header;
mod import;
mod write;

pub use average::average;
pub use file::TensorFile;
pub use header::{ElementType, TensorEntry};
pub use import::{ImportReport, ImportRequest, Origin, Renamed, generate_stage1, import_stage1, merge_lora, open_any};
pub use write::{TensorSource, write};

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;

use crate::parameters::{ParameterSource, Parameters};
use crate::stage1::{Stage1, Stage1Config, layout};
use crate::{Error, Result};

/// Metadata key: which network, `stage1` or another.
pub const KIND: &str = "rogs.kind";
/// Metadata key: configuration as JSON.
pub const CONFIGURATION: &str = "rogs.configuration";
/// Metadata key: `true` for trained weights, `false` for generated ones.
pub const TRAINED: &str = "rogs.trained";
/// Metadata key: for people, where the weights come from.
pub const PROVENANCE: &str = "rogs.provenance";
/// Kind of a Stage-1 checkpoint.
pub const STAGE1: &str = "stage1";
/// Networks of at most this many parameters are held in memory; larger ones are read from the mapped file as they run. A
/// graphics processor holds any in its own memory, so that a clip costs no uploads of weights.
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

/// Metadata key: the kind of clips that the weights were trained on, where that is a narrow one.
pub const TRAINING_DOMAIN: &str = "rogs.training_domain";
/// Value of [`TRAINING_DOMAIN`] for weights that have seen nothing but clips of the procedural generator.
pub const PROCEDURAL: &str = "procedural";

/// A Stage-1 network from one of our checkpoints.
pub struct LoadedStage1 {
    /// The network.
    pub network: Stage1,
    /// Whether the file says its weights are trained.
    pub trained: bool,
    /// What the file says about its origin.
    pub provenance: String,
    /// Whether the weights have seen nothing but procedural clips.
    pub procedural_only: bool,
}

/// Opens a Stage-1 checkpoint and checks every name and shape against its configuration.
///
/// # Errors
/// When the file cannot be read, is no Stage-1 checkpoint, or its tensors are not those of its configuration.
pub fn open_stage1(path: &Path, device: &Device) -> Result<LoadedStage1> {
    let file = TensorFile::open(path)?;
    let bad = |reason: String| Error::BadFile {
        path: path.to_owned(),
        reason,
    };
    let metadata = file.metadata();
    let kind = metadata.get(KIND).ok_or_else(|| {
        bad("this is not a checkpoint of this program (no `rogs.kind` in its metadata); bring it in with `rogs weights import`".into())
    })?;
    if kind != STAGE1 {
        return Err(bad(format!(
            "it holds the weights of `{kind}`, not of the Stage-1 network"
        )));
    }
    let configuration = metadata
        .get(CONFIGURATION)
        .ok_or_else(|| bad("its metadata has no `rogs.configuration`".into()))?;
    let config: Stage1Config = serde_json::from_str(configuration)
        .map_err(|error| bad(format!("its configuration cannot be understood: {error}")))?;
    config.validate()?;
    let report = verify_stage1(&file, &config);
    report.into_result(path)?;
    let procedural_only = metadata.get(TRAINING_DOMAIN).is_some_and(|value| value == PROCEDURAL);
    let (trained, provenance) = (
        metadata.get(TRAINED).is_some_and(|value| value == "true"),
        metadata.get(PROVENANCE).cloned().unwrap_or_default(),
    );
    let parameters = if file.len() <= RESIDENT_PARAMETERS || !crate::device::is_cpu(device) {
        resident(&file, device)?
    } else {
        Parameters::streaming(Box::new(file), device)
    };
    Ok(LoadedStage1 {
        network: Stage1::new(config, parameters)?,
        trained,
        provenance,
        procedural_only,
    })
}

/// All parameters of a file in memory.
///
/// # Errors
/// When a tensor cannot be read.
pub fn resident(file: &TensorFile, device: &Device) -> Result<Parameters> {
    let mut parameters = Parameters::new(device);
    for name in file.names() {
        let shape = file.shape(name).map(<[usize]>::to_vec).unwrap_or_default();
        parameters.insert(name, &shape, file.values(name)?)?;
    }
    Ok(parameters)
}

/// How the tensors of a file differ from those of a configuration.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Verification {
    /// Tensors that are as they should be.
    pub matching: usize,
    /// Needed, but not in the file.
    pub missing: Vec<String>,
    /// In the file, but not known to the configuration.
    pub unexpected: Vec<String>,
    /// Name, shape in the file, shape needed.
    pub misshapen: Vec<(String, Vec<usize>, Vec<usize>)>,
}

impl Verification {
    /// True when nothing is missing, unexpected or misshapen.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.missing.is_empty() && self.unexpected.is_empty() && self.misshapen.is_empty()
    }

    /// The differences in words, one line each, at most `limit` of a sort.
    #[must_use]
    pub fn lines(&self, limit: usize) -> Vec<String> {
        let mut lines = Vec::new();
        let mut list = |what: &str, names: Vec<String>| {
            lines.extend(names.iter().take(limit).map(|name| format!("{what}: {name}")));
            if names.len() > limit {
                lines.push(format!("{what}: and {} more", names.len() - limit));
            }
        };
        list("missing", self.missing.clone());
        list("unexpected", self.unexpected.clone());
        let wrong = |(name, found, expected): &(String, Vec<usize>, Vec<usize>)| {
            format!("{name} is {found:?}, needed is {expected:?}")
        };
        list("wrong shape", self.misshapen.iter().map(wrong).collect());
        lines
    }

    /// An error that lists the differences, if there are any.
    ///
    /// # Errors
    /// When the verification is not clean.
    pub fn into_result(self, path: &Path) -> Result<()> {
        if self.is_clean() {
            return Ok(());
        }
        let reason = format!(
            "its tensors are not those of the configuration\n  {}",
            self.lines(8).join("\n  ")
        );
        Err(Error::BadFile {
            path: path.to_owned(),
            reason,
        })
    }
}

/// Compares the tensors of a source with those a Stage-1 configuration has: all released ones are needed; the FK branch
/// and low-rank updates may be there (whole).
#[must_use]
pub fn verify_stage1(source: &dyn ParameterSource, config: &Stage1Config) -> Verification {
    let needed = layout::released(config);
    let mut optional = Vec::new();
    if source.shape("fk_branch.conv1.weight").is_some() {
        optional.extend(layout::fk_branch(config));
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

/// Compares the tensors of a source with expected names and shapes.
#[must_use]
pub fn verify(source: &dyn ParameterSource, expected: &BTreeMap<String, Vec<usize>>) -> Verification {
    let mut result = Verification::default();
    for (name, shape) in expected {
        match source.shape(name) {
            None => result.missing.push(name.clone()),
            Some(found) if found == shape.as_slice() => result.matching += 1,
            Some(found) => result.misshapen.push((name.clone(), found.to_vec(), shape.clone())),
        }
    }
    result.unexpected = source
        .names()
        .into_iter()
        .filter(|name| !expected.contains_key(*name))
        .map(str::to_owned)
        .collect();
    result
}
