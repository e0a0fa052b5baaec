//! Structural similarity with the 11-tap Gaussian window, in the three variants in use (`docs/spec/scoring.md` section 4).
//!
//! The windowed means of x, y, xy and x^2 + y^2 are all that the index needs (the two variances only occur as a sum), so
//! four maps are filtered instead of five. Rows are filtered with the channels interleaved: a tap of the horizontal pass
//! is three values away, and every loop runs over contiguous memory.

use std::cell::RefCell;

use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::metrics::image::{MetricError, RgbView, fold_lanes, same_size};

const TAPS: usize = 11;
const RADIUS: usize = TAPS / 2;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Output rows of one parallel task. Fixed, because it sets the order of the sum.
const BAND: usize = 24;
/// Filtered maps: x, y, x^2 + y^2, xy.
const MAPS: usize = 4;
const CHANNELS: usize = 3;
/// Output rows that the vertical pass computes together, and the input rows they need.
const GROUP: usize = 4;
const GROUP_ROWS: usize = TAPS + GROUP - 1;
/// Slots of the ring of input rows; at least `GROUP_ROWS`.
const RING: usize = 16;
/// Widest vector of any instruction set, and the number of running sums.
const MAX_LANES: usize = 8;

thread_local! {
    /// Rows of a band. Kept, because fresh memory has to be cleared page by page.
    static BUFFER: RefCell<Vec<f64>> = const { RefCell::new(Vec::new()) };
}

/// Which of the SSIM definitions in use. They differ in the third decimal; a table names the one it holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SsimVariant {
    /// scikit-image with Gaussian weights and its default sample covariance (factor 121/120), mean over the interior.
    /// What the ReSplat and DepthSplat evaluations report, and the default here.
    #[default]
    SkimageSampleCov,
    /// Population covariance, mean over the interior: scikit-image with `use_sample_covariance=False`, pytorch-msssim.
    Skimage,
    /// Population covariance, reflect padding, mean over the whole map: torchmetrics.
    Torchmetrics,
}

impl SsimVariant {
    /// The name stored in result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::SkimageSampleCov => "skimage-sample-cov",
            Self::Skimage => "skimage",
            Self::Torchmetrics => "torchmetrics",
        }
    }

    /// Factor on the covariances.
    fn covariance_factor(self) -> f64 {
        match self {
            Self::SkimageSampleCov => (TAPS * TAPS) as f64 / (TAPS * TAPS - 1) as f64,
            Self::Skimage | Self::Torchmetrics => 1.0,
        }
    }

    /// Pixels of reflect padding on each side.
    fn padding(self) -> usize {
        match self {
            Self::SkimageSampleCov | Self::Skimage => 0,
            Self::Torchmetrics => RADIUS,
        }
    }
}

/// Mean structural similarity of two RGB images (data range 1, K1 = 0.01, K2 = 0.03, sigma 1.5, 11 taps).
///
/// # Errors
/// When the sizes differ or the images are smaller than the window.
pub fn ssim(prediction: &RgbView<'_>, reference: &RgbView<'_>, variant: SsimVariant) -> Result<f64, MetricError> {
    same_size(prediction, reference)?;
    let padding = variant.padding();
    let (height, width) = (prediction.height(), prediction.width());
    let minimum = if padding == 0 { TAPS } else { padding + 1 };
    if height < minimum || width < minimum {
        return Err(MetricError::TooSmall {
            metric: "SSIM",
            height,
            width,
            minimum,
        });
    }
    let plan = Plan {
        prediction,
        reference,
        padding,
        out_height: height + 2 * padding - 2 * RADIUS,
        out_width: width + 2 * padding - 2 * RADIUS,
        factor: variant.covariance_factor(),
        taps: gaussian_taps(),
    };
    let starts: Vec<usize> = (0..plan.out_height).step_by(BAND).collect();
    let arch = pulp::Arch::new();
    let sum = |&start: &usize| {
        BUFFER.with_borrow_mut(|buffer| {
            arch.dispatch(Band {
                plan: &plan,
                start,
                buffer,
            })
        })
    };
    let sums: Vec<f64> = starts.par_iter().map(sum).collect();
    Ok(sums.iter().sum::<f64>() / (plan.out_height * plan.out_width * CHANNELS) as f64)
}

/// The normalised window.
fn gaussian_taps() -> [f64; TAPS] {
    let weights: [f64; TAPS] = std::array::from_fn(|index| {
        let offset = index as f64 - RADIUS as f64;
        libm::exp(-offset * offset / (2.0 * SIGMA * SIGMA))
    });
    let total: f64 = weights.iter().sum();
    weights.map(|weight| weight / total)
}

