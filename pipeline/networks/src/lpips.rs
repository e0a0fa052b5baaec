//! LPIPS-VGG image distance (`scoring.md` section 4): package `lpips` 0.1.4, network `vgg`, version 0.1.
//!
//! An image in [0, 1] becomes `(2 v - 1 - shift) / scale`, passes the thirteen convolutions of VGG16 and is read after
//! relu1_2, 2_2, 3_3, 4_3 and 5_3. Each reading is divided by its length over channels; the distance is the weighted
//! squared difference, averaged over pixels and added over the five readings.
//!
//! The weights are the user's: torchvision's VGG16 and the five heads, in any of the usual names ([`Lpips::open`]).
//! Features of reference images can be kept and compared many times ([`Lpips::features`], [`Lpips::distance`]); training
//! uses [`LpipsTensors`], which records gradients and runs on any device.

mod tensors;
mod weights;

use std::path::Path;

use rayon::prelude::*;

use crate::kernels::{After, Conv3x3};
use crate::{Error, Result};

pub use tensors::LpipsTensors;
pub use weights::LpipsWeights;

/// Number of readings.
pub const LAYERS: usize = 5;
/// Convolutions of each block; a 2x2 max-pool lies between blocks.
pub(crate) const BLOCKS: [usize; LAYERS] = [2, 2, 3, 3, 3];
/// Number of convolutions.
pub(crate) const CONVOLUTIONS: usize = 13;
/// Per-channel shift of the input in [-1, 1].
pub(crate) const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
/// Per-channel scale of the input.
pub(crate) const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Added to the length a feature vector is divided by.
pub(crate) const LENGTH_FLOOR: f32 = 1e-10;
/// Smallest image side: four poolings must leave a pixel.
const MIN_SIDE: usize = 16;

/// The network, ready for the CPU.
pub struct Lpips {
    convolutions: Vec<Conv3x3>,
    heads: Vec<Vec<f32>>,
    /// For people: where the weights come from.
    description: String,
}

/// The normalised readings of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct LpipsFeatures {
    height: usize,
    width: usize,
    /// Per layer `[C, H, W]`.
    layers: Vec<Vec<f32>>,
}

impl LpipsFeatures {
    /// Memory the values take, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.layers.iter().map(|layer| layer.len() * size_of::<f32>()).sum()
    }
}

impl Lpips {
    /// Reads the weights from a file or from all weight files of a folder.
    ///
    /// # Errors
    /// When a file cannot be read, or a convolution or head is missing or has the wrong shape.
    pub fn open(path: &Path) -> Result<Self> {
        Ok(Self::new(LpipsWeights::open(path)?))
    }

    /// The network of given weights.
    #[must_use]
    pub fn new(weights: LpipsWeights) -> Self {
        let LpipsWeights {
            convolutions,
            heads,
            description,
        } = weights;
        let convolutions = convolutions
            .iter()
            .map(|c| Conv3x3::new(&c.weight, &c.bias, c.outputs, c.inputs))
            .collect();
        Self {
            convolutions,
            heads,
            description,
        }
    }

    /// Where the weights come from, for people.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.description
    }

    /// The readings of an RGB image in [0, 1]; values are clipped to it. `rgb [H, W, 3]`
    ///
    /// # Errors
    /// When the buffer has another size or the image is smaller than 16 pixels on a side.
    pub fn features(&self, rgb: &[f32], height: usize, width: usize) -> Result<LpipsFeatures> {
        let unit = |value: f32| if value.is_nan() { 0.0 } else { value.clamp(0.0, 1.0) };
        let input = planar(rgb, height, width, |value| 2.0 * unit(value) - 1.0)?;
        Ok(self.layers(input, height, width))
    }

    /// The readings of an 8-bit RGB image. `rgb [H, W, 3]`
    ///
    /// # Errors
    /// As [`Lpips::features`].
    pub fn features_of_bytes(&self, rgb: &[u8], height: usize, width: usize) -> Result<LpipsFeatures> {
        let input = planar(rgb, height, width, |value| f32::from(value) / 127.5 - 1.0)?;
        Ok(self.layers(input, height, width))
    }

    fn layers(&self, mut values: Vec<f32>, height: usize, width: usize) -> LpipsFeatures {
        let (mut rows, mut columns) = (height, width);
        let mut layers = Vec::with_capacity(LAYERS);
        let mut convolutions = self.convolutions.iter();
        for (block, &count) in BLOCKS.iter().enumerate() {
            if block > 0 {
                values = max_pool(&values, rows, columns);
                (rows, columns) = (rows / 2, columns / 2);
            }
            for convolution in convolutions.by_ref().take(count) {
                values = convolution.run(&values, [rows, columns], false, After::Relu, None);
            }
            layers.push(normalised(&values, rows * columns));
        }
        LpipsFeatures { height, width, layers }
    }

    /// Distance of two images from their readings.
    ///
    /// # Errors
    /// When the images have different sizes.
    pub fn distance(&self, a: &LpipsFeatures, b: &LpipsFeatures) -> Result<f64> {
        Ok(self.layer_distances(a, b)?.iter().sum())
    }

    /// The five terms of the distance.
    ///
    /// # Errors
    /// When the images have different sizes.
    pub fn layer_distances(&self, a: &LpipsFeatures, b: &LpipsFeatures) -> Result<[f64; LAYERS]> {
        if (a.height, a.width) != (b.height, b.width) {
            return Err(Error::BadInput(format!(
                "LPIPS compares images of one size, found {}x{} and {}x{}",
                a.height, a.width, b.height, b.width
            )));
        }
        let term = |layer: usize| weighted_distance(&a.layers[layer], &b.layers[layer], &self.heads[layer]);
        Ok(std::array::from_fn(term))
    }
}

