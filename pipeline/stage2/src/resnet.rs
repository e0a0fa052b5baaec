//! The frozen front of a ResNet-18: three feature maps of an image (`docs/spec/stage2.md` section A.3).

use crate::{Error, Result};
use rogs_kernels::pointwise::{add_assign, relu_in_place};
use rogs_kernels::{Conv, FeatureMap, MaxPool, add_resized};
use rogs_tensors::parameters::Parameters;

/// Mean and standard deviation that images are normalised by.
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const DEVIATION: [f32; 3] = [0.229, 0.224, 0.225];

/// The three maps of one image: at half, quarter and eighth resolution.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureMaps {
    /// First convolution before its normalisation; first layer; second layer.
    pub maps: [FeatureMap; 3],
}

impl FeatureMaps {
    /// Channels of the three maps together.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.maps.iter().map(|map| map.channels).sum()
    }

    /// The maps resized to one grid and concatenated. `[height, width, channels]`
    #[must_use]
    pub fn concatenated(&self, height: usize, width: usize) -> FeatureMap {
        let mut out = FeatureMap::zeros(height, width, self.channels());
        self.add_concatenated(height, width, &mut out.data);
        out
    }

    /// Adds the resized, concatenated maps to an image with that many channels.
    pub(crate) fn add_concatenated(&self, height: usize, width: usize, out: &mut [f32]) {
        let (channels, mut offset) = (self.channels(), 0);
        for map in &self.maps {
            add_resized(map, height, width, out, channels, offset);
            offset += map.channels;
        }
    }

    /// The difference of the maps of two images of one size.
    #[must_use]
    pub(crate) fn minus(&self, other: &Self) -> Self {
        let [a, b, c] = &self.maps;
        let [x, y, z] = &other.maps;
        Self {
            maps: [a.minus(x), b.minus(y), c.minus(z)],
        }
    }
}

/// ResNet-18 up to its second layer, normalisations in evaluation mode.
#[derive(Debug, Clone)]
pub struct ResNetFront {
    stem: Conv,
    stem_scale: Vec<f32>,
    stem_shift: Vec<f32>,
    layers: [[BasicBlock; 2]; 2],
}

#[derive(Debug, Clone)]
struct BasicBlock {
    first: Conv,
    second: Conv,
    shortcut: Option<Conv>,
}

impl ResNetFront {
    /// Reads `PREFIX.conv1`, `bn1`, `layer1`, `layer2`.
    ///
    /// # Errors
    /// When a parameter is missing or has another shape than `widths` (stem and first layer; second layer) say.
    pub fn load(parameters: &Parameters, prefix: &str, [stem, deep]: [usize; 2]) -> Result<Self> {
        let block = |layer: usize, index: usize, inputs: usize, outputs: usize, stride: usize| -> Result<BasicBlock> {
            let name = format!("{prefix}.layer{layer}.{index}");
            let conv = |part: &str, norm: &str, inputs: usize, size: usize, stride: usize| -> Result<Conv> {
                let (scale, shift) = normalisation(parameters, &format!("{name}.{norm}"), outputs)?;
                let weight = checked(
                    parameters,
                    &format!("{name}.{part}.weight"),
                    &[outputs, inputs, size, size],
                )?;
                Ok(Conv::new(&weight, None, inputs, outputs, size, stride).followed_by(&scale, &shift))
            };
            let shortcut = if stride > 1 {
                Some(conv("downsample.0", "downsample.1", inputs, 1, stride)?)
            } else {
                None
            };
            Ok(BasicBlock {
                first: conv("conv1", "bn1", inputs, 3, stride)?,
                second: conv("conv2", "bn2", outputs, 3, 1)?,
                shortcut,
            })
        };
        let weight = checked(parameters, &format!("{prefix}.conv1.weight"), &[stem, 3, 7, 7])?;
        let (stem_scale, stem_shift) = normalisation(parameters, &format!("{prefix}.bn1"), stem)?;
        Ok(Self {
            stem: Conv::new(&weight, None, 3, stem, 7, 2),
            stem_scale,
            stem_shift,
            layers: [
                [block(1, 0, stem, stem, 1)?, block(1, 1, stem, stem, 1)?],
                [block(2, 0, stem, deep, 2)?, block(2, 1, deep, deep, 1)?],
            ],
        })
    }

    /// The three maps of an image with values in [0, 1]. `image` is `[height, width, 3]`
    ///
    /// # Errors
    /// When the image has not three channels or no pixel.
    pub fn forward(&self, image: &FeatureMap) -> Result<FeatureMaps> {
        if image.channels != 3 || image.data.is_empty() || image.data.len() != image.height * image.width * 3 {
            return Err(Error::BadInput(format!(
                "an RGB image was expected, got {} x {} x {}",
                image.height, image.width, image.channels
            )));
        }
        let mut normalised = image.clone();
        for pixel in normalised.data.chunks_exact_mut(3) {
            for channel in 0..3 {
                pixel[channel] = (pixel[channel] - MEAN[channel]) / DEVIATION[channel];
            }
        }
        let half = self.stem.forward(&normalised);
        let mut activated = half.clone();
        for pixel in activated.data.chunks_exact_mut(self.stem_scale.len()) {
            for ((value, scale), shift) in pixel.iter_mut().zip(&self.stem_scale).zip(&self.stem_shift) {
                *value = (*value * scale + shift).max(0.0);
            }
        }
        let pooled = MaxPool::OVERLAPPING.forward(&activated);
        let run = |blocks: &[BasicBlock; 2], map: &FeatureMap| blocks[1].forward(&blocks[0].forward(map));
        let quarter = run(&self.layers[0], &pooled);
        let eighth = run(&self.layers[1], &quarter);
        Ok(FeatureMaps {
            maps: [half, quarter, eighth],
        })
    }
}

impl BasicBlock {
    fn forward(&self, map: &FeatureMap) -> FeatureMap {
        let mut inner = self.first.forward(map);
        relu_in_place(&mut inner.data);
        let mut out = self.second.forward(&inner);
        match &self.shortcut {
            Some(shortcut) => add_assign(&mut out.data, &shortcut.forward(map).data),
            None => add_assign(&mut out.data, &map.data),
        }
        relu_in_place(&mut out.data);
        out
    }
}

/// Host values of a parameter whose shape must be `shape`.
pub(crate) fn checked(parameters: &Parameters, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
    let found = parameters
        .shape(name)
        .ok_or_else(|| rogs_weights::Error::MissingTensor { name: name.to_owned() })?;
    if found != shape {
        let (name, found, expected) = (name.to_owned(), found.to_vec(), shape.to_vec());
        return Err(rogs_weights::Error::WrongShape { name, found, expected }.into());
    }
    parameters.host(name)
}

/// Batch normalisation in evaluation mode as scale and shift, epsilon 1e-5.
fn normalisation(parameters: &Parameters, name: &str, width: usize) -> Result<(Vec<f32>, Vec<f32>)> {
    let part = |part: &str| checked(parameters, &format!("{name}.{part}"), &[width]);
    let (weight, bias, mean, variance) = (
        part("weight")?,
        part("bias")?,
        part("running_mean")?,
        part("running_var")?,
    );
    let scale: Vec<f32> = weight
        .iter()
        .zip(&variance)
        .map(|(w, v)| w / (v + 1e-5).sqrt())
        .collect();
    let shift = bias
        .iter()
        .zip(&mean)
        .zip(&scale)
        .map(|((b, m), s)| b - m * s)
        .collect();
    Ok((scale, shift))
}
