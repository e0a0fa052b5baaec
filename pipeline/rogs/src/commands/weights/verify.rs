//! `rogs weights verify`: whether a file holds the weights it should, whole and finite.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use rogs_4dgt::checkpoint::compare;
use rogs_4dgt::import::encoder_sizes;
use rogs_4dgt::{ENCODER, FOUR_DGT, FourDgtConfig, layout};
use rogs_lpips::LpipsWeights;
use rogs_stage1::Stage1Config;
use rogs_stage1::import::ours;
use rogs_stage1::{Origin, STAGE1, verify_stage1};
use rogs_stage2::{RefinerConfig, ReleasedModel, parameter_shapes, verify_released};
use rogs_weights::ParameterSource;
use rogs_weights::{CONFIGURATION, KIND, TensorFile, Verification, open_any};

use super::download::{Expected, hash};
use super::told::{Checked, Misshapen};
use crate::output;

/// Names listed of each sort of difference.
const LISTED: usize = 12;

/// What a file is compared with.
#[derive(Debug)]
enum Network {
    Stage1(Box<Stage1Config>),
    Released(ReleasedModel),
    Refiner(RefinerConfig),
    /// The baseline 4DGT.
    FourDgt(FourDgtConfig),
    /// Its image encoder.
    Encoder,
}

impl Network {
    fn describe(&self) -> String {
        match self {
            Self::Stage1(config) => format!("Stage 1, configuration `{}`", config.name),
            Self::Released(model) => format!("a released ReSplat model, `{}`", model.name()),
            Self::Refiner(config) => format!("Stage 2, preset `{}`", config.name),
            Self::FourDgt(config) => format!("4DGT, first stage, configuration `{}`", config.name),
            Self::Encoder => "DINOv2 ViT-B/14, the image encoder of 4DGT".to_owned(),
        }
    }

    fn by_name(name: &str) -> anyhow::Result<Self> {
        if let Ok(model) = ReleasedModel::by_name(name) {
            return Ok(Self::Released(model));
        }
        match name {
            FOUR_DGT => return Ok(Self::FourDgt(FourDgtConfig::full())),
            ENCODER => return Ok(Self::Encoder),
            _ => {}
        }
        if let Ok(config) = RefinerConfig::preset(name) {
            return Ok(Self::Refiner(config));
        }
        Stage1Config::by_name(name)
            .map(|config| Self::Stage1(Box::new(config)))
            .with_context(|| {
                let presets = RefinerConfig::PRESETS.join(", ");
                format!("Stage 2 has {presets} and {}", ReleasedModel::NAMES.join(", "))
            })
    }

    /// What a file says it is, or what its names say.
    fn of(source: &dyn ParameterSource, metadata: &BTreeMap<String, String>) -> anyhow::Result<Option<Self>> {
        if metadata.get(KIND).is_some_and(|kind| kind == STAGE1) {
            let text = metadata.get(CONFIGURATION).map_or("", String::as_str);
            let config =
                serde_json::from_str(text).context("the configuration in its metadata cannot be understood")?;
            return Ok(Some(Self::Stage1(Box::new(config))));
        }
        if source.shape("linear_heads.ms3.0.weight").is_some() {
            let own = metadata
                .get(CONFIGURATION)
                .and_then(|text| serde_json::from_str(text).ok());
            return Ok(Some(Self::FourDgt(own.unwrap_or_else(FourDgtConfig::full))));
        }
        if source.shape("pos_embed").is_some() && source.shape("blocks.0.ls1.gamma").is_some() {
            return Ok(Some(Self::Encoder));
        }
        let width = |name: &str| source.shape(name).and_then(|shape| shape.first().copied());
        if source.shape("backbone.encoder.patch_embed.proj.weight").is_some() {
            return Self::by_name("full").map(Some);
        }
        if source.shape("encoder.gaussian_regressor.0.weight").is_some() {
            let inputs = source
                .shape("encoder.update_rgb_error_proj.0.weight")
                .and_then(|shape| shape.get(1).copied());
            let model = if inputs == Some(48) {
                ReleasedModel::Dl3dv
            } else {
                ReleasedModel::Re10k
            };
            return Ok(Some(Self::Released(model)));
        }
        let Some(state) = width("encoder.update_head.0.weight") else {
            return Ok(None);
        };
        let presets = RefinerConfig::PRESETS
            .iter()
            .filter_map(|name| RefinerConfig::preset(name).ok());
        Ok(presets
            .into_iter()
            .find(|preset| preset.state == state)
            .map(Self::Refiner))
    }

    fn verify(&self, source: &dyn ParameterSource) -> Verification {
        match self {
            Self::Stage1(config) => verify_stage1(source, config),
            Self::Released(model) => verify_released(source, *model),
            Self::FourDgt(config) => compare(source, &layout::network(config)),
            Self::Encoder => compare(source, &layout::encoder(&encoder_sizes(source))),
            Self::Refiner(config) => {
                let mut report = rogs_weights::verify(source, &parameter_shapes(config));
                report.unexpected.retain(|name| !name.ends_with(".num_batches_tracked"));
                report
            }
        }
    }
}