/// Channel planes of an image with the input normalisation. `[H, W, 3] -> [3, H, W]`
fn planar<T: Copy>(rgb: &[T], height: usize, width: usize, value: impl Fn(T) -> f32) -> Result<Vec<f32>> {
    let area = height.saturating_mul(width);
    if rgb.len() != area.saturating_mul(3) || height < MIN_SIDE || width < MIN_SIDE {
        return Err(Error::BadInput(format!(
            "LPIPS needs RGB images of at least {MIN_SIDE}x{MIN_SIDE} pixels, found {} values for {height}x{width}",
            rgb.len()
        )));
    }
    let mut planes = Vec::with_capacity(area * 3);
    for channel in 0..3 {
        let pixels = rgb
            .chunks_exact(3)
            .map(|pixel| (value(pixel[channel]) - SHIFT[channel]) / SCALE[channel]);
        planes.extend(pixels);
    }
    Ok(planes)
}

/// 2x2 maximum with stride 2; an odd last row or column is dropped. `[C, H, W] -> [C, H / 2, W / 2]`
fn max_pool(values: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let (half_rows, half_columns) = (rows / 2, columns / 2);
    let channels = values.len() / (rows * columns);
    let mut pooled = vec![0.0; channels * half_rows * half_columns];
    let planes = pooled
        .par_chunks_exact_mut(half_rows * half_columns)
        .zip(values.par_chunks_exact(rows * columns));
    planes.for_each(|(pooled, plane)| {
        for (row, out) in pooled.chunks_exact_mut(half_columns).enumerate() {
            let upper = &plane[2 * row * columns..][..columns];
            let lower = &plane[(2 * row + 1) * columns..][..columns];
            let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
            for (out, (upper, lower)) in out.iter_mut().zip(pairs) {
                *out = upper[0].max(upper[1]).max(lower[0].max(lower[1]));
            }
        }
    });
    pooled
}

/// Divides each pixel's feature vector by its length. `[C, pixels]`
fn normalised(values: &[f32], pixels: usize) -> Vec<f32> {
    let mut lengths = vec![0.0f32; pixels];
    for plane in values.chunks_exact(pixels) {
        lengths
            .iter_mut()
            .zip(plane)
            .for_each(|(length, value)| *length += value * value);
    }
    lengths
        .iter_mut()
        .for_each(|length| *length = 1.0 / (length.sqrt() + LENGTH_FLOOR));
    let mut scaled = vec![0.0f32; values.len()];
    scaled
        .par_chunks_exact_mut(pixels)
        .zip(values.par_chunks_exact(pixels))
        .for_each(|(scaled, plane)| {
            for ((scaled, value), length) in scaled.iter_mut().zip(plane).zip(&lengths) {
                *scaled = value * length;
            }
        });
    scaled
}

/// Mean over pixels of the weighted squared difference. `[C, pixels]` each, `head [C]`
fn weighted_distance(a: &[f32], b: &[f32], head: &[f32]) -> f64 {
    let pixels = a.len() / head.len();
    let planes: Vec<f64> = a
        .par_chunks_exact(pixels)
        .zip(b.par_chunks_exact(pixels))
        .map(|(a, b)| {
            let mut lanes = [0.0f64; 8];
            for (a, b) in a.chunks(8).zip(b.chunks(8)) {
                for ((lane, a), b) in lanes.iter_mut().zip(a).zip(b) {
                    let difference = f64::from(a - b);
                    *lane += difference * difference;
                }
            }
            lanes.iter().sum()
        })
        .collect();
    planes
        .iter()
        .zip(head)
        .map(|(sum, &weight)| sum * f64::from(weight))
        .sum::<f64>()
        / pixels as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pooling_drops_an_odd_last_row_and_column() {
        let values = [1.0, 2.0, 9.0, 4.0, 3.0, 9.0, 9.0, 9.0, 9.0];
        assert_eq!(max_pool(&values, 3, 3), [4.0]);
    }

    #[test]
    fn an_empty_feature_vector_stays_empty() {
        assert_eq!(normalised(&[0.0, 3.0, 0.0, 4.0], 2), [0.0, 0.6, 0.0, 0.8]);
    }
}
