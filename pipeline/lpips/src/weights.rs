//! Reading the weights from the user's files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_weights::{Error, ParameterSource, Result, is_weights_file, open_any};

use crate::{BLOCKS, CONVOLUTIONS, LAYERS};

/// Place of each convolution in torchvision's `features`.
const FEATURE_INDEX: [usize; CONVOLUTIONS] = [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28];
/// Most channels of a layer that are believed.
const MAX_CHANNELS: usize = 4096;

/// Weights of the thirteen convolutions and the five heads, of any widths that fit together.
#[derive(Debug, Clone, PartialEq)]
pub struct LpipsWeights {
    pub(crate) convolutions: Vec<ConvolutionWeights>,
    /// Per layer `[C]`.
    pub(crate) heads: Vec<Vec<f32>>,
    /// For people: where they come from.
    pub(crate) description: String,
}

/// One 3x3 convolution.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ConvolutionWeights {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// `[out, in, 3, 3]`
    pub(crate) weight: Vec<f32>,
    /// `[out]`
    pub(crate) bias: Vec<f32>,
}

impl LpipsWeights {
    /// Reads them from a `.safetensors`, `.pth`, `.pt` or `.ckpt` file, or from all such files of a folder together (for
    /// example torchvision's VGG16 beside the heads of the `lpips` package).
    ///
    /// Convolutions may be called `features.N` (torchvision), `net.sliceK.N` (`lpips`) or `convL`; heads
    /// `linK.model.1.weight`, `lins.K.model.1.weight` or `linK.weight`.
    ///
    /// # Errors
    /// When a file cannot be read, or something is missing or has the wrong shape.
    pub fn open(path: &Path) -> Result<Self> {
        let files = weight_files(path)?;
        let sources = files
            .iter()
            .map(|file| open_any(file))
            .collect::<Result<Vec<Box<dyn ParameterSource>>>>()?;
        let names: Vec<String> = files
            .iter()
            .filter_map(|file| Some(file.file_name()?.to_string_lossy().into_owned()))
            .collect();
        Self::from_lookup(names.join(" + "), |name| {
            let Some((source, shape)) = sources.iter().find_map(|source| Some((source, source.shape(name)?))) else {
                return Ok(None);
            };
            Ok(Some((shape.to_vec(), source.values(name)?)))
        })
    }

    /// Takes them from a function that gives shape and values of a tensor by name.
    ///
    /// # Errors
    /// When something is missing or has the wrong shape.
    pub fn from_lookup(
        description: String,
        lookup: impl Fn(&str) -> Result<Option<(Vec<usize>, Vec<f32>)>>,
    ) -> Result<Self> {
        let first = |names: &[String]| -> Result<(String, Vec<usize>, Vec<f32>)> {
            for name in names {
                if let Some((shape, values)) = lookup(name)? {
                    if values.len() != shape.iter().product::<usize>() {
                        expect_shape(name, &[values.len()], &shape)?;
                    }
                    return Ok((name.clone(), shape, values));
                }
            }
            Err(Error::MissingTensor {
                name: names.first().cloned().unwrap_or_default(),
            })
        };
        let mut convolutions = Vec::with_capacity(CONVOLUTIONS);
        let mut inputs = 3;
        for layer in 0..CONVOLUTIONS {
            let (name, shape, weight) = first(&convolution_names(layer, "weight"))?;
            let outputs = shape
                .first()
                .copied()
                .filter(|&count| (1..=MAX_CHANNELS).contains(&count))
                .unwrap_or(1);
            expect_shape(&name, &shape, &[outputs, inputs, 3, 3])?;
            let (name, shape, bias) = first(&convolution_names(layer, "bias"))?;
            expect_shape(&name, &shape, &[outputs])?;
            convolutions.push(ConvolutionWeights {
                inputs,
                outputs,
                weight,
                bias,
            });
            inputs = outputs;
        }
        let mut heads = Vec::with_capacity(LAYERS);
        for layer in 0..LAYERS {
            let channels = convolutions[BLOCKS[..=layer].iter().sum::<usize>() - 1].outputs;
            let (name, shape, head) = first(&head_names(layer))?;
            if shape != [channels] {
                expect_shape(&name, &shape, &[1, channels, 1, 1])?;
            }
            heads.push(head);
        }
        let weights = Self {
            convolutions,
            heads,
            description,
        };
        if weights.values().any(|value| !value.is_finite()) {
            return Err(Error::BadInput(
                "the LPIPS weights hold values that are not finite numbers".into(),
            ));
        }
        Ok(weights)
    }

    fn values(&self) -> impl Iterator<Item = &f32> {
        let convolutions = self
            .convolutions
            .iter()
            .flat_map(|own| own.weight.iter().chain(&own.bias));
        convolutions.chain(self.heads.iter().flatten())
    }
}

fn convolution_names(layer: usize, part: &str) -> Vec<String> {
    let index = FEATURE_INDEX[layer];
    let slice = BLOCKS
        .iter()
        .scan(0, |end, count| {
            *end += count;
            Some(*end)
        })
        .take_while(|&end| end <= layer)
        .count()
        + 1;
    vec![
        format!("features.{index}.{part}"),
        format!("net.slice{slice}.{index}.{part}"),
        format!("conv{layer}.{part}"),
    ]
}

fn head_names(layer: usize) -> Vec<String> {
    vec![
        format!("lin{layer}.model.1.weight"),
        format!("lins.{layer}.model.1.weight"),
        format!("lin{layer}.weight"),
    ]
}

fn expect_shape(name: &str, found: &[usize], expected: &[usize]) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::WrongShape {
        name: name.to_owned(),
        found: found.to_vec(),
        expected: expected.to_vec(),
    })
}

/// The file itself, or the weight files of a folder by name.
fn weight_files(path: &Path) -> Result<Vec<PathBuf>> {
    let io = |source| Error::Io {
        path: path.to_owned(),
        source,
    };
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(io)? {
        let file = entry.map_err(io)?.path();
        if is_weights_file(&file) {
            files.push(file);
        }
    }
    files.sort_unstable();
    if files.is_empty() {
        let reason = "the folder has no .safetensors, .pth, .pt or .ckpt file".into();
        return Err(Error::BadFile {
            path: path.to_owned(),
            reason,
        });
    }
    Ok(files)
}

/// Weights by name from memory, for tests and tools.
impl LpipsWeights {
    /// Takes them from a map of shapes and values.
    ///
    /// # Errors
    /// When something is missing or has the wrong shape.
    pub fn from_map(description: &str, tensors: &BTreeMap<String, (Vec<usize>, Vec<f32>)>) -> Result<Self> {
        Self::from_lookup(description.to_owned(), |name| Ok(tensors.get(name).cloned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_are_those_of_the_package() {
        assert_eq!(convolution_names(0, "weight")[1], "net.slice1.0.weight");
        assert_eq!(convolution_names(2, "bias")[1], "net.slice2.5.bias");
        assert_eq!(convolution_names(6, "bias")[1], "net.slice3.14.bias");
        assert_eq!(convolution_names(12, "weight")[1], "net.slice5.28.weight");
    }

    #[test]
    fn what_is_missing_is_named() {
        let error = LpipsWeights::from_map("nothing", &BTreeMap::new()).unwrap_err();
        assert!(error.to_string().contains("features.0.weight"), "{error}");
    }
}
