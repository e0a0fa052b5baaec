//! Maximum pooling of maps with channels last.

use rayon::prelude::*;

use crate::{FeatureMap, vectorised};

/// Rows of the output that one piece of work pools.
const ROWS: usize = 2;

/// The maximum over square windows; what lies outside of the map does not count.
#[derive(Debug, Clone, Copy)]
pub struct MaxPool {
    size: usize,
    stride: usize,
    padding: usize,
}

impl MaxPool {
    /// 2x2, stride 2; an odd last row or column is dropped.
    pub const HALVES: Self = Self {
        size: 2,
        stride: 2,
        padding: 0,
    };
    /// 3x3, stride 2, padding 1.
    pub const OVERLAPPING: Self = Self {
        size: 3,
        stride: 2,
        padding: 1,
    };

    /// The pooled map.
    #[must_use]
    pub fn forward(self, map: &FeatureMap) -> FeatureMap {
        let [height, width] = self.output_size([map.height, map.width]);
        let mut out = FeatureMap::zeros(height, width, map.channels);
        self.run(&map.data, [map.height, map.width], map.channels, &mut out.data);
        out
    }

    /// Rows and columns of the pooled map.
    #[must_use]
    pub fn output_size(self, size: [usize; 2]) -> [usize; 2] {
        size.map(|n| (n + 2 * self.padding - self.size) / self.stride + 1)
    }

    /// Pools a map into `out`. `map [height, width, channels]`, `out [height', width', channels]`
    pub fn run(self, map: &[f32], [height, width]: [usize; 2], channels: usize, out: &mut [f32]) {
        let line = self.output_size([height, width])[1] * channels;
        // Places of a window along one axis, as far as the map has them.
        let window = |place: usize, count: usize| {
            let first = place * self.stride;
            first.saturating_sub(self.padding)..(first + self.size - self.padding).min(count)
        };
        out.par_chunks_mut(ROWS * line).enumerate().for_each(|(piece, out)| {
            vectorised(
                #[inline(always)]
                || {
                    for (row, out) in (piece * ROWS..).zip(out.chunks_exact_mut(line)) {
                        for (column, pixel) in out.chunks_exact_mut(channels).enumerate() {
                            pixel.fill(f32::NEG_INFINITY);
                            for y in window(row, height) {
                                for x in window(column, width) {
                                    let source = &map[(y * width + x) * channels..][..channels];
                                    for (best, &value) in pixel.iter_mut().zip(source) {
                                        *best = best.max(value);
                                    }
                                }
                            }
                        }
                    }
                },
            );
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_maximum_of_the_window_is_taken() {
        let map = FeatureMap {
            height: 3,
            width: 4,
            channels: 1,
            data: (0..12).map(|i| -(i as f32)).collect(),
        };
        assert_eq!(MaxPool::OVERLAPPING.forward(&map).data, vec![0.0, -1.0, -4.0, -5.0]);
        assert_eq!(MaxPool::HALVES.forward(&map).data, vec![0.0, -2.0]);
    }
}