/// One comparison: the images and the geometry of the map.
struct Plan<'a> {
    prediction: &'a RgbView<'a>,
    reference: &'a RgbView<'a>,
    padding: usize,
    out_height: usize,
    out_width: usize,
    factor: f64,
    taps: [f64; TAPS],
}

/// Some rows of a comparison, in a form that is compiled once for each vector instruction set.
struct Band<'a> {
    plan: &'a Plan<'a>,
    start: usize,
    buffer: &'a mut Vec<f64>,
}

impl WithSimd for Band<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        self.plan.band(simd, self.start, self.buffer)
    }
}

impl Plan<'_> {
    /// Sum of the index over the output rows `start..start + BAND` (or fewer at the end).
    #[inline(always)]
    fn band<S: Simd>(&self, simd: S, start: usize, buffer: &mut Vec<f64>) -> f64 {
        let end = (start + BAND).min(self.out_height);
        let in_row = (self.out_width + 2 * RADIUS) * CHANNELS;
        let out_row = self.out_width * CHANNELS;
        // The horizontal pass reads whole vectors up to its last tap.
        let stride = out_row.next_multiple_of(MAX_LANES) + (2 * RADIUS * CHANNELS).next_multiple_of(MAX_LANES);
        let slot_length = MAPS * stride;
        // What an earlier band left beyond the image only reaches lanes that are not counted.
        let length = (RING + GROUP) * slot_length;
        buffer.resize(buffer.len().max(length), 0.0);
        // [RING, MAPS, stride]: the input rows of the current group of output rows; [GROUP, MAPS, stride].
        let (ring, vertical) = buffer[..length].split_at_mut(RING * slot_length);
        let mut sums = [0.0f64; MAX_LANES];
        let mut loaded = start;
        for first in (start..end).step_by(GROUP) {
            while loaded < first + GROUP_ROWS {
                let slot = loaded % RING * slot_length;
                // Rows past the end belong to output rows that are not used.
                let row = loaded.min(self.out_height + 2 * RADIUS - 1);
                self.load_row(row, in_row, &mut ring[slot..slot + slot_length]);
                loaded += 1;
            }
            // Tap k of output row `first + g` is input row `first + g + k`.
            let rows: [&[f64]; GROUP_ROWS] = std::array::from_fn(|row| {
                let slot = (first + row) % RING * slot_length;
                &ring[slot..slot + slot_length]
            });
            filter_group(simd, &rows, &self.taps, vertical);
            for filtered in vertical.chunks_exact(slot_length).take(end - first) {
                self.accumulate(simd, filtered, out_row, &mut sums);
            }
        }
        fold_lanes(sums)
    }

    /// Loads input row `row` (in padded rows) into the four maps of a ring slot.
    #[inline(always)]
    fn load_row(&self, row: usize, in_row: usize, slot: &mut [f64]) {
        let stride = slot.len() / MAPS;
        let inner = self.prediction.width() * CHANNELS;
        let source = reflect(row as isize - self.padding as isize, self.prediction.height()) * inner;
        let (x, rest) = slot.split_at_mut(stride);
        let (y, rest) = rest.split_at_mut(stride);
        let (squares, products) = rest.split_at_mut(stride);
        let edge = self.padding * CHANNELS;
        self.prediction.load(source, &mut x[edge..edge + inner]);
        self.reference.load(source, &mut y[edge..edge + inner]);
        if self.padding > 0 {
            pad_row(x, self.padding, self.prediction.width());
            pad_row(y, self.padding, self.prediction.width());
        }
        let (x, y, squares, products) = (
            &x[..in_row],
            &y[..in_row],
            &mut squares[..in_row],
            &mut products[..in_row],
        );
        for index in 0..in_row {
            squares[index] = x[index] * x[index] + y[index] * y[index];
            products[index] = x[index] * y[index];
        }
    }

    /// Filters one row of the four maps, already filtered downwards, and adds its `length` indices to eight running sums.
    #[inline(always)]
    fn accumulate<S: Simd>(&self, simd: S, maps: &[f64], length: usize, sums: &mut [f64; MAX_LANES]) {
        let parts = MAX_LANES / S::F64_LANES;
        let stride = maps.len() / MAPS;
        let taps = self.taps.map(|tap| simd.splat_f64s(tap));
        let number = |value: f64| simd.splat_f64s(value);
        let (c1, c2, factor) = (number(C1), number(C2), number(self.factor));
        let mut running = [number(0.0); MAX_LANES];
        for (part, sums) in S::as_simd_f64s(&sums[..]).0.iter().enumerate() {
            running[part] = *sums;
        }
        let mut last = [0.0f64; MAX_LANES];
        for start in (0..length).step_by(MAX_LANES) {
            for part in 0..parts {
                let at = start + part * S::F64_LANES;
                let map = |map: usize| &maps[map * stride + at..];
                let (x, y) = (filtered(simd, map(0), &taps), filtered(simd, map(1), &taps));
                let (squares, products) = (filtered(simd, map(2), &taps), filtered(simd, map(3), &taps));
                let mean_product = simd.mul_f64s(x, y);
                let mean_squares = simd.mul_add_f64s(x, x, simd.mul_f64s(y, y));
                let covariance = simd.mul_f64s(factor, simd.sub_f64s(products, mean_product));
                let variances = simd.mul_f64s(factor, simd.sub_f64s(squares, mean_squares));
                let twice = |value| simd.add_f64s(value, value);
                let above = simd.mul_f64s(
                    simd.add_f64s(twice(mean_product), c1),
                    simd.add_f64s(twice(covariance), c2),
                );
                let below = simd.mul_f64s(simd.add_f64s(mean_squares, c1), simd.add_f64s(variances, c2));
                let index = simd.div_f64s(above, below);
                if start + MAX_LANES <= length {
                    running[part] = simd.add_f64s(running[part], index);
                } else {
                    S::as_mut_simd_f64s(&mut last[..]).0[part] = index;
                }
            }
        }
        for (part, sums) in S::as_mut_simd_f64s(&mut sums[..]).0.iter_mut().enumerate() {
            *sums = running[part];
        }
        for (sum, index) in sums.iter_mut().zip(&last).take(length % MAX_LANES) {
            *sum += index;
        }
    }
}

