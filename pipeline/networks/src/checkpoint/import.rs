//! Bringing weights of others in: safetensors and PyTorch files, their names mapped to ours, every shape verified.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::store::pytorch_reader::{DType, PytorchReader, Tensor};

use super::header::ElementType;
use super::write::{TensorSource, write};
use super::{PROVENANCE, TensorFile, Verification, stage1_metadata, verify_stage1};
use crate::parameters::ParameterSource;
use crate::stage1::{Stage1Config, layout, seeded};
use crate::{Error, Result};

/// Seed of tensors that a VGGT file does not have.
const FRESH_SEED: u64 = 73;

/// A weights file of any supported format, its tensors under the names it uses.
pub fn open_any(path: &Path) -> Result<Box<dyn ParameterSource>> {
    let extension = path
        .extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase();
    match extension.as_str() {
        "safetensors" => Ok(Box::new(TensorFile::open(path)?)),
        "pth" | "pt" | "ckpt" => Ok(Box::new(PytorchFile::open(path)?)),
        other => Err(Error::BadFile {
            path: path.to_owned(),
            reason: format!("weights are read from .safetensors, .pth, .pt and .ckpt files, not from `.{other}`"),
        }),
    }
}

/// A PyTorch checkpoint; tensors are read when asked for.
struct PytorchFile {
    path: PathBuf,
    tensors: BTreeMap<String, Tensor>,
}

impl PytorchFile {
    fn open(path: &Path) -> Result<Self> {
        let bad = |error: &dyn std::fmt::Display| Error::BadFile {
            path: path.to_owned(),
            reason: error.to_string(),
        };
        if !path.is_file() {
            let source = std::io::Error::new(std::io::ErrorKind::NotFound, "there is no such file");
            return Err(Error::Io {
                path: path.to_owned(),
                source,
            });
        }
        let reader = PytorchReader::new(path).map_err(|error| bad(&error))?;
        Ok(Self {
            path: path.to_owned(),
            tensors: reader.into_tensors().into_iter().collect(),
        })
    }
}

impl ParameterSource for PytorchFile {
    fn shape(&self, name: &str) -> Option<&[usize]> {
        self.tensors.get(name).map(Tensor::shape)
    }

    fn values(&self, name: &str) -> Result<Vec<f32>> {
        let tensor = self
            .tensors
            .get(name)
            .ok_or_else(|| Error::MissingTensor { name: name.to_owned() })?;
        let element = match tensor.dtype() {
            DType::F32 => ElementType::F32,
            DType::BF16 => ElementType::BF16,
            DType::F16 => ElementType::F16,
            other => {
                let reason =
                    format!("the tensor `{name}` has numbers of type {other:?}; f32, bf16 and f16 are supported");
                return Err(Error::BadFile {
                    path: self.path.clone(),
                    reason,
                });
            }
        };
        let bytes = tensor.read().map_err(|source| Error::Io {
            path: self.path.clone(),
            source,
        })?;
        // The reader hands numbers over in this machine's byte order, which every supported machine has little-endian.
        Ok(element.widen(&bytes))
    }

    fn names(&self) -> Vec<&str> {
        self.tensors.keys().map(String::as_str).collect()
    }
}

/// What a foreign file turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// The released network: every name begins with `backbone.` (after folders such as `state_dict.`).
    Released,
    /// A VGGT checkpoint: encoder, aggregator and two heads; the rest starts fresh.
    Vggt,
}

/// Tensors of a source under our names.
pub struct Renamed {
    source: Box<dyn ParameterSource>,
    names: BTreeMap<String, String>,
    origin: Origin,
}

impl Renamed {
    /// Maps the names of a source.
    #[must_use]
    pub fn new(source: Box<dyn ParameterSource>) -> Self {
        let bare: Vec<(String, String)> = source
            .names()
            .into_iter()
            .map(|name| (strip_folders(name).to_owned(), name.to_owned()))
            .collect();
        let vggt = bare.iter().any(|(name, _)| name.starts_with("aggregator."));
        let origin = if vggt { Origin::Vggt } else { Origin::Released };
        let ours = |name: String| if vggt { from_vggt(&name) } else { name };
        let names = bare
            .into_iter()
            .map(|(name, original)| (ours(name), original))
            .collect();
        Self { source, names, origin }
    }

    /// What the file is.
    #[must_use]
    pub fn origin(&self) -> Origin {
        self.origin
    }
}

impl ParameterSource for Renamed {
    fn shape(&self, name: &str) -> Option<&[usize]> {
        self.source.shape(self.names.get(name)?)
    }

