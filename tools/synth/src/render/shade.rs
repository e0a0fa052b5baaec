//! Colour: albedo, key light with shadow, fill, sky and ground, highlight; then the sensor.

use std::sync::OnceLock;

use glam::{Affine3A, Mat3, Vec3, Vec3A};
use rogs_geometry::{Base, Camera, Pose};
use rogs_schemas::Intrinsics;

use super::photo::Photo;
use super::raster::NOBODY;
use super::seen::Seen;
use super::sensor::{Sensor, pixel_noise};
use super::shadow::LightMap;
use super::texture::mix;
use crate::frame::BodyFrame;
use crate::math::single;
use crate::scene::{Body, Lights};

/// What a body needs to be shaded in its own frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct BodyView {
    body_from_camera: Affine3A,
    camera: Vec3,
    key: Vec3,
    fill: Vec3,
    up: Vec3,
    /// Turns a direction of the body into one of the base.
    base_from_body: Mat3,
}

impl BodyView {
    pub(super) fn new(
        base_from_body: &Pose<Base, BodyFrame>,
        base_from_camera: &Pose<Base, Camera>,
        lights: &Lights,
    ) -> Self {
        let body_from_base = base_from_body.inverse();
        let turn = |v: Vec3| body_from_base.direction(v.as_dvec3()).as_vec3();
        let body_from_camera = body_from_base * *base_from_camera;
        Self {
            body_from_camera: single(&body_from_camera),
            camera: body_from_camera.translation.as_vec3(),
            key: turn(lights.towards_key),
            fill: turn(lights.towards_fill),
            up: turn(Vec3::Z),
            base_from_body: base_from_body.rotation.as_mat3(),
        }
    }
}

/// Everything that determines colours of one image.
pub(super) struct Shader<'a> {
    pub bodies: &'a [Body],
    pub views: &'a [BodyView],
    pub lights: &'a Lights,
    pub photos: &'a [Photo],
    pub key: &'a LightMap,
    pub sky: &'a LightMap,
    pub base_from_camera: Affine3A,
    pub intrinsics: Intrinsics,
    pub size: [usize; 2],
}

/// Where the colour samples lie (the first entry is the centre).
const SAMPLES: [[f32; 2]; 5] = [
    [0.0, 0.0],
    [-0.125, -0.375],
    [0.375, -0.125],
    [0.125, 0.375],
    [-0.375, 0.125],
];

