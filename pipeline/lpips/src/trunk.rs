//! The thirteen convolutions and four poolings of VGG16, with buffers that are used again.

use std::sync::{Mutex, OnceLock, PoisonError};

use rogs_kernels::{Conv, MaxPool, TileSize, Winograd};

use crate::weights::ConvolutionWeights;
use crate::{BLOCKS, LAYERS};

/// Images with fewer pixels than this take the smaller tiles: where weights outweigh the image, it matters that those of
/// F(2x2, 3x3) are less than half of those of F(4x4, 3x3).
const SMALL_IMAGE: usize = 300;

/// The maps of one layer, channels last. `[height, width, channels]`
#[derive(Debug, Default)]
pub(super) struct Maps {
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) channels: usize,
    /// As long as the largest map that it held, because fresh memory has to be cleared page by page.
    values: Vec<f32>,
}

impl Maps {
    /// Takes another size; what is in it has no meaning.
    fn reshape(&mut self, [height, width]: [usize; 2], channels: usize) -> &mut [f32] {
        (self.height, self.width, self.channels) = (height, width, channels);
        let length = height * width * channels;
        if self.values.len() < length {
            self.values.resize(length, 0.0);
        }
        &mut self.values[..length]
    }

    /// Maps with these values.
    #[cfg(test)]
    pub(super) fn of([height, width]: [usize; 2], channels: usize, values: Vec<f32>) -> Self {
        Self {
            height,
            width,
            channels,
            values,
        }
    }

    fn size(&self) -> [usize; 2] {
        [self.height, self.width]
    }

    pub(super) fn values(&self) -> &[f32] {
        &self.values[..self.height * self.width * self.channels]
    }
}

/// A 3x3 convolution with ReLU, with both forms of its weights; a form is made when the first image of its size comes.
#[derive(Debug)]
struct Convolution {
    weights: ConvolutionWeights,
    two: OnceLock<Winograd>,
    four: OnceLock<Winograd>,
}

impl Convolution {
    fn new(weights: &ConvolutionWeights) -> Self {
        Self {
            weights: weights.clone(),
            two: OnceLock::new(),
            four: OnceLock::new(),
        }
    }

    fn run(&self, input: &Maps, output: &mut Maps) {
        let (slot, tiles) = if input.height * input.width < SMALL_IMAGE {
            (&self.two, TileSize::Two)
        } else {
            (&self.four, TileSize::Four)
        };
        let ConvolutionWeights {
            inputs,
            outputs,
            weight,
            bias,
        } = &self.weights;
        let kernel = slot.get_or_init(|| Winograd::new(weight, bias, *inputs, *outputs, tiles));
        kernel.rectified(input.values(), input.size(), output.reshape(input.size(), *outputs));
    }
}

/// The convolutions, ready for the CPU.
#[derive(Debug)]
pub(super) struct Trunk {
    /// The first, of three channels: too few for Winograd's algorithm.
    first: Option<Conv>,
    others: Vec<Convolution>,
    /// Two maps for each image that is worked on.
    maps: Mutex<Vec<[Maps; 2]>>,
}

impl Trunk {
    pub(super) fn new(weights: &[ConvolutionWeights]) -> Self {
        let first =
            |own: &ConvolutionWeights| Conv::new(&own.weight, Some(own.bias.clone()), own.inputs, own.outputs, 3, 1);
        Self {
            first: weights.first().map(first),
            others: weights.iter().skip(1).map(Convolution::new).collect(),
            maps: Mutex::default(),
        }
    }

    /// Shows the maps of each of the five layers to `read`. `image [height, width, 3]`, normalised
    pub(super) fn run(&self, image: &[f32], size: [usize; 2], mut read: impl FnMut(usize, &Maps)) {
        let lock = || self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = lock().pop();
        let [mut maps, mut next] = kept.unwrap_or_default();
        let mut others = self.others.iter();
        for block in 0..LAYERS {
            let mut count = BLOCKS[block];
            match &self.first {
                Some(first) if block == 0 => {
                    first.run(image, size, true, maps.reshape(size, first.outputs()));
                    count -= 1;
                }
                _ => {
                    let pool = MaxPool::HALVES;
                    let out = next.reshape(pool.output_size(maps.size()), maps.channels);
                    pool.run(maps.values(), maps.size(), maps.channels, out);
                    std::mem::swap(&mut maps, &mut next);
                }
            }
            for convolution in others.by_ref().take(count) {
                convolution.run(&maps, &mut next);
                std::mem::swap(&mut maps, &mut next);
            }
            read(block, &maps);
        }
        lock().push([maps, next]);
    }
}