/// The vertical pass for [`GROUP`] output rows at once, so that each input value is loaded once for all of them:
/// `out[g][j] = sum_k taps[k] * rows[g + k][j]`, taps in order. `out` is `[GROUP, length]`.
#[inline(always)]
fn filter_group<S: Simd>(simd: S, rows: &[&[f64]; GROUP_ROWS], taps: &[f64; TAPS], out: &mut [f64]) {
    let length = rows[0].len();
    let rows: [&[S::f64s]; GROUP_ROWS] = std::array::from_fn(|row| S::as_simd_f64s(&rows[row][..length]).0);
    let (out0, rest) = out.split_at_mut(length);
    let (out1, rest) = rest.split_at_mut(length);
    let (out2, out3) = rest.split_at_mut(length);
    let out = [out0, out1, out2, out3].map(|out| S::as_mut_simd_f64s(out).0);
    let taps = taps.map(|tap| simd.splat_f64s(tap));
    let vectors = rows[0].len();
    let rows: [&[S::f64s]; GROUP_ROWS] = std::array::from_fn(|row| &rows[row][..vectors]);
    let [out0, out1, out2, out3] = out.map(|out| &mut out[..vectors]);
    for at in 0..vectors {
        let values: [S::f64s; GROUP_ROWS] = std::array::from_fn(|row| rows[row][at]);
        out0[at] = weighted(simd, &values, 0, &taps);
        out1[at] = weighted(simd, &values, 1, &taps);
        out2[at] = weighted(simd, &values, 2, &taps);
        out3[at] = weighted(simd, &values, 3, &taps);
    }
}

/// The eleven values from `first` on, weighted by the taps, taps in order.
#[inline(always)]
fn weighted<S: Simd>(simd: S, values: &[S::f64s; GROUP_ROWS], first: usize, taps: &[S::f64s; TAPS]) -> S::f64s {
    let mut sum = simd.mul_f64s(taps[0], values[first]);
    for tap in 1..TAPS {
        sum = simd.mul_add_f64s(taps[tap], values[first + tap], sum);
    }
    sum
}

/// The horizontal pass for one vector: `sum_k taps[k] * line[j + 3 k]`, taps in order.
#[inline(always)]
fn filtered<S: Simd>(simd: S, line: &[f64], taps: &[S::f64s; TAPS]) -> S::f64s {
    let line = &line[..(TAPS - 1) * CHANNELS + S::F64_LANES];
    let tap = |tap: usize| S::as_simd_f64s(&line[tap * CHANNELS..tap * CHANNELS + S::F64_LANES]).0[0];
    let mut sum = simd.mul_f64s(taps[0], tap(0));
    for index in 1..TAPS {
        sum = simd.mul_add_f64s(taps[index], tap(index), sum);
    }
    sum
}

