//! Solid procedural textures, evaluated in a body's own frame so that they travel with it.

use std::sync::OnceLock;

use super::photo::Photo;
use crate::math::{floor, floor3};
use glam::Vec3;

/// What a surface looks like: linear RGB albedo as a function of the point, and a gloss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Material {
    pub pattern: Pattern,
    /// First and second colour, linear RGB.
    pub colours: [Vec3; 2],
    /// Size of the pattern, metres.
    pub scale: f32,
    /// Offset of the pattern, so that bodies of one pattern differ.
    pub offset: Vec3,
    /// Relative strength of fine mottling.
    pub grain: f32,
    /// Strength of the highlight.
    pub gloss: f32,
}

/// Kind of texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pattern {
    Plain,
    Checker,
    /// Bands along the axis of this index.
    Stripes(usize),
    /// Clouds of the two colours.
    Cloud,
    /// Boards along x with grain.
    Wood,
    /// Dots of the second colour.
    Dots,
    /// Tiles with joints of the second colour.
    Tiles,
    /// Patches of many colours around the two, like a shelf or posters.
    Patches,
    /// The photograph of this index, tinted by the first colour, seen along the axis that the surface faces most.
    Photo(u16),
}

impl Material {
    pub(crate) fn plain(colour: [f32; 3]) -> Self {
        Self {
            pattern: Pattern::Plain,
            colours: [Vec3::from_array(colour); 2],
            scale: 1.0,
            offset: Vec3::ZERO,
            grain: 0.0,
            gloss: 0.0,
        }
    }

    /// Albedo at a point of the body, whose normal says from where a photograph is seen; details smaller than `footprint`
    /// metres fade out.
    pub(crate) fn albedo(&self, (point, normal): (Vec3, Vec3), footprint: f32, photos: &[Photo]) -> Vec3 {
        let p = (point + self.offset) / self.scale;
        let blur = footprint / self.scale;
        let [a, b] = self.colours;
        let colour = match self.pattern {
            Pattern::Plain => a,
            Pattern::Checker => a.lerp(b, checker(p, blur)),
            Pattern::Stripes(axis) => a.lerp(b, square_wave(p[axis], blur)),
            Pattern::Cloud => a.lerp(b, step(fractal(p, blur), 0.25)),
            Pattern::Wood => a.lerp(b, wood(p, blur)),
            Pattern::Dots => a.lerp(b, dots(p, blur)),
            Pattern::Tiles => tiles(p, blur, a, b),
            Pattern::Patches => patches(p, blur, a, b),
            Pattern::Photo(index) => photos
                .get(usize::from(index))
                .map_or(a, |photo| a * photo.facing(p, normal, blur)),
        };
        if self.grain == 0.0 {
            return colour;
        }
        let fine = fade(footprint * 160.0);
        if fine == 0.0 {
            colour
        } else {
            colour * (1.0 + self.grain * fine * noise(point * 160.0 + self.offset))
        }
    }
}

/// Maps [-1, 1] to [0, 1] with a soft threshold of this half width.
fn step(value: f32, half_width: f32) -> f32 {
    let s = (0.5 + 0.5 * value / half_width).clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}

/// 1 for features much larger than a pixel, 0 for features of two pixels and less.
fn fade(blur: f32) -> f32 {
    (1.6 - 3.0 * blur).clamp(0.0, 1.0)
}

/// A square wave of period 2, box-filtered over `blur`.
fn square_wave(x: f32, blur: f32) -> f32 {
    let half = (0.5 * blur).max(1e-4);
    // Integral of the wave, with its mean taken out: a triangle wave.
    let integral = |x: f32| {
        let r = x - 2.0 * floor(0.5 * x);
        0.5 * x + if r < 1.0 { -0.5 * r } else { 0.5 * r - 1.0 }
    };
    ((integral(x + half) - integral(x - half)) / (2.0 * half)).clamp(0.0, 1.0)
}

fn checker(p: Vec3, blur: f32) -> f32 {
    // Signs multiply: the filtered value of a product of independent waves.
    let sign = |x: f32| 2.0 * square_wave(x, blur) - 1.0;
    0.5 + 0.5 * sign(p.x + 1e-3) * sign(p.y + 1e-3) * sign(p.z + 0.013)
}

fn wood(p: Vec3, blur: f32) -> f32 {
    let board = floor(p.y);
    let shifted = Vec3::new(0.15 * p.x + 7.3 * board, p.y * 3.0, p.z * 3.0 + 3.1 * board);
    let rings = noise(shifted) * 3.0 + p.y * 2.0;
    let rings = (rings - floor(rings) - 0.5).abs() * 2.0;
    let fibre = noise(Vec3::new(p.x * 0.6, p.y * 18.0, p.z * 18.0)) * fade(blur * 18.0);
    let joint = if p.y - board < 0.04 {
        0.5 * fade(blur * 5.0)
    } else {
        0.0
    };
    let tone = 0.25 * noise(Vec3::new(board * 3.7, 0.5, 0.5));
    (0.45 * rings * fade(blur * 2.0) + 0.25 * fibre + 0.3 + tone + joint).clamp(0.0, 1.0)
}

fn dots(p: Vec3, blur: f32) -> f32 {
    let cell = p - floor3(p) - Vec3::splat(0.5);
    let edge = (0.3 - cell.length()) / blur.max(0.02);
    (edge + 0.5).clamp(0.0, 1.0) * fade(blur)
}

