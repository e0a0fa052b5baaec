//! Photographs on surfaces: pictures at halved sizes, read between their pixels.

use std::sync::OnceLock;

use glam::Vec3;

use crate::math::floor;

/// Largest side of a picture as it is kept; larger ones are halved.
const LARGEST_SIDE: usize = 256;
/// Smallest side of a picture that shows anything.
const LEAST_SIDE: usize = 16;

/// A picture of a surface: beyond its borders it goes on mirrored.
#[derive(Debug, Clone, PartialEq)]
pub struct Photo {
    /// Each level has half the size of the one before.
    levels: Vec<Level>,
    /// Mean linear light is brought to this.
    gain: f32,
}

#[derive(Debug, Clone, PartialEq)]
struct Level {
    width: usize,
    height: usize,
    /// sRGB, 8 bit.
    rgb: Vec<[u8; 3]>,
}

impl Photo {
    /// A picture of 8-bit sRGB, `[height, width, 3]`; `None` for one that is smaller than 16 pixels or of another length.
    #[must_use]
    pub fn new(width: usize, height: usize, rgb: &[u8]) -> Option<Self> {
        if width < LEAST_SIDE || height < LEAST_SIDE || rgb.len() != 3 * width * height {
            return None;
        }
        let mut level = Level {
            width,
            height,
            rgb: rgb.as_chunks::<3>().0.to_vec(),
        };
        while level.width.max(level.height) > LARGEST_SIDE {
            level = level.halved();
        }
        let mut levels = vec![level];
        while let Some(last) = levels.last().filter(|last| last.width > 1 && last.height > 1) {
            levels.push(last.halved());
        }
        // Pictures of surfaces are darker or brighter by how they were taken.
        let mean = levels.last().map_or(0.5, |last| last.at(0, 0).element_sum() / 3.0);
        Some(Self {
            levels,
            gain: (0.45 / mean.max(0.02)).clamp(0.5, 2.5),
        })
    }

    /// Linear RGB at a point in periods of the picture, seen along the axis that the normal is nearest to; what is finer
    /// than `blur` periods is averaged.
    pub(crate) fn facing(&self, p: Vec3, normal: Vec3, blur: f32) -> Vec3 {
        let n = normal.abs();
        let (u, v) = if n.z >= n.x && n.z >= n.y {
            (p.x, p.y)
        } else if n.x >= n.y {
            (p.y, -p.z)
        } else {
            (p.x, -p.z)
        };
        let mut texel = 1.0 / self.levels[0].width as f32;
        let mut level = 0;
        while texel < 0.75 * blur && level + 1 < self.levels.len() {
            texel *= 2.0;
            level += 1;
        }
        self.levels[level].between(u, v) * self.gain
    }
}

impl Level {
    fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let encode = |linear: Vec3| {
            let level = |x: f32| (f64::from(x).powf(1.0 / 2.2) * 255.0 + 0.5) as u8;
            [level(linear.x), level(linear.y), level(linear.z)]
        };
        let mean = |column: usize, row: usize| {
            let (x, y) = (2 * column, 2 * row);
            let (right, below) = ((x + 1).min(self.width - 1), (y + 1).min(self.height - 1));
            0.25 * (self.at(x, y) + self.at(right, y) + self.at(x, below) + self.at(right, below))
        };
        let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
        Self {
            width,
            height,
            rgb: pixels.map(|(column, row)| encode(mean(column, row))).collect(),
        }
    }

    /// Linear RGB of a pixel.
    fn at(&self, column: usize, row: usize) -> Vec3 {
        let table = linear_table();
        let [r, g, b] = self.rgb[row * self.width + column];
        Vec3::new(table[usize::from(r)], table[usize::from(g)], table[usize::from(b)])
    }

    /// Linear RGB between pixels; the picture is one wide and as high as its sides ask for.
    fn between(&self, u: f32, v: f32) -> Vec3 {
        let scale = self.width as f32;
        let mirrored = |x: f32, side: usize| {
            let (period, side) = (2.0 * side as f32, side as f32);
            let within = x - period * floor(x / period);
            (if within < side { within } else { period - within } - 0.5).clamp(0.0, side - 1.0)
        };
        let (x, y) = (mirrored(u * scale, self.width), mirrored(v * scale, self.height));
        let (column, row) = (x as usize, y as usize);
        let (right, below) = ((column + 1).min(self.width - 1), (row + 1).min(self.height - 1));
        let (fx, fy) = (x - column as f32, y - row as f32);
        let above = self.at(column, row).lerp(self.at(right, row), fx);
        above.lerp(self.at(column, below).lerp(self.at(right, below), fx), fy)
    }
}

/// Linear light of an 8-bit level, by a power of 2.2.
fn linear_table() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|level| libm::pow(level as f64 / 255.0, 2.2) as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Left half black, right half white.
    fn halves() -> Photo {
        let rgb: Vec<u8> = (0..32 * 32)
            .flat_map(|k| [if k % 32 < 16 { 0 } else { 255 }; 3])
            .collect();
        Photo::new(32, 32, &rgb).unwrap()
    }

    #[test]
    fn pictures_are_read_where_they_lie_and_go_on_mirrored() {
        let photo = halves();
        let at = |x: f32| photo.facing(Vec3::new(x, 0.3, 0.0), Vec3::Z, 0.0).x / photo.gain;
        assert_eq!((at(0.25), at(0.75)), (0.0, 1.0));
        // One period on it runs backwards, two periods on it is the same.
        assert_eq!((at(1.25), at(1.75), at(2.25), at(-0.25)), (1.0, 0.0, 0.0, 0.0));
        // Seen from the side, height runs along the rows of the picture.
        let side = photo.facing(Vec3::new(9.0, 0.75, -0.2), Vec3::X, 0.0).x / photo.gain;
        assert_eq!(side, 1.0);
    }

    #[test]
    fn far_away_only_the_mean_is_left() {
        let photo = halves();
        let far = photo.facing(Vec3::new(0.1, 0.1, 0.0), Vec3::Z, 100.0).x / photo.gain;
        assert!((far - 0.5).abs() < 0.02, "{far}");
        assert!((photo.gain - 0.9).abs() < 0.05, "{}", photo.gain);
    }

    #[test]
    fn large_pictures_are_made_smaller_and_wrong_ones_refused() {
        let large = Photo::new(600, 300, &vec![90; 3 * 600 * 300]).unwrap();
        assert_eq!((large.levels[0].width, large.levels[0].height), (150, 75));
        assert!(Photo::new(8, 300, &vec![0; 3 * 8 * 300]).is_none());
        assert!(Photo::new(32, 32, &[0; 7]).is_none());
    }
}
