//! Sensors: exposure and noise, and what happens to a picture afterwards.

use super::texture::mix;

/// Imperfections of a camera's picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sensor {
    /// Factor on linear light.
    pub exposure: f32,
    /// Gains of red, green and blue: white balance.
    pub balance: [f32; 3],
    /// Darkening at the corners, a share.
    pub vignette: f32,
    /// Standard deviation of the noise, 8-bit levels.
    pub noise: f32,
    /// What the picture goes through before it is stored; nothing in plain cells.
    pub finish: Option<Finish>,
}

/// Contrast and blur before the noise, compression after it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Finish {
    /// Exponent of the encoded picture.
    pub contrast: f32,
    /// Standard deviation of the blur along rows and along columns, in widths of the image.
    pub blur: [f32; 2],
    /// Quality of the compression; `None` without.
    pub quality: Option<f32>,
}

impl Sensor {
    /// The sensor as the shader applies it: where the picture is finished later, noise comes later too.
    pub(super) fn before_finish(&self) -> Self {
        Self {
            noise: if self.finish.is_some() { 0.0 } else { self.noise },
            ..*self
        }
    }

    /// The stored picture. `[h, w, 3]`
    pub(super) fn finished(&self, mut rgb: Vec<u8>, [height, width]: [usize; 2], noise_key: u32) -> Vec<u8> {
        let Some(finish) = self.finish else { return rgb };
        let curve: [u8; 256] = std::array::from_fn(|level| {
            let value = libm::powf(level as f32 / 255.0, finish.contrast);
            (value * 255.0 + 0.5) as u8
        });
        rgb.iter_mut().for_each(|value| *value = curve[usize::from(*value)]);
        let sigma_px = finish.blur.map(|share| f64::from(share) * width as f64);
        let mut rgb = blurred(&rgb, width, height, sigma_px);
        if self.noise > 0.0 {
            for (pixel, values) in rgb.chunks_exact_mut(3).enumerate() {
                let noise = pixel_noise(noise_key, pixel as u32);
                for (value, noise) in values.iter_mut().zip(noise) {
                    // Bright parts have more noise: photons come one by one.
                    let share = 0.6 + 0.8 * f32::from(*value) / 255.0;
                    *value = (f32::from(*value) + self.noise * share * noise + 0.5).clamp(0.0, 255.0) as u8;
                }
            }
        }
        if let Some(quality) = finish.quality {
            compress(&mut rgb, [height, width], quality);
        }
        rgb
    }
}

/// Three numbers of mean 0 and deviation 1, nearly normal: sums of four random bytes.
pub(super) fn pixel_noise(key: u32, pixel: u32) -> [f32; 3] {
    let base = mix(key ^ pixel.wrapping_mul(0x9e37_79b9));
    [1u32, 2, 3].map(|channel| {
        let bytes = mix(base.wrapping_add(channel.wrapping_mul(0x85eb_ca6b))).to_le_bytes();
        let sum: u32 = bytes.iter().map(|&b| u32::from(b)).sum();
        // Four bytes: mean 510, deviation sqrt(4 (256^2 - 1) / 12).
        (sum as f32 - 510.0) / 147.8
    })
}

/// Blurs narrower than this are none, pixels.
const LEAST_BLUR_PX: f64 = 0.05;

/// An image blurred by a Gaussian of these standard deviations along rows and along columns, pixels; borders repeat.
/// `[h, w, 3]`
pub(crate) fn blurred(rgb: &[u8], width: usize, height: usize, sigma_px: [f64; 2]) -> Vec<u8> {
    if sigma_px.iter().all(|sigma| *sigma < LEAST_BLUR_PX) {
        return rgb.to_vec();
    }
    let pass =
        |values: Vec<f64>, sigma: f64, length: usize, stride: usize, lines: &dyn Fn(usize) -> usize, count: usize| {
            if sigma < LEAST_BLUR_PX {
                return values;
            }
            let reach = (3.0 * sigma).ceil() as isize;
            let weights: Vec<f64> = (-reach..=reach)
                .map(|at| (-0.5 * (at as f64 / sigma).powi(2)).exp())
                .collect();
            let total: f64 = weights.iter().sum();
            let mut out = vec![0.0; values.len()];
            for line in 0..count {
                let start = lines(line);
                for place in 0..length {
                    let sum: f64 = weights
                        .iter()
                        .zip(-reach..)
                        .map(|(weight, shift)| {
                            let at = (place as isize + shift).clamp(0, length as isize - 1) as usize;
                            weight * values[start + at * stride]
                        })
                        .sum();
                    out[start + place * stride] = sum / total;
                }
            }
            out
        };
    let values: Vec<f64> = rgb.iter().map(|&value| f64::from(value)).collect();
    let [along, down] = sigma_px;
    let rows = pass(
        values,
        along,
        width,
        3,
        &|line| line / 3 * width * 3 + line % 3,
        height * 3,
    );
    let both = pass(rows, down, height, width * 3, &|line| line, width * 3);
    both.iter().map(|value| value.round().clamp(0.0, 255.0) as u8).collect()
}

