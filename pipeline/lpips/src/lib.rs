//! LPIPS-VGG image distance (`docs/spec/scoring.md` section 4): package `lpips` 0.1.4, network `vgg`, version 0.1.
//!
//! An image in [0, 1] becomes `(2 v - 1 - shift) / scale`, passes the thirteen convolutions of VGG16 and is read after
//! relu1_2, 2_2, 3_3, 4_3 and 5_3. Each reading is divided by its length over channels; the distance is the weighted
//! squared difference, averaged over pixels and added over the five layers.
//!
//! The weights are the user's: torchvision's VGG16 and the five heads, in any of the usual names ([`Lpips::open`]).
//! Features of reference images can be kept and compared many times ([`Lpips::features`], [`Lpips::distance`]); training
//! uses `LpipsTensors` (feature `tensors`), which records gradients and runs on any device.

mod distances;
mod error;
#[cfg(feature = "tensors")]
mod tensors;
mod trunk;
mod weights;

use std::path::Path;

use trunk::Trunk;

pub use error::{Error, Result};
#[cfg(feature = "tensors")]
pub use tensors::LpipsTensors;
pub use weights::LpipsWeights;

/// Number of layers that are compared.
pub const LAYERS: usize = 5;
/// Convolutions of each block; a 2x2 max-pool lies between blocks.
pub(crate) const BLOCKS: [usize; LAYERS] = [2, 2, 3, 3, 3];
/// Number of convolutions.
pub(crate) const CONVOLUTIONS: usize = 13;
/// Per-channel shift of the input in [-1, 1].
pub(crate) const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
/// Per-channel scale of the input.
pub(crate) const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Smallest image side: four poolings must leave a pixel.
const MIN_SIDE: usize = 16;

/// The network, ready for the CPU.
pub struct Lpips {
    trunk: Trunk,
    /// Per layer the weights of its channels.
    heads: Vec<Vec<f32>>,
    /// For people: where the weights come from.
    description: String,
}

/// The normalised features of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct LpipsFeatures {
    height: usize,
    width: usize,
    /// Per layer `[height, width, channels]`.
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
        Self {
            trunk: Trunk::new(&weights.convolutions),
            heads: weights.heads,
            description: weights.description,
        }
    }

    /// Where the weights come from, for people.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.description
    }

    /// The features of an RGB image in [0, 1]; values are clipped to it. `rgb [H, W, 3]`
    ///
    /// # Errors
    /// When the buffer has another size or the image is smaller than 16 pixels on a side.
    pub fn features(&self, rgb: &[f32], height: usize, width: usize) -> Result<LpipsFeatures> {
        Ok(self.read_all(&normalised(rgb, height, width, of_unit)?, height, width))
    }

    /// The features of an 8-bit RGB image. `rgb [H, W, 3]`
    ///
    /// # Errors
    /// As [`Lpips::features`].
    pub fn features_of_bytes(&self, rgb: &[u8], height: usize, width: usize) -> Result<LpipsFeatures> {
        Ok(self.read_all(&normalised(rgb, height, width, of_byte)?, height, width))
    }

    fn read_all(&self, image: &[f32], height: usize, width: usize) -> LpipsFeatures {
        let mut layers = Vec::with_capacity(LAYERS);
        self.trunk.run(image, [height, width], |_, maps| {
            layers.push(distances::normalised(maps))
        });
        LpipsFeatures { height, width, layers }
    }

    /// Distance of an RGB image in [0, 1] from kept features, without keeping its own: the same value as
    /// [`Lpips::distance`] of both, sooner. `rgb [H, W, 3]`
    ///
    /// # Errors
    /// As [`Lpips::features`], and when the features are those of an image of another size.
    pub fn distance_from(&self, rgb: &[f32], height: usize, width: usize, kept: &LpipsFeatures) -> Result<f64> {
        let image = normalised(rgb, height, width, of_unit)?;
        same_size((height, width), (kept.height, kept.width))?;
        let mut sum = 0.0;
        self.trunk.run(&image, [height, width], |layer, maps| {
            sum += distances::distance_of(maps, &kept.layers[layer], &self.heads[layer]);
        });
        Ok(sum)
    }

    /// Distance of two images from their features.
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
        same_size((a.height, a.width), (b.height, b.width))?;
        Ok(std::array::from_fn(|layer| {
            let width = a.width >> layer;
            distances::distance_between(&a.layers[layer], &b.layers[layer], width, &self.heads[layer])
        }))
    }
}

fn same_size(a: (usize, usize), b: (usize, usize)) -> Result<()> {
    if a == b {
        return Ok(());
    }
    Err(Error::BadInput(format!(
        "LPIPS compares images of one size, found {}x{} and {}x{}",
        a.0, a.1, b.0, b.1
    )))
}

/// A value in [0, 1] as one in [-1, 1].
fn of_unit(value: f32) -> f32 {
    let unit = if value.is_nan() { 0.0 } else { value.clamp(0.0, 1.0) };
    2.0 * unit - 1.0
}

/// An 8-bit value as one in [-1, 1].
fn of_byte(value: u8) -> f32 {
    f32::from(value) / 127.5 - 1.0
}

/// An image with the input normalisation. `[H, W, 3]`
fn normalised<T: Copy>(rgb: &[T], height: usize, width: usize, value: impl Fn(T) -> f32) -> Result<Vec<f32>> {
    if rgb.len() != height.saturating_mul(width).saturating_mul(3) || height < MIN_SIDE || width < MIN_SIDE {
        return Err(Error::BadInput(format!(
            "LPIPS needs RGB images of at least {MIN_SIDE}x{MIN_SIDE} pixels, found {} values for {height}x{width}",
            rgb.len()
        )));
    }
    let (pixels, _) = rgb.as_chunks::<3>();
    let pixel = |pixel: &[T; 3]| {
        std::array::from_fn::<f32, 3, _>(|channel| (value(pixel[channel]) - SHIFT[channel]) / SCALE[channel])
    };
    Ok(pixels.iter().flat_map(pixel).collect())
}
