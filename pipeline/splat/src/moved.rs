//! Gaussians in another frame: means, sizes, orientations and the harmonics of their colours change together.

use glam::{DMat3, DQuat, DVec3};
use rogs_geometry::{Frame, Similarity, largest_component_quaternion, quaternion_product};

use crate::gaussians::{Colour, Gaussians};
use crate::sh;

/// Nodes and weights of the four-point Gauss-Legendre rule: exact for polynomials up to degree 7.
const NODES: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.347_854_845_137_453_8),
    (-0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
    (0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_8),
];
/// Directions around the axis; as many are exact up to degree 7.
const AROUND: usize = 8;

impl Gaussians {
    /// The Gaussians in another frame; translation and scale are in the unit of the Gaussians. Extra channels are handed on
    /// as they are.
    #[must_use]
    pub fn moved<A: Frame, B: Frame>(mut self, a_from_b: &Similarity<A, B>) -> Self {
        for mean in self.means.chunks_exact_mut(3) {
            let old = DVec3::new(mean[0].into(), mean[1].into(), mean[2].into());
            mean.copy_from_slice(&a_from_b.point(old).as_vec3().to_array());
        }
        for scale in &mut self.scales {
            *scale = (f64::from(*scale) * a_from_b.scale) as f32;
        }
        let rotation = &a_from_b.rigid.rotation;
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
            let turn = harmonics_rotation(*degree, rotation);
            for own in coefficients.chunks_exact_mut(3 * sh::coefficient_count(*degree)) {
                for band in 1..=*degree {
                    let range = band * band..(band + 1) * (band + 1);
                    let old: Vec<f64> = own[3 * range.start..3 * range.end].iter().map(|&v| v.into()).collect();
                    for row in range.clone() {
                        for channel in 0..3 {
                            let terms = range.clone().zip(old.iter().skip(channel).step_by(3));
                            own[3 * row + channel] = terms.map(|(k, value)| turn[row][k] * value).sum::<f64>() as f32;
                        }
                    }
                }
            }
        }
        self
    }
}

/// The matrix that takes the coefficients of a function in frame `b` to those in frame `a`: entry `(j, k)` is the integral
/// of `Y_j(R d) Y_k(d)` over the sphere, since the functions are orthonormal. Bands do not mix. Products have degree 6 at
/// most, so the quadrature is exact up to rounding.
fn harmonics_rotation(degree: usize, rotation: &DMat3) -> [[f64; sh::MAX_COEFFICIENTS]; sh::MAX_COEFFICIENTS] {
    let mut matrix = [[0.0; sh::MAX_COEFFICIENTS]; sh::MAX_COEFFICIENTS];
    for (z, weight) in NODES {
        let radius = libm::sqrt(1.0 - z * z);
        for step in 0..AROUND {
            let angle = std::f64::consts::TAU * step as f64 / AROUND as f64;
            let b = DVec3::new(radius * libm::cos(angle), radius * libm::sin(angle), z);
            let at = |direction: DVec3| sh::basis(degree, direction.as_vec3().to_array());
            let (of_a, of_b) = (at(*rotation * b), at(b));
            let share = weight * std::f64::consts::TAU / AROUND as f64;
            for (row, a) in matrix.iter_mut().zip(of_a) {
                for (entry, b) in row.iter_mut().zip(of_b) {
                    *entry += share * f64::from(a) * f64::from(b);
                }
            }
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use rogs_geometry::{Base, Pose, Recon, rotation_about_axis};

    use super::*;

    #[test]
    fn turned_harmonics_are_the_old_ones_seen_from_turned_directions() {
        let rotation = rotation_about_axis(DVec3::new(2.0, -1.0, 2.0) / 3.0, 1.1);
        let rigid: Pose<Base, Recon> = Pose::new(rotation, DVec3::new(0.5, 0.0, -1.0));
        let base_from_recon = Similarity { rigid, scale: 2.0 };
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
        assert_eq!(moved.scales, [0.2; 3]);
        for d in [[1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [-0.48, 0.6, 0.64]].map(DVec3::from_array) {
            let before = sh::evaluate(3, d.as_vec3().to_array(), &coefficients);
            let after = sh::evaluate(3, (rotation * d).as_vec3().to_array(), new);
            for c in 0..3 {
                assert!((before[c] - after[c]).abs() < 2e-6, "{before:?} {after:?}");
            }
        }
        let mean = base_from_recon.point(DVec3::new(0.3, -0.2, 1.0));
        assert!((glam::Vec3::from_slice(&moved.means).as_dvec3() - mean).length() < 1e-6);
    }
}
