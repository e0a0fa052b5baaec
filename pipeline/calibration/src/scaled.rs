//! Smaller images: means of square blocks, and grey pyramids.

use rogs_geometry::Pinhole;

/// An image whose pixels are means of `factor` by `factor` pixels; rows and columns that fill no block are left out.
#[must_use]
pub(crate) fn shrunk(rgb: &[u8], width: usize, height: usize, factor: usize) -> Vec<u8> {
    if factor <= 1 {
        return rgb.to_vec();
    }
    let (columns, rows) = (width / factor, height / factor);
    let count = (factor * factor) as u32;
    let mut out = Vec::with_capacity(3 * columns * rows);
    for row in 0..rows {
        for column in 0..columns {
            let mut sums = [0u32; 3];
            for y in row * factor..(row + 1) * factor {
                let start = 3 * (y * width + column * factor);
                for pixel in rgb[start..start + 3 * factor].chunks_exact(3) {
                    for channel in 0..3 {
                        sums[channel] += u32::from(pixel[channel]);
                    }
                }
            }
            out.extend(sums.map(|sum| ((sum + count / 2) / count) as u8));
        }
    }
    out
}

/// The camera of [`shrunk`] images.
#[must_use]
pub(crate) fn shrunk_lens(lens: &Pinhole, factor: u32) -> Pinhole {
    let whole = lens.cropped(0, 0, lens.width / factor * factor, lens.height / factor * factor);
    whole.resized(lens.width / factor, lens.height / factor)
}

/// A grey image, values 0 to 255. `[H, W]`
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Grey {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

impl Grey {
    /// Mean of the channels.
    pub(crate) fn of_rgb(rgb: &[u8], width: usize, height: usize) -> Self {
        let values = rgb
            .chunks_exact(3)
            .map(|p| (f32::from(p[0]) + f32::from(p[1]) + f32::from(p[2])) / 3.0)
            .collect();
        Self { width, height, values }
    }

    /// Half the size, smoothed before by (1, 4, 6, 4, 1) / 16 along rows and columns.
    pub(crate) fn halved(&self) -> Self {
        const KERNEL: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let inside = |at: i64, count: usize| at.clamp(0, count as i64 - 1) as usize;
        let mut rows = vec![0.0; width * self.height];
        for y in 0..self.height {
            for x in 0..width {
                let tap = |k: usize| self.values[y * self.width + inside(2 * x as i64 + k as i64 - 2, self.width)];
                rows[y * width + x] = (0..5).map(|k| KERNEL[k] * tap(k)).sum();
            }
        }
        let mut values = vec![0.0; width * height];
        for y in 0..height {
            for x in 0..width {
                let tap = |k: usize| rows[inside(2 * y as i64 + k as i64 - 2, self.height) * width + x];
                values[y * width + x] = (0..5).map(|k| KERNEL[k] * tap(k)).sum();
            }
        }
        Self { width, height, values }
    }

    /// Bilinear value at a place counted from the centre of the first pixel; `None` outside.
    pub(crate) fn at(&self, x: f32, y: f32) -> Option<f32> {
        if !(x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f32 && y < (self.height - 1) as f32) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (u, v) = (x - column as f32, y - row as f32);
        let at = row * self.width + column;
        let top = self.values[at] * (1.0 - u) + self.values[at + 1] * u;
        let bottom = self.values[at + self.width] * (1.0 - u) + self.values[at + self.width + 1] * u;
        Some(top * (1.0 - v) + bottom * v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_averaged_and_the_camera_follows() {
        let rgb: Vec<u8> = (0..5 * 4).flat_map(|i| [i as u8 * 2, 10, 0]).collect();
        let small = shrunk(&rgb, 5, 4, 2);
        assert_eq!(small.len(), 2 * 2 * 3);
        // Pixels 0, 1, 5, 6: the mean of 0, 2, 10, 12.
        assert_eq!(small[..3], [6, 10, 0]);
        let lens = shrunk_lens(&Pinhole::centred(100.0, 5, 4), 2);
        assert_eq!((lens.width, lens.height), (2, 2));
        let found = lens.intrinsics;
        assert!(
            (found.fx - 50.0).abs() < 1e-12 && (found.cx - 1.25).abs() < 1e-12,
            "{found:?}"
        );
        assert_eq!(shrunk(&rgb, 5, 4, 1), rgb);
    }

    #[test]
    fn halving_keeps_a_slope() {
        let grey = Grey {
            width: 32,
            height: 16,
            values: (0..512).map(|i| (i % 32) as f32).collect(),
        };
        let half = grey.halved();
        assert_eq!((half.width, half.height), (16, 8));
        assert!((half.values[3 * 16 + 5] - 10.0).abs() < 1e-4);
        assert_eq!(grey.at(3.5, 2.0), Some(3.5));
        assert_eq!(grey.at(31.0, 2.0), None);
    }
}