/// Reflection without repeating the edge pixel: -1 is 1, `length` is `length - 2`.
#[inline(always)]
fn reflect(index: isize, length: usize) -> usize {
    let last = length as isize - 1;
    let folded = if index < 0 { -index } else { index };
    (if folded > last { 2 * last - folded } else { folded }) as usize
}

/// Fills the `padding` pixels on both sides of a row of `width` pixels by reflection.
fn pad_row(row: &mut [f64], padding: usize, width: usize) {
    for pixel in (0..padding).chain(padding + width..width + 2 * padding) {
        let source = padding + reflect(pixel as isize - padding as isize, width);
        row.copy_within(source * CHANNELS..(source + 1) * CHANNELS, pixel * CHANNELS);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::image::Pixels;

    const ALL: [SsimVariant; 3] = [
        SsimVariant::SkimageSampleCov,
        SsimVariant::Skimage,
        SsimVariant::Torchmetrics,
    ];

    #[test]
    fn an_image_is_similar_to_itself() {
        let data: Vec<u8> = (0..20 * 23 * 3).map(|index| (index * 37 % 251) as u8).collect();
        let view = RgbView::new(20, 23, Pixels::Bytes(&data)).unwrap();
        for variant in ALL {
            assert!((ssim(&view, &view, variant).unwrap() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn too_small_images_are_refused() {
        let data = vec![0u8; 10 * 30 * 3];
        let view = RgbView::new(10, 30, Pixels::Bytes(&data)).unwrap();
        assert!(matches!(
            ssim(&view, &view, SsimVariant::Skimage),
            Err(MetricError::TooSmall { minimum: 11, .. })
        ));
        assert!(ssim(&view, &view, SsimVariant::Torchmetrics).is_ok());
    }

    #[test]
    fn padding_reflects_without_repeating_the_edge() {
        assert_eq!([-2, -1, 0, 3, 4, 5].map(|index| reflect(index, 4)), [2, 1, 0, 3, 2, 1]);
    }

    /// The definition, window by window.
    #[test]
    fn agrees_with_the_double_loop() {
        let (height, width) = (13, 15);
        let a: Vec<f32> = (0..height * width * 3)
            .map(|index| (index * 31 % 97) as f32 / 96.0)
            .collect();
        let b: Vec<f32> = (0..height * width * 3)
            .map(|index| (index * 17 % 89) as f32 / 88.0)
            .collect();
        let taps = gaussian_taps();
        let mut total = 0.0;
        for channel in 0..3 {
            for row in 0..height - 10 {
                for column in 0..width - 10 {
                    let mut m = [0.0f64; 5];
                    for (i, &wi) in taps.iter().enumerate() {
                        for (j, &wj) in taps.iter().enumerate() {
                            let at = ((row + i) * width + column + j) * 3 + channel;
                            let (x, y) = (f64::from(a[at]), f64::from(b[at]));
                            for (m, v) in m.iter_mut().zip([x, y, x * x, y * y, x * y]) {
                                *m += wi * wj * v;
                            }
                        }
                    }
                    let [x, y, xx, yy, xy] = m;
                    total += (2.0 * x * y + C1) * (2.0 * (xy - x * y) + C2)
                        / ((x * x + y * y + C1) * (xx - x * x + yy - y * y + C2));
                }
            }
        }
        let expected = total / (3 * (height - 10) * (width - 10)) as f64;
        let a = RgbView::new(height, width, Pixels::Unit(&a)).unwrap();
        let b = RgbView::new(height, width, Pixels::Unit(&b)).unwrap();
        assert!((ssim(&a, &b, SsimVariant::Skimage).unwrap() - expected).abs() < 1e-12);
    }

    #[test]
    fn one_and_two_threads_give_the_same_bits() {
        let a: Vec<u8> = (0..154 * 280 * 3u64).map(|index| (index * 7919 % 256) as u8).collect();
        let b: Vec<u8> = (0..154 * 280 * 3u64)
            .map(|index| (index * 104_729 % 256) as u8)
            .collect();
        let (a, b) = (
            RgbView::new(154, 280, Pixels::Bytes(&a)).unwrap(),
            RgbView::new(154, 280, Pixels::Bytes(&b)).unwrap(),
        );
        let bits = [1, 2, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| ssim(&a, &b, SsimVariant::default()).unwrap().to_bits())
        });
        assert!(bits.iter().all(|&value| value == bits[0]));
    }
}
