//! Pairs of made-up scenes of planes, ray by ray: an oracle that shares nothing with the matcher.

#![allow(dead_code)] // Every test program takes what it needs.

use rogs_stereo::{Grey, Rig};

pub(crate) const WIDTH: usize = 200;
pub(crate) const HEIGHT: usize = 120;

/// The rig of all scenes.
pub(crate) const RIG: Rig = Rig {
    focal_px: 110.0,
    baseline_m: 0.12,
    shift_px: 0.0,
};

/// A piece of a plane `normal . p = offset` in the left eye's axes, metres.
#[derive(Clone, Copy)]
pub(crate) struct Surface {
    pub(crate) normal: [f64; 3],
    pub(crate) offset: f64,
    /// Smallest and largest x and y of the piece.
    pub(crate) bounds: Option<[f64; 4]>,
    /// Seed of its texture; `None` for one grey.
    pub(crate) texture: Option<u64>,
}

impl Surface {
    /// An endless textured wall straight ahead.
    pub(crate) fn wall(depth_m: f64, texture: u64) -> Self {
        Self {
            normal: [0.0, 0.0, 1.0],
            offset: depth_m,
            bounds: None,
            texture: Some(texture),
        }
    }
}

/// What an eye sees.
pub(crate) struct Eye {
    pub(crate) image: Grey,
    /// Camera z, metres. `[H, W]`
    pub(crate) depth_m: Vec<f64>,
    /// Index of the surface. `[H, W]`
    pub(crate) surface: Vec<usize>,
}

fn hash(x: i64, y: i64, seed: u64) -> f64 {
    let mut value = (x as u64)
        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
        .wrapping_add((y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f))
        .wrapping_add(seed.wrapping_mul(0x1656_67b1_9e37_79f9));
    value ^= value >> 29;
    value = value.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    value ^= value >> 32;
    (value >> 11) as f64 / (1u64 << 53) as f64
}

/// Grey of a point of a surface: noise interpolated between points 12 mm apart.
fn texture(x: f64, y: f64, seed: u64) -> f64 {
    let (u, v) = (x / 0.012, y / 0.012);
    let (column, row) = (u.floor(), v.floor());
    let (a, b) = (u - column, v - row);
    let at = |dx: i64, dy: i64| hash(column as i64 + dx, row as i64 + dy, seed);
    let along = |dy: i64| at(0, dy) * (1.0 - a) + at(1, dy) * a;
    40.0 + 180.0 * (along(0) * (1.0 - b) + along(1) * b)
}

/// The nearest surface along a ray from `(shift, 0, 0)`: its depth, index and point.
fn hit(scene: &[Surface], shift: f64, ray: [f64; 2]) -> Option<(f64, usize, [f64; 2])> {
    let mut nearest: Option<(f64, usize, [f64; 2])> = None;
    for (index, surface) in scene.iter().enumerate() {
        let [a, b, c] = surface.normal;
        let depth = (surface.offset - a * shift) / (a * ray[0] + b * ray[1] + c);
        let point = [shift + depth * ray[0], depth * ray[1]];
        let inside = surface.bounds.is_none_or(|[left, right, top, bottom]| {
            (left..right).contains(&point[0]) && (top..bottom).contains(&point[1])
        });
        if depth > 0.0 && inside && nearest.is_none_or(|(other, ..)| depth < other) {
            nearest = Some((depth, index, point));
        }
    }
    nearest
}

/// The left (`shift` 0) or right eye's view of a scene, moved down by `lower` rows.
pub(crate) fn eye(scene: &[Surface], shift: f64, lower: f64) -> Eye {
    let ray = |x: f64, y: f64| {
        [
            (x - 0.5 * WIDTH as f64) / RIG.focal_px,
            (y - lower - 0.5 * HEIGHT as f64) / RIG.focal_px,
        ]
    };
    let (mut pixels, mut depth_m, mut surface) = (vec![], vec![], vec![]);
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let (x, y) = (column as f64, row as f64);
            let (depth, index, _) = hit(scene, shift, ray(x + 0.5, y + 0.5)).unwrap();
            depth_m.push(depth);
            surface.push(index);
            let samples = [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]];
            let grey = samples.map(|[dx, dy]| {
                let (_, index, point) = hit(scene, shift, ray(x + dx, y + dy)).unwrap();
                scene[index]
                    .texture
                    .map_or(128.0, |seed| texture(point[0], point[1], seed))
            });
            pixels.push((grey.iter().sum::<f64>() / 4.0).round() as u8);
        }
    }
    Eye {
        image: Grey::new(WIDTH, HEIGHT, pixels).unwrap(),
        depth_m,
        surface,
    }
}

/// Both eyes.
pub(crate) fn pair(scene: &[Surface]) -> [Eye; 2] {
    [eye(scene, 0.0, 0.0), eye(scene, RIG.baseline_m, 0.0)]
}

/// How depth compares with its truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Agreement {
    /// Share of the pixels with truth that have a depth.
    pub(crate) coverage: f64,
    /// Mean of `|z' - z| / z` over them.
    pub(crate) absrel: f64,
    /// The middle one.
    pub(crate) median: f64,
    /// Pixels with truth and depth.
    pub(crate) count: usize,
}

/// Compares where the truth is finite and in `(0.1, 5)` metres, the range of scores.
pub(crate) fn compare(found: impl Iterator<Item = f64>, truth: impl Iterator<Item = f64>) -> Agreement {
    let (mut errors, mut known) = (vec![], 0usize);
    for (found, truth) in found.zip(truth) {
        if !(truth.is_finite() && truth > 0.1 && truth < 5.0) {
            continue;
        }
        known += 1;
        if found.is_finite() && found > 0.0 {
            errors.push((found - truth).abs() / truth);
        }
    }
    errors.sort_unstable_by(f64::total_cmp);
    Agreement {
        coverage: errors.len() as f64 / known.max(1) as f64,
        absrel: errors.iter().sum::<f64>() / errors.len().max(1) as f64,
        median: errors.get(errors.len() / 2).copied().unwrap_or(f64::NAN),
        count: errors.len(),
    }
}
