//! Bringing images to the clip's size (`docs/spec/stage1.md` section 2): scale, cut at the centre, intrinsics follow.

use rogs_kernels::cubic_taps;
use rogs_schemas::Intrinsics;

use crate::params::Fit;

/// How images of one size become images of another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mapping {
    /// Recorded size, `(width, height)`.
    source: (usize, usize),
    /// Size after scaling.
    scaled: (usize, usize),
    /// Pixels cut off at the left and at the top.
    offset: (usize, usize),
    /// Size after cutting.
    target: (usize, usize),
}

impl Mapping {
    /// From a recorded size `(width, height)` to a target size.
    pub(crate) fn new(source: (u32, u32), target: (u32, u32), fit: Fit) -> Self {
        let pair = |(a, b): (u32, u32)| (a as usize, b as usize);
        let scaled = match fit {
            Fit::Stretch => pair(target),
            Fit::Cover => {
                let ratio = |target: u32, source: u32| f64::from(target) / f64::from(source);
                let factor = ratio(target.0, source.0).max(ratio(target.1, source.1));
                let side =
                    |source: u32, target: u32| ((f64::from(source) * factor).round() as usize).max(target as usize);
                (side(source.0, target.0), side(source.1, target.1))
            }
        };
        let target = pair(target);
        let offset = ((scaled.0 - target.0) / 2, (scaled.1 - target.1) / 2);
        Self {
            source: pair(source),
            scaled,
            offset,
            target,
        }
    }

    /// The same part of the view from images of another size, which show all of it as well: a model's frames of a camera
    /// are its recorded ones scaled along each axis.
    pub(crate) fn of_size(self, source: (u32, u32)) -> Self {
        Self {
            source: (source.0 as usize, source.1 as usize),
            ..self
        }
    }

    /// Scale along x and y.
    fn scale(&self) -> (f64, f64) {
        (
            self.scaled.0 as f64 / self.source.0 as f64,
            self.scaled.1 as f64 / self.source.1 as f64,
        )
    }

    /// The intrinsics of the target image. Pixel centres at + 0.5, so that scaling is linear.
    pub(crate) fn intrinsics(&self, recorded: Intrinsics) -> Intrinsics {
        let (sx, sy) = self.scale();
        let (cx, cy) = self.point([recorded.cx, recorded.cy]).into();
        Intrinsics {
            fx: recorded.fx * sx,
            fy: recorded.fy * sy,
            cx,
            cy,
        }
    }

