//! The first convolution: three channels, so that the nine taps of all channels make one row of a matrix product.

use pulp::Arch;
use rayon::prelude::*;

use crate::filtering::{Scratch, panels};
use crate::maps::{Maps, PANEL, Pixel};
use crate::product::Product;
use crate::weights::ConvolutionWeights;
use rogs_kernels::vectorised;

/// Channels of an image.
const CHANNELS: usize = 3;

/// 3x3 convolution of an RGB image with zero padding, bias and ReLU.
#[derive(Debug)]
pub(super) struct First {
    /// `[output panels][PANEL]`: one row for each tap and channel, the rest zero.
    weights: Vec<Pixel>,
    bias: Vec<Pixel>,
}

impl First {
    pub(super) fn new(own: &ConvolutionWeights) -> Self {
        let bias = panels(&own.bias);
        let mut weights = vec![Pixel::ZERO; bias.len() * PANEL];
        for (output, kernel) in own.weight.chunks_exact(CHANNELS * 9).enumerate() {
            for (channel, taps) in kernel.chunks_exact(9).enumerate() {
                for (tap, &weight) in taps.iter().enumerate() {
                    let row = output / PANEL * PANEL + tap * CHANNELS + channel;
                    weights[row].0[output % PANEL] = weight;
                }
            }
        }
        Self { weights, bias }
    }

    /// The layer of an image, into `output`. `image [height, width, 3]`
    pub(super) fn run(&self, image: &[f32], height: usize, width: usize, output: &mut Maps, scratch: &Scratch) {
        output.reshape(self.bias.len(), height, width);
        let line = width * CHANNELS;
        let bands = output.bands(1);
        bands.into_par_iter().enumerate().for_each(|(row, mut band)| {
            scratch.lend(2 * width, |buffer| {
                let (patches, sums) = buffer.split_at_mut(width);
                for (column, patch) in patches.iter_mut().enumerate() {
                    *patch = Pixel::ZERO;
                    // Columns `column - 1` to `column + 1` of the image, as far as there are.
                    let (first, last) = (column.saturating_sub(1), (column + 2).min(width));
                    let start = (first + 1 - column) * CHANNELS;
                    let length = (last - first) * CHANNELS;
                    for tap_row in 0..3 {
                        let Some(source) = (row + tap_row).checked_sub(1).filter(|&own| own < height) else {
                            continue;
                        };
                        let values = &image[source * line + first * CHANNELS..][..length];
                        patch.0[tap_row * 9 + start..][..length].copy_from_slice(values);
                    }
                }
                let by_panel = self.weights.chunks_exact(PANEL).zip(&self.bias);
                for ((weights, bias), out) in by_panel.zip(&mut band) {
                    Arch::new().dispatch(Product {
                        values: patches,
                        stride: width,
                        weights,
                        out: sums,
                    });
                    let (pixels, sums) = (&mut out[1..=width], &*sums);
                    vectorised(
                        #[inline(always)]
                        || {
                            for (pixel, sum) in pixels.iter_mut().zip(sums) {
                                for lane in 0..PANEL {
                                    pixel.0[lane] = (sum.0[lane] + bias.0[lane]).max(0.0);
                                }
                            }
                        },
                    );
                }
            });
        });
    }
}