    fn values(&self, name: &str) -> Result<Vec<f32>> {
        let original = self
            .names
            .get(name)
            .ok_or_else(|| Error::MissingTensor { name: name.to_owned() })?;
        self.source.values(original)
    }

    fn names(&self) -> Vec<&str> {
        self.names.keys().map(String::as_str).collect()
    }
}

/// Removes the folders in which training programs keep their tensors.
fn strip_folders(name: &str) -> &str {
    const FOLDERS: [&str; 5] = ["state_dict.", "model.", "module.", "ema.", "_orig_mod."];
    let mut rest = name;
    while let Some(shorter) = FOLDERS.iter().find_map(|folder| rest.strip_prefix(folder)) {
        rest = shorter;
    }
    rest
}

/// Our name of a tensor of a VGGT checkpoint (`docs/spec/stage1.md` section 8).
fn from_vggt(name: &str) -> String {
    const RULES: [(&str, &str); 4] = [
        ("aggregator.patch_embed.", "backbone.encoder."),
        ("aggregator.", "backbone.backbone."),
        ("depth_head.", "backbone.depth_head."),
        ("point_head.", "backbone.motion_head."),
    ];
    let mapped = RULES
        .iter()
        .find_map(|(theirs, ours)| name.strip_prefix(theirs).map(|rest| format!("{ours}{rest}")));
    mapped.unwrap_or_else(|| name.to_owned())
}

/// What to import and how.
#[derive(Debug, Clone)]
pub struct ImportRequest {
    /// The foreign file.
    pub input: PathBuf,
    /// Where our checkpoint goes.
    pub output: PathBuf,
    /// The configuration whose tensors it must have.
    pub config: Stage1Config,
    /// How numbers are stored in our checkpoint.
    pub element: ElementType,
    /// For people: where the file comes from. The file's name is noted as well.
    pub provenance: String,
    /// Leave out tensors that the configuration does not know (a VGGT file has heads of no use here), instead of failing.
    pub drop_unexpected: bool,
}

/// What an import did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImportReport {
    /// What the file is.
    pub origin: Origin,
    /// How its tensors compare with those of the configuration.
    pub verification: Verification,
    /// Tensors that the file does not have and that start from a seed (VGGT only).
    pub fresh: Vec<String>,
    /// Tensors written.
    pub written: usize,
}

/// Imports a Stage-1 network and writes our checkpoint.
///
/// # Errors
/// When the file cannot be read, or its tensors are not those of the configuration; nothing is written then.
pub fn import_stage1(request: &ImportRequest) -> Result<ImportReport> {
    let ImportRequest {
        input,
        output,
        config,
        element,
        provenance,
        drop_unexpected,
    } = request;
    config.validate()?;
    let source = Renamed::new(open_any(input)?);
    let verification = verify_stage1(&source, config);
    let mut judged = verification.clone();
    if *drop_unexpected {
        judged.unexpected.clear();
    }
    let mut fresh = Vec::new();
    if source.origin() == Origin::Vggt {
        let may_be_fresh = |name: &String| {
            let own = [
                "plucker_embed.",
                "plucker_ln.",
                "backbone.extra_embed.",
                "backbone.time_embed.",
                "splat_head.",
                "motion_splat_head.",
                "motion_head.time_embed.",
            ];
            own.iter().any(|part| {
                name.strip_prefix("backbone.")
                    .is_some_and(|rest| rest.starts_with(part))
            })
        };
        (fresh, judged.missing) = judged.missing.into_iter().partition(may_be_fresh);
    }
    judged.into_result(input)?;
    let source = &source;
    let expected = layout::released(config).into_iter().chain(extras(source, config));
    let tensors: Vec<TensorSource<'_>> = expected
        .map(|spec| {
            let (name, shape) = (spec.name.clone(), spec.shape.clone());
            let values = move || {
                if source.shape(&spec.name).is_some() {
                    source.values(&spec.name)
                } else {
                    Ok(seeded::values(&spec, config, FRESH_SEED))
                }
            };
            TensorSource {
                name,
                shape,
                values: Box::new(values),
            }
        })
        .collect();
    let written = tensors.len();
    let file = input.file_name().unwrap_or_default().to_string_lossy();
    let metadata = stage1_metadata(config, fresh.is_empty(), &format!("imported from {file}; {provenance}"));
    write(output, &metadata, *element, tensors)?;
    Ok(ImportReport {
        origin: source.origin(),
        verification,
        fresh,
        written,
    })
}

