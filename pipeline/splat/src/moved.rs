//! Gaussians in another frame: means, orientations and the harmonics of their colours turn together.

use crate::gaussians::{Colour, Gaussians};
use crate::sh;

/// Directions that the rotation of harmonics is fitted on, far more than the 7 that the third band needs.
const DIRECTIONS: usize = 32;

impl Gaussians {
    /// The Gaussians in the frame `b` given those in frame `a`: `p_b = rotation p_a + translation`, the rotation row-major,
    /// the translation in the unit of the Gaussians. Extra channels are handed on as they are.
    #[must_use]
    pub fn moved(mut self, rotation: &[f64; 9], translation: &[f64; 3]) -> Self {
        for mean in self.means.chunks_exact_mut(3) {
            let old = [mean[0], mean[1], mean[2]].map(f64::from);
            for (k, value) in mean.iter_mut().enumerate() {
                let turned: f64 = (0..3).map(|i| rotation[3 * k + i] * old[i]).sum();
                *value = (turned + translation[k]) as f32;
            }
        }
        let turn = quaternion(rotation);
        for quat in self.quats.chunks_exact_mut(4) {
            let own = [quat[0], quat[1], quat[2], quat[3]].map(f64::from);
            for (to, value) in quat.iter_mut().zip(product(turn, own)) {
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

/// A unit quaternion (w, x, y, z) of a rotation matrix, through its largest component.
fn quaternion(r: &[f64; 9]) -> [f64; 4] {
    // Four times the squares of w, x, y, z.
    let squares = [
        1.0 + r[0] + r[4] + r[8],
        1.0 + r[0] - r[4] - r[8],
        1.0 - r[0] + r[4] - r[8],
        1.0 - r[0] - r[4] + r[8],
    ];
    let mut largest = 0;
    for k in 1..4 {
        if squares[k] > squares[largest] {
            largest = k;
        }
    }
    // Each row is four times the largest component times all of them.
    let q = match largest {
        0 => [squares[0], r[7] - r[5], r[2] - r[6], r[3] - r[1]],
        1 => [r[7] - r[5], squares[1], r[1] + r[3], r[2] + r[6]],
        2 => [r[2] - r[6], r[1] + r[3], squares[2], r[5] + r[7]],
        _ => [r[3] - r[1], r[2] + r[6], r[5] + r[7], squares[3]],
    };
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / norm)
}

/// The rotation `a` after `b`.
fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// The matrix that turns the coefficients of a band, row-major: `Y(d) D c = Y(R^-1 d) c` for every direction `d`, solved
/// on directions spread over the sphere, where the basis is nearly orthogonal.
fn band_rotation(band: usize, rotation: &[f64; 9]) -> Vec<f64> {
    let (first, size) = (band * band, 2 * band + 1);
    let mut normal = vec![0.0; size * 2 * size];
    for index in 0..DIRECTIONS {
        let z = 1.0 - (2 * index + 1) as f64 / DIRECTIONS as f64;
        let around = index as f64 * std::f64::consts::PI * (3.0 - libm::sqrt(5.0));
        let radius = libm::sqrt(1.0 - z * z);
        let d = [radius * libm::cos(around), radius * libm::sin(around), z];
        let back: [f64; 3] = std::array::from_fn(|k| (0..3).map(|i| rotation[3 * i + k] * d[i]).sum());
        let here = sh::basis(band, d.map(|v| v as f32));
        let there = sh::basis(band, back.map(|v| v as f32));
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
    use super::*;

    /// A rotation about a skew axis.
    fn turn(angle: f64) -> [f64; 9] {
        let (c, s) = (libm::cos(angle), libm::sin(angle));
        let axis = [2.0 / 3.0, -1.0 / 3.0, 2.0 / 3.0];
        std::array::from_fn(|k| {
            let (i, j) = (k / 3, k % 3);
            let cross = match (i, j) {
                (0, 1) => -axis[2],
                (0, 2) => axis[1],
                (1, 0) => axis[2],
                (1, 2) => -axis[0],
                (2, 0) => -axis[1],
                (2, 1) => axis[0],
                _ => 0.0,
            };
            axis[i] * axis[j] * (1.0 - c) + cross * s + if i == j { c } else { 0.0 }
        })
    }

    #[test]
    fn quaternions_are_those_of_the_matrices() {
        for angle in [0.0, 0.3, 1.9, 3.1, -2.9, std::f64::consts::PI] {
            let matrix = turn(angle);
            let back = crate::project::rotation(quaternion(&matrix).map(|v| v as f32));
            for k in 0..9 {
                assert!(
                    (f64::from(back[k]) - matrix[k]).abs() < 1e-6,
                    "{angle}: {back:?} {matrix:?}"
                );
            }
        }
    }

    #[test]
    fn turned_harmonics_are_the_old_ones_seen_from_turned_directions() {
        let rotation = turn(1.1);
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
        let moved = scene.clone().moved(&rotation, &[0.5, 0.0, -1.0]);
        let Colour::Sh { coefficients: new, .. } = &moved.colour else {
            panic!("harmonics stay harmonics")
        };
        assert_eq!(new[..3], coefficients[..3]);
        for d in [[1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [-0.48, 0.6, 0.64]] {
            let turned: [f32; 3] =
                std::array::from_fn(|k| (0..3).map(|i| rotation[3 * k + i] * d[i]).sum::<f64>() as f32);
            let before = sh::evaluate(3, d.map(|v| v as f32), &coefficients);
            let after = sh::evaluate(3, turned, new);
            for c in 0..3 {
                assert!((before[c] - after[c]).abs() < 1e-5, "{before:?} {after:?}");
            }
        }
        let x: f64 = (0..3).map(|k| rotation[k] * f64::from(scene.means[k])).sum::<f64>() + 0.5;
        assert!((f64::from(moved.means[0]) - x).abs() < 1e-6);
    }
}
