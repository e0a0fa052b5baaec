//! Bringing weights of others in: safetensors and PyTorch files, their names mapped to ours, every shape verified.

use std::path::{Path, PathBuf};

use rogs_weights::{
    ElementType, Error, PROVENANCE, ParameterSource, Renamed, TensorFile, TensorSource, Verification, open_any, write,
};

use crate::checkpoint::{open_stage1, stage1_metadata, verify_stage1};
use crate::{Result, Stage1Config, layout, seeded};

/// Seed of tensors that a VGGT file does not have.
const FRESH_SEED: u64 = 73;

/// What a foreign file turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// The released network: every name begins with `backbone.` (after folders such as `state_dict.`).
    Released,
    /// A VGGT checkpoint: encoder, aggregator and two heads; the rest starts fresh.
    Vggt,
}

/// The tensors of a foreign file under our names, and what the file is.
#[must_use]
pub fn ours(source: Box<dyn ParameterSource>) -> (Renamed, Origin) {
    let bare = Renamed::without_folders(source);
    if bare.names().iter().any(|name| name.starts_with("aggregator.")) {
        (Renamed::new(Box::new(bare), from_vggt), Origin::Vggt)
    } else {
        (bare, Origin::Released)
    }
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
    /// Where the checkpoint goes.
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
    let (source, origin) = ours(open_any(input)?);
    let verification = verify_stage1(&source, config);
    let mut judged = verification.clone();
    if *drop_unexpected {
        judged.unexpected.clear();
    }
    let mut fresh = Vec::new();
    if origin == Origin::Vggt {
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
        origin,
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
    Ok(write(
        path,
        &metadata,
        element,
        specs.into_iter().map(tensor).collect(),
    )?)
}

/// Folds the low-rank updates of a checkpoint into its weights and writes the result.
///
/// # Errors
/// When the file is not a Stage-1 checkpoint, has no updates, or writing fails.
pub fn merge_lora(input: &Path, output: &Path, element: ElementType) -> Result<()> {
    let file = TensorFile::open(input)?;
    let loaded = open_stage1(input, &burn::tensor::Device::flex())?;
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
    Ok(write(output, &metadata, element, tensors.collect())?)
}

/// W + scale B A in f64 sums, for a weight that has an update; W otherwise.
fn folded(file: &TensorFile, name: &str, rank: usize) -> rogs_weights::Result<Vec<f32>> {
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
            *value = (f64::from(*value) + rogs_tensors::ops::LORA_SCALE * sum) as f32;
        }
    }
    Ok(weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_others_become_ours() {
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
