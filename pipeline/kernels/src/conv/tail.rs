//! The last step of a dense head in one pass: bilinear enlargement, 3x3 convolution, a per-pixel bias (which holds the
//! position map), ReLU, 1x1 convolution. The enlarged map is never held.

use super::band::{Band, Bands, band_rows};
use super::direct::Conv3x3;
use crate::{Axis, vectorised};

/// The weights of the step.
#[derive(Debug)]
pub struct DenseTail {
    /// 3x3 convolution without its bias.
    pub first: Conv3x3,
    /// Added after the 3x3 convolution. `[hidden, H, W]`
    pub map: Vec<f32>,
    /// 1x1 convolution. `[outputs, hidden]`
    pub second: Vec<f32>,
    /// Bias of the 1x1 convolution. `[outputs]`
    pub bias: Vec<f32>,
    /// Channels of the input.
    pub inputs: usize,
}

impl DenseTail {
    /// `[B, inputs, h, w] -> [B, outputs, H, W]`, corner pixel centres kept in place (align_corners).
    pub fn run(&self, input: &[f32], [rows, columns]: [usize; 2], [height, width]: [usize; 2]) -> Vec<f32> {
        let (hidden, outputs, area) = (self.second.len() / self.bias.len(), self.bias.len(), height * width);
        let small = self.inputs * rows * columns;
        let images = input.len() / small.max(1);
        let (down, across) = (Axis::new(rows, height), Axis::new(columns, width));
        let bands = Bands {
            images,
            channels: outputs,
            size: [height, width],
            rows: band_rows(self.inputs, width),
            across: 1,
        };
        bands.run(|image, rows_of_band, planes| {
            let (source, first) = (&input[image.start * small..][..small], rows_of_band.start);
            let mut band = Band::new(self.inputs, rows_of_band.len(), width);
            let mut blended = vec![0.0f32; columns];
            band.fill(|channel, row, out| {
                let Some(row) = (first + row).checked_sub(1).filter(|&row| row < height) else {
                    return;
                };
                let plane = &source[channel * rows * columns..][..rows * columns];
                let (upper, share) = down.taps[row];
                let lower = &plane[down.second(upper) * columns..][..columns];
                let upper = &plane[upper * columns..][..columns];
                vectorised(
                    #[inline(always)]
                    || {
                        for ((out, &a), &b) in blended.iter_mut().zip(upper).zip(lower) {
                            *out = share.mul_add(b - a, a);
                        }
                    },
                );
                for (out, &(left, share)) in out.iter_mut().zip(&across.taps) {
                    let (a, b) = (blended[left], blended[across.second(left)]);
                    *out = a + share * (b - a);
                }
            });
            let pixels = rows_of_band.len() * width;
            let mut sums = vec![0.0f32; hidden * pixels];
            self.first
                .band(&band, &mut sums.chunks_exact_mut(pixels.max(1)).collect::<Vec<_>>());
            vectorised(
                #[inline(always)]
                || {
                    for (output, &bias) in planes.iter_mut().zip(&self.bias) {
                        output.fill(bias);
                    }
                    let mut rectified = vec![0.0f32; pixels];
                    for channel in 0..hidden {
                        let map = &self.map[channel * area + first * width..][..pixels];
                        let sums = &sums[channel * pixels..][..pixels];
                        for ((out, &sum), &map) in rectified.iter_mut().zip(sums).zip(map) {
                            *out = (sum + map).max(0.0);
                        }
                        for (output, weights) in planes.iter_mut().zip(self.second.chunks_exact(hidden)) {
                            let weight = weights[channel];
                            for (out, &value) in output.iter_mut().zip(&rectified) {
                                *out = weight.mul_add(value, *out);
                            }
                        }
                    }
                },
            );
        })
    }
}