    /// Where an image point goes; pixel centres at + 0.5 on both sides.
    pub(crate) fn point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sx, sy) = self.scale();
        [x * sx - self.offset.0 as f64, y * sy - self.offset.1 as f64]
    }

    /// The target image of a recorded one, bicubic with antialiasing. `[h, w, 3]` to `[H, W, 3]`
    pub(crate) fn rgb(&self, image: &[u8]) -> Vec<u8> {
        if self.scaled == self.source && self.target == self.source {
            return image.to_vec();
        }
        let columns = cubic_taps::<f64>(self.source.0, self.scaled.0, self.offset.0, self.target.0);
        let rows = cubic_taps::<f64>(self.source.1, self.scaled.1, self.offset.1, self.target.1);
        let (width, target_width) = (self.source.0, self.target.0);
        // Horizontal pass over the rows that are needed, then vertical.
        let first = rows.iter().map(|taps| taps.start).min().unwrap_or(0);
        let last = rows
            .iter()
            .map(|taps| taps.start + taps.weights.len())
            .max()
            .unwrap_or(0);
        let mut wide = vec![0.0f32; (last - first) * target_width * 3];
        for (row, line) in (first..last).zip(wide.chunks_exact_mut(target_width * 3)) {
            let pixels = &image[row * width * 3..(row + 1) * width * 3];
            for (taps, out) in columns.iter().zip(line.chunks_exact_mut(3)) {
                for (weight, pixel) in taps.weights.iter().zip(pixels[taps.start * 3..].chunks_exact(3)) {
                    for channel in 0..3 {
                        out[channel] += weight * f32::from(pixel[channel]);
                    }
                }
            }
        }
        let mut result = Vec::with_capacity(self.target.1 * target_width * 3);
        let mut sums = vec![0.0f32; target_width * 3];
        for taps in &rows {
            sums.fill(0.0);
            for (weight, line) in taps
                .weights
                .iter()
                .zip(wide[(taps.start - first) * target_width * 3..].chunks_exact(target_width * 3))
            {
                for (sum, value) in sums.iter_mut().zip(line) {
                    *sum += weight * value;
                }
            }
            result.extend(sums.iter().map(|sum| (sum + 0.5).clamp(0.0, 255.0) as u8));
        }
        result
    }

    /// The target map of a recorded one, nearest sample (depth is never averaged across edges). `[h, w]` to `[H, W]`
    pub(crate) fn nearest(&self, map: &[f32]) -> Vec<f32> {
        let sample = |index: usize, offset: usize, source: usize, scaled: usize| {
            let centre = (index + offset) as f64 + 0.5;
            ((centre * source as f64 / scaled as f64) as usize).min(source - 1)
        };
        let column = |x| sample(x, self.offset.0, self.source.0, self.scaled.0);
        let columns: Vec<usize> = (0..self.target.0).map(column).collect();
        let row = |y| sample(y, self.offset.1, self.source.1, self.scaled.1) * self.source.0;
        (0..self.target.1)
            .map(row)
            .flat_map(|start| columns.iter().map(move |column| map[start + column]))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn droid_frames_scale_purely_and_others_are_cut() {
        let pure = Mapping::new((640, 352), (280, 154), Fit::Cover);
        assert_eq!((pure.scaled, pure.offset), ((280, 154), (0, 0)));
        let cut = Mapping::new((320, 192), (280, 154), Fit::Cover);
        assert_eq!((cut.scaled, cut.offset), ((280, 168), (0, 7)));
        let intrinsics = cut.intrinsics(Intrinsics {
            fx: 133.0,
            fy: 142.0,
            cx: 160.5,
            cy: 96.5,
        });
        assert_eq!((intrinsics.fx, intrinsics.fy), (133.0 * 0.875, 142.0 * 0.875));
        assert_eq!((intrinsics.cx, intrinsics.cy), (160.5 * 0.875, 96.5 * 0.875 - 7.0));
        let stretched = Mapping::new((320, 192), (280, 154), Fit::Stretch);
        assert_eq!((stretched.scaled, stretched.offset), ((280, 154), (0, 0)));
    }

    #[test]
    fn a_gradient_stays_a_gradient_and_a_flat_image_flat() {
        let flat = vec![77; 40 * 24 * 3];
        assert!(
            Mapping::new((40, 24), (28, 15), Fit::Cover)
                .rgb(&flat)
                .iter()
                .all(|&value| value == 77)
        );
        let ramp: Vec<u8> = (0..24).flat_map(|_| (0..40).flat_map(|x| [(6 * x) as u8; 3])).collect();
        let mapping = Mapping::new((40, 24), (20, 12), Fit::Cover);
        let half = mapping.rgb(&ramp);
        for x in 4..16 {
            // The centre of output pixel x is at 2x + 1 in the input, half way between columns 2x and 2x + 1.
            let expected = 6.0 * (2.0 * x as f64 + 0.5);
            assert!((f64::from(half[(5 * 20 + x) * 3]) - expected).abs() <= 0.51);
        }
    }

    #[test]
    fn enlarging_covers_and_the_identity_copies() {
        let image: Vec<u8> = (0..4 * 3 * 3).map(|i| (i * 7) as u8).collect();
        assert_eq!(Mapping::new((4, 3), (4, 3), Fit::Cover).rgb(&image), image);
        let mapping = Mapping::new((4, 3), (8, 8), Fit::Cover);
        assert_eq!(mapping.rgb(&image).len(), 8 * 8 * 3);
        assert!(mapping.scaled.0 >= 8 && mapping.scaled.1 >= 8);
    }

    #[test]
    fn nearest_takes_the_sample_under_the_pixel_centre() {
        let map: Vec<f32> = (0..6 * 4).map(|i| i as f32).collect();
        let mapping = Mapping::new((6, 4), (2, 2), Fit::Stretch);
        // Centres of the outputs fall on columns 1 and 4, rows 1 and 3.
        assert_eq!(mapping.nearest(&map), [7.0, 10.0, 19.0, 22.0]);
    }
}