fn tiles(p: Vec3, blur: f32, a: Vec3, b: Vec3) -> Vec3 {
    let cell = floor3(p);
    let inside = p - cell;
    let edge = |x: f32| x.min(1.0 - x);
    // Bodies are thin along one axis; joints along it would cover the whole face.
    let distance = edge(inside.x).min(edge(inside.y));
    let joint = ((0.02 - distance) / blur.max(0.005) + 0.5).clamp(0.0, 1.0) * fade(blur * 2.0);
    let tone = 1.0 + 0.12 * fade(blur) * hash_unit(cell.x as i32, cell.y as i32, 3);
    (a * tone).lerp(b, joint)
}

fn patches(p: Vec3, blur: f32, a: Vec3, b: Vec3) -> Vec3 {
    // Two grids of different pitch; the hash says which one shows.
    let coarse = floor3(p);
    let (x, y, z) = (coarse.x as i32, coarse.y as i32, coarse.z as i32);
    let split = 1.0 + floor(hash_unit(x, z, y ^ 17) * 1.5 + 1.5);
    let fine = floor3((p - coarse) * split);
    let (i, k) = (x * 8 + fine.x as i32, z * 8 + fine.z as i32);
    let j = y * 8 + fine.y as i32;
    let tint = Vec3::new(hash_unit(i, j, k), hash_unit(j, k, i + 5), hash_unit(k, i, j + 9));
    let mixed = a.lerp(b, 0.5 + 0.5 * hash_unit(i, k, j + 21));
    let vivid = (mixed + 0.28 * tint * mixed.max_element()).max(Vec3::splat(0.01));
    (a + b)
        .mul_add(Vec3::splat(0.5), Vec3::ZERO)
        .lerp(vivid, fade(blur * 0.5))
}

/// Two to three octaves of [`noise`], in about [-1, 1].
fn fractal(p: Vec3, blur: f32) -> f32 {
    let mut sum = 0.62 * noise(p);
    if blur < 0.25 {
        sum += 0.3 * noise(p * 2.03 + Vec3::splat(5.2));
    }
    if blur < 0.12 {
        sum += 0.16 * noise(p * 4.1 + Vec3::splat(11.7));
    }
    sum
}

const LATTICE: usize = 32;

/// Value noise in [-1, 1] on a lattice of period 32.
pub(crate) fn noise(p: Vec3) -> f32 {
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        let cells = (0..LATTICE as i32).flat_map(|z| (0..LATTICE as i32).map(move |y| (y, z)));
        cells
            .flat_map(|(y, z)| (0..LATTICE as i32).map(move |x| hash_unit(x, y, z)))
            .collect()
    });
    let cell = floor3(p);
    let t = p - cell;
    let s = t * t * (Vec3::splat(3.0) - 2.0 * t);
    let wrap = |v: f32| (v as i32 as usize) & (LATTICE - 1);
    let (x0, y0, z0) = (wrap(cell.x), wrap(cell.y) * LATTICE, wrap(cell.z) * LATTICE * LATTICE);
    let x1 = (x0 + 1) & (LATTICE - 1);
    let y1 = (y0 + LATTICE) & (LATTICE * LATTICE - 1);
    let z1 = (z0 + LATTICE * LATTICE) & (LATTICE * LATTICE * LATTICE - 1);
    let along_x = |row: usize| {
        let (a, b) = (table[row + x0], table[row + x1]);
        a + (b - a) * s.x
    };
    let near = along_x(y0 + z0) + (along_x(y1 + z0) - along_x(y0 + z0)) * s.y;
    let far = along_x(y0 + z1) + (along_x(y1 + z1) - along_x(y0 + z1)) * s.y;
    near + (far - near) * s.z
}

/// A number in [-1, 1) for three integers.
fn hash_unit(x: i32, y: i32, z: i32) -> f32 {
    let key = (x as u32).wrapping_mul(0x8da6_b343)
        ^ (y as u32).wrapping_mul(0xd816_3841)
        ^ (z as u32).wrapping_mul(0xcb1a_b31f);
    (mix(key) >> 8) as f32 / 8_388_608.0 - 1.0
}

/// Scrambles 32 bits (full avalanche).
pub(crate) fn mix(mut h: u32) -> u32 {
    h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
    h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
    h ^ (h >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filtered_square_wave_keeps_its_mean_and_its_period() {
        assert_eq!(square_wave(0.5, 0.0), 0.0);
        assert!((square_wave(1.5, 0.0) - 1.0).abs() < 1e-3);
        assert!((square_wave(-0.5, 0.1) - 1.0).abs() < 1e-3);
        assert!((square_wave(0.3, 40.0) - 0.5).abs() < 0.02);
        let mean: f32 = (0..400).map(|i| square_wave(i as f32 * 0.01, 0.3)).sum::<f32>() / 400.0;
        assert!((mean - 0.5).abs() < 0.01, "{mean}");
    }

    #[test]
    fn noise_is_continuous_and_bounded() {
        let mut previous = noise(Vec3::new(-3.0, 0.2, 40.7));
        for i in 1..600 {
            let value = noise(Vec3::new(-3.0 + i as f32 * 0.01, 0.2, 40.7));
            assert!((value - previous).abs() < 0.05 && value.abs() <= 1.0);
            previous = value;
        }
    }
}
