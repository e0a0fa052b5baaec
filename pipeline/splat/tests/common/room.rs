//! A synthetic room with one Gaussian per source pixel: floor, walls, spheres; wrist and two external cameras.

#![allow(dead_code, unreachable_pub, missing_docs)]

use rogs_splat::{Colour, Gaussians, RasterCamera};

type V3 = [f64; 3];

/// Small generator of uniform and normal numbers (SplitMix64, Box-Muller).
pub struct Rng(pub u64);

impl Rng {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        let u = 1.0 - self.uniform();
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

pub fn normals(count: usize, seed: u64) -> Vec<f32> {
    let mut rng = Rng(seed);
    (0..count).map(|_| rng.normal() as f32).collect()
}

const EYES: [V3; 3] = [[0.9, 0.9, 0.8], [0.9, -0.9, 0.8], [0.35, 0.05, 0.65]];
const TARGET: V3 = [0.35, 0.0, 0.15];
const SPHERES: [(V3, f64); 4] = [
    ([0.45, 0.1, 0.1], 0.1),
    ([0.3, -0.2, 0.07], 0.07),
    ([0.1, 0.0, 0.35], 0.12),
    ([0.15, 0.0, 0.6], 0.1),
];
/// Planes: axis and coordinate.
const PLANES: [(usize, f64); 6] = [(2, 0.0), (0, -0.6), (1, 1.6), (1, -1.6), (2, 2.2), (0, 2.0)];

/// Axes x, y, z of a camera that looks from `eye` to the target, as rows.
fn look(eye: V3) -> [V3; 3] {
    let z = unit(sub(TARGET, eye));
    let x = unit([z[1], -z[0], 0.0]);
    [x, cross(z, x), z]
}

fn distance_along(origin: V3, direction: V3) -> f64 {
    let mut nearest = 4.0;
    for (axis, at) in PLANES {
        let t = (at - origin[axis]) / direction[axis];
        if t > 0.05 && t < nearest {
            nearest = t;
        }
    }
    for (centre, radius) in SPHERES {
        let oc = sub(origin, centre);
        let (a, b) = (dot(direction, direction), dot(direction, oc));
        let q = b * b - a * (dot(oc, oc) - radius * radius);
        let t = (-b - q.max(0.0).sqrt()) / a;
        if q > 0.0 && t > 0.02 && t < nearest {
            nearest = t;
        }
    }
    nearest
}

/// One Gaussian per pixel of `views` x `times` source images; the third view moves.
pub fn scene(views: usize, times: usize, width: usize, height: usize) -> Gaussians {
    let mut rng = Rng(0);
    let mut out = Gaussians::empty();
    let mut rgb = Vec::new();
    let focal = 0.83 * width as f64;
    for view in 0..views {
        for time in 0..times {
            let mut eye = EYES[view];
            if view == 2 {
                eye[0] += 0.01 * time as f64;
                eye[1] += 0.02 * time as f64;
            }
            let [x, y, z] = look(eye);
            for row in 0..height {
                for column in 0..width {
                    let u = (column as f64 + 0.5 - width as f64 / 2.0) / focal;
                    let v = (row as f64 + 0.5 - height as f64 / 2.0) / focal;
                    let direction: V3 = std::array::from_fn(|k| u * x[k] + v * y[k] + z[k]);
                    let depth = distance_along(eye, direction) * (1.0 + 0.004 * rng.normal());
                    let p: V3 = std::array::from_fn(|k| eye[k] + depth * direction[k]);
                    out.means.extend(p.map(|v| v as f32));
                    out.scales
                        .extend((0..3).map(|_| (depth / focal * (0.35 * rng.normal() - 0.25).exp()) as f32));
                    out.quats.extend((0..4).map(|_| rng.normal() as f32));
                    out.opacities
                        .push((1.0 / (1.0 + (0.5 - 1.2 * rng.normal()).exp())) as f32);
                    rgb.extend((0..3).map(|k| {
                        let wave = 0.5 + 0.35 * (9.0 * p[k] + k as f64).sin() + 0.03 * rng.normal();
                        wave.clamp(0.0, 1.0) as f32
                    }));
                }
            }
        }
    }
    out.colour = Colour::Rgb(rgb);
    out
}

/// A camera 8 cm beside the first source camera.
pub fn camera(width: u32, height: u32) -> RasterCamera {
    camera_from([EYES[0][0] - 0.06, EYES[0][1] + 0.06, EYES[0][2]], width, height)
}

pub fn camera_from(eye: V3, width: u32, height: u32) -> RasterCamera {
    let axes = look(eye);
    let focal = 0.83 * f64::from(width);
    RasterCamera {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
        rotation: std::array::from_fn(|k| axes[k / 3][k % 3]),
        translation: axes.map(|axis| -dot(axis, eye)),
    }
}

pub fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let mse = a.iter().zip(b).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>() / a.len() as f64;
    -10.0 * mse.max(1e-30).log10()
}

fn sub(a: V3, b: V3) -> V3 {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: V3, b: V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: V3, b: V3) -> V3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn unit(a: V3) -> V3 {
    let length = dot(a, a).sqrt();
    a.map(|v| v / length)
}