impl Shader<'_> {
    /// The finished picture from the owners of the five samples.
    pub(super) fn image(&self, owners: &[&[u32]; 5], seen: &[Seen], sensor: &Sensor, noise_key: u32) -> Vec<u8> {
        let [height, width] = self.size;
        let mut rgb = vec![0u8; 3 * width * height];
        let encode = srgb_table();
        for (pixel, out) in rgb.chunks_exact_mut(3).enumerate() {
            let (row, column) = (pixel / width, pixel % width);
            let linear = self.pixel(owners, seen, pixel, column as f32, row as f32);
            let (u, v) = (
                2.0 * column as f32 / width as f32 - 1.0,
                2.0 * row as f32 / height as f32 - 1.0,
            );
            let gain = sensor.exposure * (1.0 - sensor.vignette * 0.5 * (u * u + v * v));
            let value = linear * Vec3::from_array(sensor.balance) * gain;
            let noise = pixel_noise(noise_key, pixel as u32);
            for k in 0..3 {
                // A shoulder instead of a hard clip; the table covers [0, 1].
                let x = value[k];
                let x = if x > 0.8 {
                    0.8 + 0.2 * ((x - 0.8) / (x - 0.6))
                } else {
                    x
                };
                let index = (x * (TABLE - 1) as f32 + 0.5) as usize;
                let level = encode[index.min(TABLE - 1)] + sensor.noise * noise[k];
                out[k] = (level + 0.5).clamp(0.0, 255.0) as u8;
            }
        }
        rgb
    }

    fn pixel(&self, owners: &[&[u32]; 5], seen: &[Seen], pixel: usize, column: f32, row: f32) -> Vec3 {
        let own: [u32; 4] = [owners[1][pixel], owners[2][pixel], owners[3][pixel], owners[4][pixel]];
        let centre = owners[0][pixel];
        if own.iter().all(|&o| o == centre) {
            return self.sample(centre, seen, column, row, 0, pixel);
        }
        let surface = |o: u32| if o == NOBODY { NOBODY } else { seen[o as usize].surface };
        let mut sum = Vec3::ZERO;
        let mut done = 0u8;
        for first in 0..4 {
            if done & (1 << first) != 0 {
                continue;
            }
            let mut weight = 0.0;
            for other in first..4 {
                if surface(own[other]) == surface(own[first]) {
                    done |= 1 << other;
                    weight += 0.25;
                }
            }
            sum += self.sample(own[first], seen, column, row, first + 1, pixel) * weight;
        }
        sum
    }

    fn sample(&self, owner: u32, seen: &[Seen], column: f32, row: f32, sample: usize, pixel: usize) -> Vec3 {
        if owner == NOBODY {
            return Vec3::splat(0.02);
        }
        let seen = &seen[owner as usize];
        let k = &self.intrinsics;
        let [dx, dy] = SAMPLES[sample];
        let ray = Vec3::new(
            (column + 0.5 + dx - k.cx as f32) / k.fx as f32,
            (row + 0.5 + dy - k.cy as f32) / k.fy as f32,
            1.0,
        );
        let facing = seen.normal.as_vec3().dot(ray);
        let depth = seen.distance as f32 / facing;
        let in_camera = ray * depth;
        let body = &self.bodies[seen.body as usize];
        let view = &self.views[seen.body as usize];
        let face = &body.mesh.faces[seen.face as usize];
        let point = view.body_from_camera.transform_point3(in_camera);
        let normal = face.normal(point);
        let material = &body.materials[face.material as usize];
        // Slanted surfaces cover more of the texture with one pixel.
        let slant = (-facing / (seen.normal.as_vec3().length() * ray.length())).max(0.15);
        let footprint = depth / (k.fx as f32 * slant.sqrt());
        let albedo = material.albedo((point, normal), footprint, self.photos);
        let towards_eye = (view.camera - point).normalize_or(normal);

        let at_base = self.base_from_camera.transform_point3a(in_camera.into());
        let key_cosine = normal.dot(view.key);
        let mut light = Vec3::ZERO;
        let mut gloss = 0.0;
        if key_cosine > 0.0 {
            let bias = (0.0035 + 0.002 / key_cosine.max(0.2)) * self.lights.shadows.half_width;
            let spread = (self.lights.softness * self.key.texels * 0.67).max(1.0);
            let lit = self
                .key
                .light(self.key.map_from_base.transform_point3a(at_base), bias, spread);
            light += self.lights.key * (key_cosine * lit);
            if material.gloss > 0.0 {
                let half = (view.key + towards_eye).normalize_or(normal).dot(normal).max(0.0);
                let p4 = half * half * half * half;
                let p16 = p4 * p4 * p4 * p4;
                gloss = material.gloss * lit * p16 * p16;
            }
        }
        light += self.lights.fill * normal.dot(view.fill).max(0.0);
        let upward = 0.5 + 0.5 * normal.dot(view.up);
        let turn = (mix(pixel as u32) >> 8) as f32 / 16_777_216.0;
        let lifted = at_base + Vec3A::from(Vec3::Z * 0.002);
        let open = self
            .sky
            .openness(self.sky.map_from_base.transform_point3a(lifted), turn);
        light += open
            * match &self.lights.around {
                None => self.lights.ground.lerp(self.lights.sky, upward),
                Some(sky) => sky.on(view.base_from_body * normal) * self.lights.sky,
            };
        albedo * light + self.lights.key * gloss
    }
}

const TABLE: usize = 4096;

/// sRGB level of linear light in steps of 1/4095.
fn srgb_table() -> &'static [f32; TABLE] {
    static ENCODE: OnceLock<[f32; TABLE]> = OnceLock::new();
    ENCODE.get_or_init(|| {
        std::array::from_fn(|index| {
            let linear = index as f64 / (TABLE - 1) as f64;
            let level = if linear <= 0.003_130_8 {
                12.92 * linear
            } else {
                1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055
            };
            (255.0 * level) as f32
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_encodes_as_srgb() {
        let table = srgb_table();
        assert_eq!((table[0], table[TABLE - 1]), (0.0, 255.0));
        assert!((table[TABLE / 5] / 255.0 - 0.4845).abs() < 2e-3);
    }
}
