//! What others made and an episode may use: photographs, models, light. Whoever calls the generator reads the files.

use std::sync::Arc;

use glam::{DVec3, Vec3};

use super::guest::GuestArm;
use crate::mesh::TriMesh;
use crate::render::{Photo, PreparedMesh};

/// Things that are at hand for wide worlds; without any, all is drawn from formulas.
#[derive(Debug, Clone, Default)]
pub struct Props {
    /// Pictures of surfaces.
    pub photos: Arc<Vec<Photo>>,
    /// Furniture and small things.
    pub models: Vec<Model>,
    /// Light of places.
    pub skies: Vec<Sky>,
    /// Other robots.
    pub arms: Vec<GuestArm>,
}

/// A thing as triangles, seen from both sides, that stands on z = 0 with its middle over the origin.
#[derive(Debug, Clone)]
pub struct Model {
    pub(crate) mesh: Arc<PreparedMesh>,
    /// Half extents, metres.
    pub(crate) half: DVec3,
    /// Materials of its parts.
    pub(crate) parts: usize,
}

/// Largest and smallest side of the box of a [`Model`], metres.
const MODEL_SIDES_M: [f64; 2] = [0.02, 6.0];
/// Most parts of a [`Model`] that get materials of their own.
const MOST_PARTS: usize = 6;

impl Model {
    /// A model of triangles in metres with z up. `None` for one that is no thing of a room: empty, or with a box larger than
    /// 6 m or thinner than 2 cm in all directions.
    #[must_use]
    pub fn new(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Option<Self> {
        let mesh = TriMesh::two_sided(positions, triangles, MOST_PARTS);
        if mesh.triangles.is_empty() {
            return None;
        }
        let parts = mesh.materials.iter().copied().max().unwrap_or(0) as usize + 1;
        let fold = |start: Vec3, f: fn(Vec3, Vec3) -> Vec3| mesh.positions.iter().copied().fold(start, f).as_dvec3();
        let (low, high) = (fold(Vec3::INFINITY, Vec3::min), fold(Vec3::NEG_INFINITY, Vec3::max));
        let half = 0.5 * (high - low);
        let [least, most] = MODEL_SIDES_M;
        if !(least..=most).contains(&(2.0 * half.max_element())) {
            return None;
        }
        let middle = 0.5 * (low + high);
        let mesh = mesh.at(-middle.x, -middle.y, -low.z);
        Some(Self {
            mesh: Arc::new(PreparedMesh::new(mesh)),
            half,
            parts,
        })
    }

    /// Number of its triangles, both sides counted.
    #[must_use]
    pub fn triangles(&self) -> usize {
        self.mesh.mesh().triangles.len()
    }
}

/// Light from all sides, as far as matt surfaces tell: nine numbers a colour (Ramamoorthi and Hanrahan 2001).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sky {
    /// Irradiance over pi in the basis of [`basis`], of mean luminance one.
    harmonics: [Vec3; 9],
}

/// The first nine real spherical harmonics at a unit vector, without the factors of the convolution with a cosine.
fn basis(n: Vec3) -> [f32; 9] {
    [
        0.282_095,
        0.488_603 * n.y,
        0.488_603 * n.z,
        0.488_603 * n.x,
        1.092_548 * n.x * n.y,
        1.092_548 * n.y * n.z,
        0.315_392 * (3.0 * n.z * n.z - 1.0),
        1.092_548 * n.x * n.z,
        0.546_274 * (n.x * n.x - n.y * n.y),
    ]
}

/// Convolution with the cosine lobe over pi, by order.
const LOBE: [f32; 9] = [1.0, 2.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, 0.25, 0.25, 0.25, 0.25, 0.25];

impl Sky {
    /// The light of a picture of everything around: rows from straight up to straight down, columns once around; linear RGB,
    /// `[height, width, 3]`. `None` for pictures of another size, without light, or with numbers that are none.
    #[must_use]
    pub fn new(width: usize, height: usize, rgb: &[f32]) -> Option<Self> {
        if width == 0 || height == 0 || rgb.len() != 3 * width * height || rgb.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let mut harmonics = [Vec3::ZERO; 9];
        let mut whole = 0.0f32;
        for row in 0..height {
            let polar = std::f64::consts::PI * (row as f64 + 0.5) / height as f64;
            let (sine, cosine) = (libm::sin(polar), libm::cos(polar));
            let weight = sine as f32;
            for column in 0..width {
                let around = std::f64::consts::TAU * (column as f64 + 0.5) / width as f64;
                let n = DVec3::new(sine * libm::cos(around), sine * libm::sin(around), cosine).as_vec3();
                // A lamp that fills a pixel would outshine the rest by a thousand times; it is the key light's part.
                let light = Vec3::from_slice(&rgb[3 * (row * width + column)..]).clamp(Vec3::ZERO, Vec3::splat(8.0));
                for (sum, value) in harmonics.iter_mut().zip(basis(n)) {
                    *sum += light * (value * weight);
                }
                whole += weight;
            }
        }
        let full = 4.0 * std::f32::consts::PI / whole;
        for (sum, lobe) in harmonics.iter_mut().zip(LOBE) {
            *sum *= full * lobe;
        }
        let mean = harmonics[0].dot(Vec3::new(0.2126, 0.7152, 0.0722)) * 0.282_095;
        if mean <= 1e-6 {
            return None;
        }
        Some(Self {
            harmonics: harmonics.map(|h| h / mean),
        })
    }

