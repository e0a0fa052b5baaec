//! Feature maps with channels last, and bilinear resizing.

use rayon::prelude::*;

use crate::Axis;

/// A feature map. `[height, width, channels]`
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureMap {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Channels.
    pub channels: usize,
    /// Values, row-major, channels last.
    pub data: Vec<f32>,
}

impl FeatureMap {
    /// A map of zeros.
    #[must_use]
    pub fn zeros(height: usize, width: usize, channels: usize) -> Self {
        Self {
            height,
            width,
            channels,
            data: vec![0.0; height * width * channels],
        }
    }

    /// The difference `self - other` of two maps of one shape.
    #[must_use]
    pub fn minus(&self, other: &Self) -> Self {
        let data = self.data.iter().zip(&other.data).map(|(a, b)| a - b).collect();
        Self { data, ..*self }
    }

    /// The map resized bilinearly with aligned corners; a copy when it has that size already.
    #[must_use]
    pub fn resized(&self, height: usize, width: usize) -> Self {
        let mut out = Self::zeros(height, width, self.channels);
        add_resized(self, height, width, &mut out.data, self.channels, 0);
        out
    }
}

/// Adds `map`, resized bilinearly (corners aligned) to `height x width`, to the channels from `offset` on of rows with
/// `stride` channels each. `out` is `[height * width, stride]`
pub fn add_resized(map: &FeatureMap, height: usize, width: usize, out: &mut [f32], stride: usize, offset: usize) {
    let channels = map.channels;
    let (rows, columns) = (Axis::new(map.height, height), Axis::new(map.width, width));
    out.par_chunks_mut(width * stride).enumerate().for_each(|(row, out)| {
        let (top, down) = rows.taps[row];
        let bottom = rows.second(top);
        for (&(left, across), out) in columns.taps.iter().zip(out.chunks_exact_mut(stride)) {
            let right = columns.second(left);
            let pixel = |r: usize, c: usize| &map.data[(r * map.width + c) * channels..][..channels];
            let (a, b, c, d) = (
                pixel(top, left),
                pixel(top, right),
                pixel(bottom, left),
                pixel(bottom, right),
            );
            let weights = [
                (1.0 - down) * (1.0 - across),
                (1.0 - down) * across,
                down * (1.0 - across),
                down * across,
            ];
            for (channel, out) in out[offset..offset + channels].iter_mut().enumerate() {
                *out += weights[0] * a[channel]
                    + weights[1] * b[channel]
                    + weights[2] * c[channel]
                    + weights[3] * d[channel];
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resizing_keeps_corners_and_linear_ramps() {
        let data = (0..6).flat_map(|i| [i as f32, -(i as f32)]).collect();
        let map = FeatureMap {
            height: 2,
            width: 3,
            channels: 2,
            data,
        };
        let large = map.resized(3, 5);
        // value(row, column) = 3 row / 2 + column / 2 on the finer grid
        for row in 0..3 {
            for column in 0..5 {
                let expected = 1.5 * row as f32 + 0.5 * column as f32;
                assert!((large.data[(row * 5 + column) * 2] - expected).abs() < 1e-6);
                assert!((large.data[(row * 5 + column) * 2 + 1] + expected).abs() < 1e-6);
            }
        }
        assert_eq!(map.resized(2, 3), map);
    }
}
