//! Bringing the released files in: names mapped to ours, every shape verified, one tensor in memory at a time.

use std::path::Path;

use rogs_vit::EncoderSizes;
use rogs_weights::{ElementType, ParameterSource, ParameterSpec, Renamed, TensorSource, Verification, open_any, write};
use serde::Serialize;

use crate::checkpoint::{ENCODER, FOUR_DGT, compare, metadata};
use crate::config::FourDgtConfig;
use crate::{Result, layout};

/// Folder of the weights in a training checkpoint; the state of the optimiser lies in others.
const MODEL: &str = "model.";
/// What stands before a name in the released file.
const PREFIXES: [&str; 3] = ["module.", "_orig_mod.", "image_coder."];
/// Tensors of the released files that no inference reads: indices of a pattern that the first stage does not have, and what
/// masks patches in training.
const UNREAD: [&str; 2] = ["random_pattern", "mask_token"];

/// What to import, and into what.
#[derive(Debug, Clone)]
pub struct ImportRequest<'a> {
    /// The released file.
    pub input: &'a Path,
    /// Where the checkpoint goes.
    pub output: &'a Path,
    /// How numbers are stored in it.
    pub element: ElementType,
    /// For people: where the file comes from. Its name is noted as well.
    pub provenance: &'a str,
    /// Leave out tensors that are not known, instead of failing.
    pub drop_unexpected: bool,
}

/// The tensors of a released file under our names. Where it is a training checkpoint, only those of its folder `model`.
#[must_use]
pub fn ours(source: Box<dyn ParameterSource>) -> Renamed {
    let is_training = source.names().iter().any(|name| name.starts_with(MODEL));
    Renamed::chosen(source, |name| {
        let mut rest = if is_training { name.strip_prefix(MODEL)? } else { name };
        while let Some(shorter) = PREFIXES.iter().find_map(|prefix| rest.strip_prefix(prefix)) {
            rest = shorter;
        }
        (!UNREAD.contains(&rest)).then(|| rest.to_owned())
    })
}

/// Imports the released first-stage file of 4DGT; returns the number of tensors written.
///
/// # Errors
/// When the file cannot be read or its tensors are not those of the configuration (nothing is written then), or writing
/// fails.
pub fn import_network(request: &ImportRequest<'_>, config: &FourDgtConfig) -> Result<usize> {
    config.validate()?;
    let source = ours(open_any(request.input)?);
    import(request, &source, FOUR_DGT, config, layout::network(config))
}

/// Imports a released file of DINOv2 ViT-B/14; whether it has registers, its tensors say.
///
/// # Errors
/// As [`import_network`].
pub fn import_encoder(request: &ImportRequest<'_>) -> Result<usize> {
    let source = ours(open_any(request.input)?);
    let sizes = encoder_sizes(&source);
    import(request, &source, ENCODER, &sizes, layout::encoder(&sizes))
}

/// Sizes of the ViT-B/14 in a released file.
#[must_use]
pub fn encoder_sizes(source: &dyn ParameterSource) -> EncoderSizes {
    let registers = source.shape("register_tokens").and_then(|shape| shape.get(1).copied());
    EncoderSizes::vit_b(registers.unwrap_or(0))
}

fn import<S: Serialize>(
    request: &ImportRequest<'_>,
    source: &dyn ParameterSource,
    kind: &str,
    sizes: &S,
    list: Vec<ParameterSpec>,
) -> Result<usize> {
    let mut verification: Verification = compare(source, &list);
    if request.drop_unexpected {
        verification.unexpected.clear();
    }
    verification.into_result(request.input)?;
    let tensors: Vec<TensorSource<'_>> = list
        .into_iter()
        .map(|spec| TensorSource {
            name: spec.name.clone(),
            shape: spec.shape,
            values: Box::new(move || source.values(&spec.name)),
        })
        .collect();
    let written = tensors.len();
    let file = request.input.file_name().unwrap_or_default().to_string_lossy();
    let provenance = format!("imported from {file}; {}", request.provenance);
    write(
        request.output,
        &metadata(kind, sizes, &provenance),
        request.element,
        tensors,
    )?;
    Ok(written)
}
