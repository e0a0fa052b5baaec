//! What is read of the maps: pooling, features divided by their length, weighted distances.

use rayon::prelude::*;

use crate::filtering::Scratch;
use crate::maps::{Maps, PANEL, Pixel};
use rogs_kernels::vectorised;

/// Added to the length a feature vector is divided by.
pub(super) const LENGTH_FLOOR: f32 = 1e-10;
/// Rows of the output that one piece of work pools.
const POOLED_ROWS: usize = 2;

/// 2x2 maximum with stride 2; an odd last row or column is dropped.
pub(super) fn max_pool(input: &Maps, output: &mut Maps) {
    output.reshape(input.panels, input.height / 2, input.width / 2);
    let (width, columns) = (output.width, output.columns);
    let bands = output.bands(POOLED_ROWS);
    bands.into_par_iter().enumerate().for_each(|(index, mut band)| {
        for (panel, rows) in band.iter_mut().enumerate() {
            let first = index * POOLED_ROWS;
            let own = rows
                .chunks_mut(columns)
                .zip(first..(first + POOLED_ROWS).min(input.height / 2));
            for (out, row) in own {
                let (upper, lower) = (input.row(panel, 2 * row), input.row(panel, 2 * row + 1));
                let out = &mut out[1..=width];
                vectorised(
                    #[inline(always)]
                    || {
                        let (upper, lower) = (upper.as_chunks::<2>().0, lower.as_chunks::<2>().0);
                        for (out, (upper, lower)) in out.iter_mut().zip(upper.iter().zip(lower)) {
                            for lane in 0..PANEL {
                                let above = upper[0].0[lane].max(upper[1].0[lane]);
                                out.0[lane] = above.max(lower[0].0[lane].max(lower[1].0[lane]));
                            }
                        }
                    },
                );
            }
        }
    });
}

/// Features of every pixel divided by their length. `[height][panels][width]`
pub(super) fn normalised(maps: &Maps, scratch: &Scratch) -> Vec<Pixel> {
    let mut scaled = vec![Pixel::ZERO; maps.height * maps.panels * maps.width];
    scaled
        .par_chunks_exact_mut(maps.panels * maps.width)
        .enumerate()
        .for_each(|(row, scaled)| {
            scratch.lend(maps.width, |lengths| {
                inverse_lengths(maps, row, lengths);
                for (panel, scaled) in scaled.chunks_exact_mut(maps.width).enumerate() {
                    let (values, lengths) = (maps.row(panel, row), &*lengths);
                    vectorised(
                        #[inline(always)]
                        || {
                            for ((scaled, value), length) in scaled.iter_mut().zip(values).zip(lengths) {
                                for lane in 0..PANEL {
                                    scaled.0[lane] = value.0[lane] * length.0[0];
                                }
                            }
                        },
                    );
                }
            });
        });
    scaled
}

/// Mean over pixels of the weighted squared difference of a layer's features, divided by their length here, from kept
/// ones.
pub(super) fn distance_of(maps: &Maps, kept: &[Pixel], head: &[Pixel], scratch: &Scratch) -> f64 {
    let rows: Vec<f64> = kept
        .par_chunks_exact(maps.panels * maps.width)
        .enumerate()
        .map(|(row, kept)| {
            scratch.lend(maps.width, |lengths| {
                inverse_lengths(maps, row, lengths);
                let mut total = 0.0;
                let by_panel = kept.chunks_exact(maps.width).zip(head).enumerate();
                for (panel, (kept, head)) in by_panel {
                    let (values, lengths) = (maps.row(panel, row), &*lengths);
                    let mut sums = Pixel::ZERO;
                    vectorised(
                        #[inline(always)]
                        || {
                            for ((kept, value), length) in kept.iter().zip(values).zip(lengths) {
                                for lane in 0..PANEL {
                                    let difference = value.0[lane] * length.0[0] - kept.0[lane];
                                    sums.0[lane] += head.0[lane] * (difference * difference);
                                }
                            }
                        },
                    );
                    total += folded(&sums);
                }
                total
            })
        })
        .collect();
    rows.iter().sum::<f64>() / (maps.height * maps.width) as f64
}

/// The same of two kept layers, rows of `width` pixels.
pub(super) fn distance_between(a: &[Pixel], b: &[Pixel], width: usize, head: &[Pixel]) -> f64 {
    let line = head.len() * width;
    let rows: Vec<f64> = a
        .par_chunks_exact(line)
        .zip(b.par_chunks_exact(line))
        .map(|(a, b)| {
            let mut total = 0.0;
            for ((a, b), head) in a.chunks_exact(width).zip(b.chunks_exact(width)).zip(head) {
                let mut sums = Pixel::ZERO;
                vectorised(
                    #[inline(always)]
                    || {
                        for (a, b) in a.iter().zip(b) {
                            for lane in 0..PANEL {
                                let difference = a.0[lane] - b.0[lane];
                                sums.0[lane] += head.0[lane] * (difference * difference);
                            }
                        }
                    },
                );
                total += folded(&sums);
            }
            total
        })
        .collect();
    rows.iter().sum::<f64>() / (a.len() / head.len().max(1)) as f64
}

/// One over the length of the features of each pixel of a row, in the first lane.
fn inverse_lengths(maps: &Maps, row: usize, lengths: &mut [Pixel]) {
    lengths.fill(Pixel::ZERO);
    for panel in 0..maps.panels {
        let values = maps.row(panel, row);
        vectorised(
            #[inline(always)]
            || {
                for (length, value) in lengths.iter_mut().zip(values) {
                    for lane in 0..PANEL {
                        length.0[lane] += value.0[lane] * value.0[lane];
                    }
                }
            },
        );
    }
    for length in lengths {
        let mut sums = length.0;
        let mut count = PANEL;
        while count > 1 {
            count /= 2;
            for lane in 0..count {
                sums[lane] += sums[lane + count];
            }
        }
        length.0[0] = 1.0 / (sums[0].sqrt() + LENGTH_FLOOR);
    }
}

fn folded(sums: &Pixel) -> f64 {
    sums.0.iter().map(|&sum| f64::from(sum)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One channel, as a map.
    fn map(values: &[f32], height: usize, width: usize) -> Maps {
        let mut maps = Maps::default();
        maps.reshape(1, height, width);
        for (row, mut band) in maps.bands(1).into_iter().enumerate() {
            for (column, pixel) in band[0][1..=width].iter_mut().enumerate() {
                *pixel = Pixel::ZERO;
                pixel.0[0] = values[row * width + column];
            }
        }
        maps
    }

    #[test]
    fn pooling_drops_an_odd_last_row_and_column() {
        let mut pooled = Maps::default();
        max_pool(&map(&[1.0, 2.0, 9.0, 4.0, 3.0, 9.0, 9.0, 9.0, 9.0], 3, 3), &mut pooled);
        assert_eq!((pooled.height, pooled.width), (1, 1));
        assert_eq!(pooled.row(0, 0)[0].0[0], 4.0);
    }

    #[test]
    fn features_have_length_one_and_empty_ones_stay_empty() {
        let mut maps = map(&[0.0, 3.0], 1, 2);
        maps.bands(1)[0][0][2].0[31] = 4.0;
        let scaled = normalised(&maps, &Scratch::default());
        assert_eq!(scaled[0], Pixel::ZERO);
        assert_eq!((scaled[1].0[0], scaled[1].0[31]), (0.6, 0.8));
    }
}