/// Side of a block of the compression.
const BLOCK: usize = 8;

/// What JPEG and the still parts of videos do to a picture: cosine transforms of blocks of 8 x 8, rounded to steps that grow
/// with the frequency (ITU-T T.81, tables K.1 and K.2 with the scaling of the Independent JPEG Group), colour at half the
/// resolution.
fn compress(rgb: &mut [u8], [height, width]: [usize; 2], quality: f32) {
    let scale = if quality < 50.0 {
        50.0 / quality
    } else {
        2.0 - quality / 50.0
    };
    let steps = |table: &[u8; 64]| table.map(|step| (f32::from(step) * scale).max(1.0));
    let [bright, colour] = [steps(&BRIGHTNESS_STEPS), steps(&COLOUR_STEPS)];
    let mut planes = [const { Vec::new() }; 3];
    for values in rgb.chunks_exact(3) {
        let [r, g, b] = [0, 1, 2].map(|k| f32::from(values[k]));
        planes[0].push(0.299 * r + 0.587 * g + 0.114 * b - 128.0);
        planes[1].push(-0.168_736 * r - 0.331_264 * g + 0.5 * b);
        planes[2].push(0.5 * r - 0.418_688 * g - 0.081_312 * b);
    }
    round_blocks(&mut planes[0], [height, width], &bright);
    let half = [height.div_ceil(2), width.div_ceil(2)];
    for plane in &mut planes[1..] {
        let mut small = vec![0.0f32; half[0] * half[1]];
        for (index, value) in small.iter_mut().enumerate() {
            let (row, column) = (2 * (index / half[1]), 2 * (index % half[1]));
            let (below, right) = ((row + 1).min(height - 1), (column + 1).min(width - 1));
            let at = |row: usize, column: usize| plane[row * width + column];
            *value = 0.25 * (at(row, column) + at(row, right) + at(below, column) + at(below, right));
        }
        round_blocks(&mut small, half, &colour);
        for (index, value) in plane.iter_mut().enumerate() {
            *value = small[index / width / 2 * half[1] + index % width / 2];
        }
    }
    for (pixel, values) in rgb.chunks_exact_mut(3).enumerate() {
        let [y, blue, red] = [0, 1, 2].map(|k| planes[k][pixel]);
        let y = y + 128.0;
        let mixed = [
            y + 1.402 * red,
            y - 0.344_136 * blue - 0.714_136 * red,
            y + 1.772 * blue,
        ];
        for (value, mixed) in values.iter_mut().zip(mixed) {
            *value = (mixed + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

/// Rounds a plane block by block in its cosine transform; at the borders blocks repeat the last pixels.
fn round_blocks(plane: &mut [f32], [height, width]: [usize; 2], steps: &[f32; 64]) {
    let cosines = cosines();
    let mut block = [0.0f32; 64];
    for top in (0..height).step_by(BLOCK) {
        for left in (0..width).step_by(BLOCK) {
            for (index, value) in block.iter_mut().enumerate() {
                let row = (top + index / BLOCK).min(height - 1);
                let column = (left + index % BLOCK).min(width - 1);
                *value = plane[row * width + column];
            }
            let forward = transformed(&transformed(&block, &cosines), &cosines);
            let rounded: [f32; 64] = std::array::from_fn(|k| {
                let steps_of_it = forward[k] / steps[k];
                let whole = (steps_of_it.abs() + 0.5) as i32 as f32;
                whole.copysign(steps_of_it) * steps[k]
            });
            let back: [f32; 64] = std::array::from_fn(|k| cosines[k % BLOCK * BLOCK + k / BLOCK]);
            let restored = transformed(&transformed(&rounded, &back), &back);
            for (index, value) in restored.into_iter().enumerate() {
                let (row, column) = (top + index / BLOCK, left + index % BLOCK);
                if row < height && column < width {
                    plane[row * width + column] = value;
                }
            }
        }
    }
}

/// `(M B)` transposed for a block B, so that two of them are `M B M^T`.
fn transformed(block: &[f32; 64], matrix: &[f32; 64]) -> [f32; 64] {
    let mut out = [0.0f32; 64];
    for (row, weights) in matrix.as_chunks::<BLOCK>().0.iter().enumerate() {
        let mut sums = [0.0f32; BLOCK];
        for (weight, line) in weights.iter().zip(block.as_chunks::<BLOCK>().0) {
            for (sum, value) in sums.iter_mut().zip(line) {
                *sum += weight * value;
            }
        }
        for (column, sum) in sums.into_iter().enumerate() {
            out[column * BLOCK + row] = sum;
        }
    }
    out
}

/// Rows are the orthonormal cosines.
fn cosines() -> [f32; 64] {
    std::array::from_fn(|k| {
        let (frequency, place) = ((k / BLOCK) as f64, (k % BLOCK) as f64);
        let norm = if frequency == 0.0 { 0.125 } else { 0.25 };
        let angle = (place + 0.5) * frequency * std::f64::consts::PI / BLOCK as f64;
        (libm::sqrt(norm) * libm::cos(angle)) as f32
    })
}

/// ITU-T T.81, table K.1.
const BRIGHTNESS_STEPS: [u8; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51,
    87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78, 87, 103, 121, 120, 101,
    72, 92, 95, 98, 112, 100, 103, 99,
];

/// ITU-T T.81, table K.2.
const COLOUR_STEPS: [u8; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99, 47, 66, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_mean_zero_and_deviation_one() {
        let values: Vec<f32> = (0..20_000).flat_map(|pixel| pixel_noise(7, pixel)).collect();
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>() / values.len() as f32;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
    }

    #[test]
    fn a_blur_keeps_a_flat_image_and_spreads_a_point() {
        assert_eq!(blurred(&[80; 5 * 4 * 3], 5, 4, [1.5; 2]), vec![80; 5 * 4 * 3]);
        let mut point = vec![0u8; 9 * 9 * 3];
        point[(4 * 9 + 4) * 3] = 255;
        let spread = blurred(&point, 9, 9, [1.0; 2]);
        let at = |x: usize, y: usize| spread[(y * 9 + x) * 3];
        assert!(at(4, 4) < 60 && at(3, 4) > 15 && at(3, 4) == at(4, 3) && at(5, 4) == at(4, 5));
        assert!(spread.iter().skip(1).step_by(3).all(|&green| green == 0));
        let along = blurred(&point, 9, 9, [1.0, 0.0]);
        assert!(along[(4 * 9 + 3) * 3] > 40 && along[(3 * 9 + 4) * 3] == 0);
    }

    /// Of the picture, in levels.
    fn error(quality: f32) -> f64 {
        let [height, width] = [21, 30];
        let mut rgb: Vec<u8> = (0..height * width)
            .flat_map(|k| {
                let (x, y) = ((k % width) as f64, (k / width) as f64);
                [0.5, 0.9, 1.3].map(|f| (128.0 + 70.0 * libm::sin(0.6 * x * f) * libm::cos(0.4 * y)) as u8)
            })
            .collect();
        let before = rgb.clone();
        compress(&mut rgb, [height, width], quality);
        let square = |(a, b): (&u8, &u8)| f64::from(a.abs_diff(*b)).powi(2);
        libm::sqrt(before.iter().zip(&rgb).map(square).sum::<f64>() / rgb.len() as f64)
    }

    #[test]
    fn compression_costs_more_the_lower_its_quality() {
        let errors = [95.0, 60.0, 20.0].map(error);
        assert!(
            errors[0] > 0.3 && errors[0] < errors[1] && errors[1] < errors[2],
            "{errors:?}"
        );
        assert!(errors[2] < 40.0, "{errors:?}");
        let mut grey = vec![120u8; 3 * 20 * 20];
        compress(&mut grey, [20, 20], 80.0);
        assert!(grey.iter().all(|value| value.abs_diff(120) <= 2));
    }

    #[test]
    fn the_transform_is_orthonormal() {
        let cosines = cosines();
        for a in 0..BLOCK {
            for b in 0..BLOCK {
                let dot: f32 = (0..BLOCK)
                    .map(|k| cosines[a * BLOCK + k] * cosines[b * BLOCK + k])
                    .sum();
                assert!((dot - f32::from(u8::from(a == b))).abs() < 1e-6);
            }
        }
    }
}
