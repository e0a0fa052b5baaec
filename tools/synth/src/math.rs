//! Rotations and seeded numbers. Trigonometry goes through `libm`, so that files do not depend on the
//! platform's.

use glam::{Affine3A, DAffine3, DMat3, DVec3, Vec3};
use rogs_geometry::Pose;
use rogs_random::Pcg64;

/// Rotation about x, radians.
pub(crate) fn rot_x(angle: f64) -> DMat3 {
    let (s, c) = (libm::sin(angle), libm::cos(angle));
    DMat3::from_cols(DVec3::X, DVec3::new(0.0, c, s), DVec3::new(0.0, -s, c))
}

/// Rotation about y, radians.
pub(crate) fn rot_y(angle: f64) -> DMat3 {
    let (s, c) = (libm::sin(angle), libm::cos(angle));
    DMat3::from_cols(DVec3::new(c, 0.0, -s), DVec3::Y, DVec3::new(s, 0.0, c))
}

/// Rotation about z, radians.
pub(crate) fn rot_z(angle: f64) -> DMat3 {
    let (s, c) = (libm::sin(angle), libm::cos(angle));
    DMat3::from_cols(DVec3::new(c, s, 0.0), DVec3::new(-s, c, 0.0), DVec3::Z)
}

/// Roll, pitch, yaw as URDF has them: `Rz(yaw) Ry(pitch) Rx(roll)`.
pub(crate) fn rot_rpy([roll, pitch, yaw]: [f64; 3]) -> DMat3 {
    rot_z(yaw) * rot_y(pitch) * rot_x(roll)
}

/// Rotation by `angle` radians about a unit axis.
pub(crate) fn rot_axis(axis: DVec3, angle: f64) -> DMat3 {
    let (s, c) = (libm::sin(angle), libm::cos(angle));
    let cross = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    DMat3::IDENTITY + cross * s + cross * cross * (1.0 - c)
}

/// The rotation vector (axis times angle) of a rotation by less than a half turn.
pub(crate) fn rotation_vector(r: &DMat3) -> DVec3 {
    let twice_sin = DVec3::new(
        r.y_axis.z - r.z_axis.y,
        r.z_axis.x - r.x_axis.z,
        r.x_axis.y - r.y_axis.x,
    );
    let sine = 0.5 * twice_sin.length();
    let cosine = 0.5 * (r.x_axis.x + r.y_axis.y + r.z_axis.z - 1.0);
    if sine < 1e-12 {
        return twice_sin * 0.5;
    }
    twice_sin * (libm::atan2(sine, cosine) / (2.0 * sine))
}

/// A transform in single precision, for drawing.
pub(crate) fn single<A, B>(pose: &Pose<A, B>) -> Affine3A {
    DAffine3::from_mat3_translation(pose.rotation, pose.translation).as_affine3a()
}

/// Rounds towards negative infinity. For numbers that fit into an `i32`; without SSE4.1 the library's is a call.
pub(crate) fn floor(x: f32) -> f32 {
    let cut = x as i32 as f32;
    if cut > x { cut - 1.0 } else { cut }
}

/// [`floor`] of each coordinate.
pub(crate) fn floor3(v: Vec3) -> Vec3 {
    Vec3::new(floor(v.x), floor(v.y), floor(v.z))
}

/// Minimum-jerk blend from 0 to 1.
pub(crate) fn minimum_jerk(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 - s * (15.0 - 6.0 * s))
}

/// A seeded source of numbers for one purpose of one episode.
pub(crate) struct Draw(Pcg64);

impl Draw {
    /// `purpose` keeps the streams of an episode apart, so that a change in one part leaves the others alone.
    pub(crate) fn new(seed: u64, purpose: u64) -> Self {
        Self(Pcg64::from_seeds(&[seed, purpose]))
    }

    /// Uniform in `[0, 1)`.
    pub(crate) fn unit(&mut self) -> f64 {
        self.0.next_double()
    }

    /// Uniform in `[low, high)`.
    pub(crate) fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform in `0..count`.
    pub(crate) fn index(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// True with probability `p`.
    pub(crate) fn chance(&mut self, p: f64) -> bool {
        self.unit() < p
    }

    /// Standard normal, cut at two deviations (by redrawing).
    pub(crate) fn normal(&mut self) -> f64 {
        loop {
            let u = 1.0 - self.unit();
            let v = self.unit();
            let z = libm::sqrt(-2.0 * libm::log(u)) * libm::cos(std::f64::consts::TAU * v);
            if z.abs() <= 2.0 {
                return z;
            }
        }
    }

    /// A vector of independent [`normal`](Self::normal) numbers times `scale`.
    pub(crate) fn normal3(&mut self, scale: f64) -> DVec3 {
        DVec3::new(self.normal(), self.normal(), self.normal()) * scale
    }
}

/// A linear RGB colour from hue in turns, saturation and value in [0, 1].
pub(crate) fn hsv(hue: f64, saturation: f64, value: f64) -> [f32; 3] {
    let channel = |offset: f64| {
        let k = (offset + hue * 6.0).rem_euclid(6.0);
        let amount = k.min(4.0 - k).clamp(0.0, 1.0);
        (value * (1.0 - saturation * amount)) as f32
    };
    [channel(5.0), channel(3.0), channel(1.0)].map(|c| c * c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_vectors_invert_axis_rotations() {
        let axis = DVec3::new(0.2, -0.5, 0.9).normalize();
        for angle in [1e-7, 0.3, 1.7, 3.0] {
            let back = rotation_vector(&rot_axis(axis, angle));
            assert!((back - axis * angle).length() < 1e-9, "{angle}");
        }
        let rpy = rot_rpy([0.1, 0.2, 0.3]);
        assert!((rpy.determinant() - 1.0).abs() < 1e-12);
        assert!((rot_axis(DVec3::Z, 0.4).x_axis - rot_z(0.4).x_axis).length() < 1e-15);
    }

    #[test]
    fn streams_of_one_seed_differ() {
        assert_ne!(Draw::new(3, 1).unit(), Draw::new(3, 2).unit());
        assert_eq!(Draw::new(3, 1).unit(), Draw::new(3, 1).unit());
    }
}