/// Optional tensors that a source has.
fn extras(source: &dyn ParameterSource, config: &Stage1Config) -> Vec<layout::ParameterSpec> {
    let mut specs = Vec::new();
    if source.shape("fk_branch.conv1.weight").is_some() {
        specs.extend(layout::fk_branch(config));
    }
    if let Some(rank) = layout::lora_rank(source) {
        specs.extend(layout::lora(config, rank));
    }
    specs
}

/// Writes generated weights of a configuration under the names of the released network, for tests and as a starting point.
/// `fk_branch` adds the FK-conditioning branch.
///
/// # Errors
/// When the configuration is not possible or writing fails.
pub fn generate_stage1(
    path: &Path,
    config: &Stage1Config,
    seed: u64,
    element: ElementType,
    fk_branch: bool,
) -> Result<()> {
    config.validate()?;
    let mut specs = layout::released(config);
    if fk_branch {
        specs.extend(layout::fk_branch(config));
    }
    let tensor = |spec: layout::ParameterSpec| {
        let (name, shape) = (spec.name.clone(), spec.shape.clone());
        TensorSource {
            name,
            shape,
            values: Box::new(move || Ok(seeded::values(&spec, config, seed))),
        }
    };
    let metadata = stage1_metadata(config, false, &format!("generated from seed {seed}"));
    write(path, &metadata, element, specs.into_iter().map(tensor).collect())
}

/// Folds the low-rank updates of a checkpoint into its weights and writes the result.
///
/// # Errors
/// When the file is no Stage-1 checkpoint, has no updates, or writing fails.
pub fn merge_lora(input: &Path, output: &Path, element: ElementType) -> Result<()> {
    let file = TensorFile::open(input)?;
    let loaded = super::open_stage1(input, &burn::tensor::Device::flex())?;
    let bad = |reason: &str| Error::BadFile {
        path: input.to_owned(),
        reason: reason.to_owned(),
    };
    let rank = layout::lora_rank(&file).ok_or_else(|| bad("it has no low-rank updates to merge"))?;
    let file = &file;
    let kept = file.names().into_iter().filter(|name| !name.contains(".lora_"));
    let tensors = kept.map(|name| {
        let shape = file.shape(name).unwrap_or_default().to_vec();
        let own = name.to_owned();
        let values = move || folded(file, &own, rank);
        TensorSource {
            name: name.to_owned(),
            shape,
            values: Box::new(values),
        }
    });
    // Whatever else the file says of itself stays true, as that it has seen procedural clips only.
    let mut metadata = file.metadata().clone();
    let provenance = format!("{}; low-rank updates merged", loaded.provenance);
    metadata.insert(PROVENANCE.to_owned(), provenance);
    write(output, &metadata, element, tensors.collect())
}

/// W + scale B A in f64 sums, for a weight that has an update; W otherwise.
fn folded(file: &TensorFile, name: &str, rank: usize) -> Result<Vec<f32>> {
    let mut weight = file.values(name)?;
    let Some(layer) = name.strip_suffix(".weight") else {
        return Ok(weight);
    };
    let (a, b) = (format!("{layer}.lora_A.weight"), format!("{layer}.lora_B.weight"));
    if file.shape(&a).is_none() {
        return Ok(weight);
    }
    let (a, b) = (file.values(&a)?, file.values(&b)?);
    let inputs = a.len() / rank.max(1);
    for (row, b) in weight.chunks_exact_mut(inputs).zip(b.chunks_exact(rank)) {
        for (column, value) in row.iter_mut().enumerate() {
            let sum: f64 = b
                .iter()
                .enumerate()
                .map(|(k, &b)| f64::from(b) * f64::from(a[k * inputs + column]))
                .sum();
            *value = (f64::from(*value) + crate::ops::LORA_SCALE * sum) as f32;
        }
    }
    Ok(weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_others_become_ours() {
        assert_eq!(strip_folders("state_dict.module.backbone.norm"), "backbone.norm");
        let pairs = [
            (
                "aggregator.patch_embed.blocks.3.norm1.weight",
                "backbone.encoder.blocks.3.norm1.weight",
            ),
            (
                "aggregator.frame_blocks.0.attn.qkv.bias",
                "backbone.backbone.frame_blocks.0.attn.qkv.bias",
            ),
            ("point_head.norm.weight", "backbone.motion_head.norm.weight"),
            ("camera_head.trunk.0.weight", "camera_head.trunk.0.weight"),
        ];
        for (theirs, ours) in pairs {
            assert_eq!(from_vggt(theirs), ours);
        }
    }
}
