//! Gaussians in another frame: means, orientations and the harmonics of their colours turn together.

use glam::{DMat3, DQuat, DVec3};
use rogs_geometry::{Frame, Pose, largest_component_quaternion, quaternion_product};

use crate::gaussians::{Colour, Gaussians};
use crate::sh;

/// Directions that the rotation of harmonics is fitted on, far more than the 7 that the third band needs.
const DIRECTIONS: usize = 32;

impl Gaussians {
    /// The Gaussians in another frame; the translation is in the unit of the Gaussians. Extra channels are handed on as they
    /// are.
    #[must_use]
    pub fn moved<A: Frame, B: Frame>(mut self, a_from_b: &Pose<A, B>) -> Self {
        for mean in self.means.chunks_exact_mut(3) {
            let old = DVec3::new(mean[0].into(), mean[1].into(), mean[2].into());
            mean.copy_from_slice(&a_from_b.point(old).as_vec3().to_array());
        }
        let rotation = &a_from_b.rotation;
        let DQuat { x, y, z, w } = largest_component_quaternion(rotation);
        for quat in self.quats.chunks_exact_mut(4) {
            let own = [quat[0], quat[1], quat[2], quat[3]].map(f64::from);
            for (to, value) in quat.iter_mut().zip(quaternion_product([w, x, y, z], own)) {
                *to = value as f32;
            }
        }
        if let Colour::Sh { degree, coefficients } = &mut self.colour
            && *degree > 0
        {
            let turns: Vec<Vec<f64>> = (1..=*degree).map(|band| band_rotation(band, rotation)).collect();
            for own in coefficients.chunks_exact_mut(3 * sh::coefficient_count(*degree)) {
                for (band, turn) in (1..).zip(&turns) {
                    let (first, size) = (3 * band * band, 2 * band + 1);
                    let old: Vec<f64> = own[first..first + 3 * size].iter().map(|&v| f64::from(v)).collect();
                    for row in 0..size {
                        for c in 0..3 {
                            let sum: f64 = (0..size).map(|k| turn[row * size + k] * old[3 * k + c]).sum();
                            own[first + 3 * row + c] = sum as f32;
                        }
                    }
                }
            }
        }
        self
    }
}

/// The matrix that turns the coefficients of a band, row-major: `Y(d) D c = Y(R^-1 d) c` for every direction `d`, solved
/// on directions spread over the sphere, where the basis is nearly orthogonal.
fn band_rotation(band: usize, rotation: &DMat3) -> Vec<f64> {
    let (first, size) = (band * band, 2 * band + 1);
    let mut normal = vec![0.0; size * 2 * size];
    for index in 0..DIRECTIONS {
        let z = 1.0 - (2 * index + 1) as f64 / DIRECTIONS as f64;
        let around = index as f64 * std::f64::consts::PI * (3.0 - libm::sqrt(5.0));
        let radius = libm::sqrt(1.0 - z * z);
        let d = DVec3::new(radius * libm::cos(around), radius * libm::sin(around), z);
        let here = sh::basis(band, d.as_vec3().to_array());
        let there = sh::basis(band, rotation.transpose_mul_vec3(d).as_vec3().to_array());
        for row in 0..size {
            let weight = f64::from(here[first + row]);
            for k in 0..size {
                normal[row * 2 * size + k] += weight * f64::from(here[first + k]);
                normal[row * 2 * size + size + k] += weight * f64::from(there[first + k]);
            }
        }
    }
    // Gauss-Jordan on [A^T A | A^T B]; the diagonal dominates.
    for pivot in 0..size {
        let scale = normal[pivot * 2 * size + pivot];
        normal[pivot * 2 * size..(pivot + 1) * 2 * size]
            .iter_mut()
            .for_each(|v| *v /= scale);
        for row in (0..size).filter(|&row| row != pivot) {
            let factor = normal[row * 2 * size + pivot];
            for k in 0..2 * size {
                normal[row * 2 * size + k] -= factor * normal[pivot * 2 * size + k];
            }
        }
    }
    (0..size)
        .flat_map(|row| normal[row * 2 * size + size..(row + 1) * 2 * size].to_vec())
        .collect()
}

#[cfg(test)]
mod tests {
    use rogs_geometry::{Base, Recon, rotation_about_axis};

    use super::*;

    #[test]
    fn turned_harmonics_are_the_old_ones_seen_from_turned_directions() {
        let rotation = rotation_about_axis(DVec3::new(2.0, -1.0, 2.0) / 3.0, 1.1);
        let base_from_recon: Pose<Base, Recon> = Pose::new(rotation, DVec3::new(0.5, 0.0, -1.0));
        let coefficients: Vec<f32> = (0..48).map(|k| libm::sinf(1.7 * k as f32)).collect();
        let scene = Gaussians {
            means: vec![0.3, -0.2, 1.0],
            quats: vec![0.9, 0.1, -0.3, 0.2],
            scales: vec![0.1; 3],
            opacities: vec![0.5],
            colour: Colour::Sh {
                degree: 3,
                coefficients: coefficients.clone(),
            },
            extra: Vec::new(),
            extra_channels: 0,
        };
        let moved = scene.clone().moved(&base_from_recon);
        let Colour::Sh { coefficients: new, .. } = &moved.colour else {
            panic!("harmonics stay harmonics")
        };
        assert_eq!(new[..3], coefficients[..3]);
        for d in [[1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [-0.48, 0.6, 0.64]].map(DVec3::from_array) {
            let before = sh::evaluate(3, d.as_vec3().to_array(), &coefficients);
            let after = sh::evaluate(3, (rotation * d).as_vec3().to_array(), new);
            for c in 0..3 {
                assert!((before[c] - after[c]).abs() < 1e-5, "{before:?} {after:?}");
            }
        }
        let mean = base_from_recon.point(DVec3::new(0.3, -0.2, 1.0));
        assert!((glam::Vec3::from_slice(&moved.means).as_dvec3() - mean).length() < 1e-6);
    }
}
