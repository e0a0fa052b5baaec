//! Features divided by their length, and the weighted distances of them.

use rayon::prelude::*;
use rogs_kernels::vectorised;

use crate::trunk::Maps;

/// Added to the length a feature vector is divided by.
pub(super) const LENGTH_FLOOR: f32 = 1e-10;
/// Channels that are summed side by side.
const LANES: usize = 32;

/// Features of every pixel divided by their length. `[height, width, channels]`
pub(super) fn normalised(maps: &Maps) -> Vec<f32> {
    let mut scaled = vec![0.0; maps.values().len()];
    let line = maps.width * maps.channels;
    scaled
        .par_chunks_exact_mut(line)
        .zip(maps.values().par_chunks_exact(line))
        .for_each(|(scaled, values)| {
            vectorised(
                #[inline(always)]
                || {
                    let pixels = values.chunks_exact(maps.channels);
                    for (scaled, values) in scaled.chunks_exact_mut(maps.channels).zip(pixels) {
                        let inverse = inverse_length(values);
                        for (scaled, value) in scaled.iter_mut().zip(values) {
                            *scaled = value * inverse;
                        }
                    }
                },
            );
        });
    scaled
}

/// Mean over pixels of the weighted squared difference of a layer's features, divided by their length here, from kept
/// ones.
pub(super) fn distance_of(maps: &Maps, kept: &[f32], head: &[f32]) -> f64 {
    distance(maps.values(), kept, maps.width, head, inverse_length)
}

/// The same of two kept layers, rows of `width` pixels.
pub(super) fn distance_between(a: &[f32], b: &[f32], width: usize, head: &[f32]) -> f64 {
    distance(
        a,
        b,
        width,
        head,
        #[inline(always)]
        |_| 1.0,
    )
}

/// The distance of maps whose first is multiplied, pixel by pixel, by what `scale` says of its features.
fn distance(a: &[f32], b: &[f32], width: usize, head: &[f32], scale: impl Fn(&[f32]) -> f32 + Sync) -> f64 {
    let (channels, line) = (head.len(), head.len() * width);
    let rows: Vec<f64> = a
        .par_chunks_exact(line)
        .zip(b.par_chunks_exact(line))
        .map(|(a, b)| {
            let mut sums = vec![0.0f32; channels];
            vectorised(
                #[inline(always)]
                || {
                    for (a, b) in a.chunks_exact(channels).zip(b.chunks_exact(channels)) {
                        let scale = scale(a);
                        for ((sum, weight), (a, b)) in sums.iter_mut().zip(head).zip(a.iter().zip(b)) {
                            let difference = a * scale - b;
                            *sum += weight * (difference * difference);
                        }
                    }
                },
            );
            let part = |sums: &[f32]| -> f64 { sums.iter().map(|&sum| f64::from(sum)).sum() };
            sums.chunks(LANES).map(part).sum()
        })
        .collect();
    rows.iter().sum::<f64>() / (a.len() / channels.max(1)) as f64
}

/// One over the length of the features of a pixel.
#[inline(always)]
fn inverse_length(values: &[f32]) -> f32 {
    let mut sums = [0.0f32; LANES];
    let (whole, rest) = values.as_chunks::<LANES>();
    for values in whole {
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum += value * value;
        }
    }
    for (sum, value) in sums.iter_mut().zip(rest) {
        *sum += value * value;
    }
    let mut count = LANES;
    while count > 1 {
        count /= 2;
        for lane in 0..count {
            sums[lane] += sums[lane + count];
        }
    }
    1.0 / (sums[0].sqrt() + LENGTH_FLOOR)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_have_length_one_and_empty_ones_stay_empty() {
        let mut pixel = vec![0.0f32; 40];
        (pixel[0], pixel[35]) = (3.0, 4.0);
        let maps = Maps::of([1, 2], 40, [vec![0.0; 40], pixel.clone()].concat());
        let scaled = normalised(&maps);
        assert_eq!(scaled[..40], [0.0; 40]);
        assert_eq!((scaled[40], scaled[75]), (0.6, 0.8));
        let head = vec![2.0; 40];
        let expected = distance_between(&scaled, &[0.0; 80], 2, &head);
        assert_eq!(distance_of(&maps, &[0.0; 80], &head), expected);
        assert!((expected - 1.0).abs() < 1e-6, "{expected}");
    }
}