    /// Light on a matt surface of this normal, of mean luminance about one.
    pub(crate) fn on(&self, normal: Vec3) -> Vec3 {
        let sum: Vec3 = self.harmonics.iter().zip(basis(normal)).map(|(h, b)| *h * b).sum();
        sum.max(Vec3::splat(0.03))
    }

    /// The same light turned about z by an angle, radians.
    pub(crate) fn turned(&self, angle: f64) -> Self {
        let (s, c) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
        let (s2, c2) = (2.0 * s * c, c * c - s * s);
        let h = &self.harmonics;
        let mut turned = *h;
        // (x, y) turn by the angle, (x^2 - y^2, 2 x y) by twice the angle.
        (turned[3], turned[1]) = (h[3] * c - h[1] * s, h[3] * s + h[1] * c);
        (turned[7], turned[5]) = (h[7] * c - h[5] * s, h[7] * s + h[5] * c);
        (turned[8], turned[4]) = (h[8] * c2 - h[4] * s2, h[8] * s2 + h[4] * c2);
        Self { harmonics: turned }
    }

    /// Where most of the light comes from; straight up where it comes from everywhere.
    pub(crate) fn brightest(&self) -> Vec3 {
        let grey = |h: Vec3| h.dot(Vec3::new(0.2126, 0.7152, 0.0722));
        let h = &self.harmonics;
        Vec3::new(grey(h[3]), grey(h[1]), grey(h[2])).normalize_or(Vec3::Z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White above, black below.
    fn half() -> Sky {
        let (width, height) = (64, 32);
        let rgb: Vec<f32> = (0..3 * width * height)
            .map(|k| f32::from(u8::from(k / (3 * width) < height / 2)))
            .collect();
        Sky::new(width, height, &rgb).unwrap()
    }

    #[test]
    fn light_from_above_falls_on_what_looks_up() {
        // Exactly: twice the mean straight up, the mean sideways, none straight down; nine numbers keep it within a tenth.
        let sky = half();
        assert!((sky.on(Vec3::Z).x - 2.0).abs() < 0.2, "{}", sky.on(Vec3::Z));
        assert!((sky.on(Vec3::X).x - 1.0).abs() < 0.1);
        assert!(sky.on(Vec3::NEG_Z).x < 0.1);
        assert!((sky.brightest() - Vec3::Z).length() < 1e-3);
    }

    #[test]
    fn turned_light_is_the_light_of_the_turned_normal() {
        let (width, height) = (64, 32);
        let rgb: Vec<f32> = (0..width * height)
            .flat_map(|k| {
                let column = (k % width) as f32;
                [1.0 + column, (column - 20.0).abs(), 30.0 + (k / width) as f32]
            })
            .map(|v| v / 16.0)
            .collect();
        let sky = Sky::new(width, height, &rgb).unwrap();
        let turned = sky.turned(0.7);
        for normal in [Vec3::X, Vec3::Y, Vec3::new(0.5, -0.3, 0.4).normalize()] {
            let moved = (crate::math::rot_z(0.7) * normal.as_dvec3()).as_vec3();
            assert!((turned.on(moved) - sky.on(normal)).length() < 1e-4);
        }
    }

    #[test]
    fn pictures_without_light_and_things_of_no_size_are_refused() {
        assert!(Sky::new(2, 1, &[0.0; 6]).is_none());
        assert!(Sky::new(2, 1, &[1.0; 5]).is_none());
        assert!(Sky::new(2, 1, &[f32::NAN; 6]).is_none());
        let corners = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.7]];
        let model = Model::new(&corners, &[[0, 1, 2]]).unwrap();
        assert_eq!(model.triangles(), 2, "both sides");
        let low = model
            .mesh
            .mesh()
            .positions
            .iter()
            .map(|p| p.z)
            .fold(f32::INFINITY, f32::min);
        assert!(low.abs() < 1e-6 && (model.half.z - 0.35).abs() < 1e-6);
        assert!(Model::new(&corners, &[]).is_none());
        assert!(Model::new(&corners.map(|c| c.map(|v| v * 100.0)), &[[0, 1, 2]]).is_none());
    }
}