/// Runs the command.
pub(super) fn run(
    file: &Path,
    configuration: Option<&str>,
    sha256: Option<&str>,
    json: bool,
) -> anyhow::Result<ExitCode> {
    let opening = || format!("reading `{}`", file.display());
    let found = hash(file)?;
    let hash_is_right = match sha256 {
        Some(digits) => Some(matches_digits(digits, &found)?),
        None => None,
    };
    let is_safetensors = file
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("safetensors"));
    let metadata = if is_safetensors {
        TensorFile::open(file).with_context(opening)?.metadata().clone()
    } else {
        BTreeMap::new()
    };
    let (mut source, origin) = ours(open_any(file).with_context(opening)?);
    // Files of 4DGT keep their tensors in a folder of their own, beside what their training left.
    let is_4dgt = |name: &&str| name.contains("image_coder.") || *name == "mask_token";
    if source.names().iter().any(is_4dgt) {
        source = rogs_4dgt::import::ours(open_any(file).with_context(opening)?);
    }
    let network = match configuration {
        Some(name) => Some(Network::by_name(name)?),
        None => Network::of(&source, &metadata)?,
    };
    let Some(network) = network else {
        if LpipsWeights::open(file).is_ok() {
            return finish(
                json,
                "LPIPS",
                &weights_report(&found, hash_is_right),
                &Verification::default(),
                &[],
            );
        }
        bail!(
            "`{}` holds the weights of an unknown network; name it with `--configuration`",
            file.display()
        );
    };
    let report = network.verify(&source);
    let mut broken = Vec::new();
    for name in source.names() {
        if report.unexpected.iter().any(|unexpected| unexpected == name) || name.ends_with(".num_batches_tracked") {
            continue;
        }
        let values = source.values(name).with_context(opening)?;
        let wrong = values.iter().filter(|value| !value.is_finite()).count();
        if wrong > 0 {
            broken.push(format!("{name}: {wrong} of {} values are not finite", values.len()));
        }
    }
    let mut summary = weights_report(&found, hash_is_right);
    if origin == Origin::Vggt {
        summary.note = Some("a VGGT file: what is missing starts from a seed at import".into());
    }
    finish(json, &network.describe(), &summary, &report, &broken)
}

/// What is known besides names and shapes.
struct Summary {
    sha256: String,
    hash_is_right: Option<bool>,
    note: Option<String>,
}

fn weights_report(sha256: &str, hash_is_right: Option<bool>) -> Summary {
    Summary {
        sha256: sha256.to_owned(),
        hash_is_right,
        note: None,
    }
}

fn matches_digits(digits: &str, found: &str) -> anyhow::Result<bool> {
    match Expected::digits(digits)? {
        Expected::Digits(digits) => Ok(found.starts_with(&digits)),
        Expected::Anything => Ok(true),
    }
}

/// Prints what was found; the exit code says whether all is well.
fn finish(
    json: bool,
    network: &str,
    summary: &Summary,
    report: &Verification,
    broken: &[String],
) -> anyhow::Result<ExitCode> {
    let good = report.is_clean() && broken.is_empty() && summary.hash_is_right != Some(false);
    if json {
        let misshapen = |(name, found, needed): &(String, Vec<usize>, Vec<usize>)| Misshapen {
            name: name.clone(),
            found: found.clone(),
            needed: needed.clone(),
        };
        output::json(&Checked {
            network: network.to_owned(),
            good,
            sha256: summary.sha256.clone(),
            sha256_is_right: summary.hash_is_right,
            matching: report.matching,
            missing: report.missing.clone(),
            unexpected: report.unexpected.clone(),
            misshapen: report.misshapen.iter().map(misshapen).collect(),
            not_finite: broken.to_vec(),
            note: summary.note.clone(),
        })?;
    } else {
        let mut text = format!(
            "{network}: {} tensors as they should be\nSHA-256 {}",
            report.matching, summary.sha256
        );
        text.push_str(match summary.hash_is_right {
            Some(true) => ", the expected one\n",
            Some(false) => ", NOT the expected one\n",
            None => "\n",
        });
        for line in report.lines(LISTED).iter().chain(broken).chain(&summary.note) {
            text.push_str(line);
            text.push('\n');
        }
        text.push_str(if good { "good" } else { "NOT good" });
        output::text(&text)?;
    }
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;
    use rogs_weights::{ElementType, TensorSource, write};

    fn stage2(path: &Path, change: impl Fn(&str, &mut Vec<f32>)) {
        let tensors = parameter_shapes(&RefinerConfig::preset("ci").unwrap())
            .into_iter()
            .map(|(name, shape)| {
                let mut values = vec![0.5; shape.iter().product()];
                change(&name, &mut values);
                TensorSource {
                    name,
                    shape,
                    values: Box::new(move || Ok(values)),
                }
            });
        write(path, &BTreeMap::new(), ElementType::F32, tensors.collect()).unwrap();
    }

    #[test]
    fn good_and_bad_files_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stage2.safetensors");
        let verify = |configuration: Option<&str>, sha256: Option<&str>| run(&path, configuration, sha256, true);
        let is_good = |code: ExitCode| format!("{code:?}") == format!("{:?}", ExitCode::SUCCESS);
        stage2(&path, |_, _| {});
        assert!(is_good(verify(None, None).unwrap()), "the preset is known by its width");
        let digits = hash(&path).unwrap();
        assert!(is_good(verify(Some("ci"), Some(&digits[..16])).unwrap()));
        assert!(!is_good(verify(Some("ci"), Some("0123456789")).unwrap()));
        assert!(!is_good(verify(Some("paper"), None).unwrap()), "other shapes");
        assert!(
            verify(Some("huge"), None)
                .unwrap_err()
                .to_string()
                .contains("resplat-re10k")
        );
        stage2(&path, |name, values| {
            if name == "encoder.update_head.6.bias" {
                values[3] = f32::NAN;
            }
        });
        assert!(!is_good(verify(None, None).unwrap()), "a value is not a number");
        std::fs::write(&path, b"no weights").unwrap();
        assert!(
            verify(None, None)
                .unwrap_err()
                .to_string()
                .contains("stage2.safetensors")
        );
    }
}
