//! Rotations as Euler angles, axis and angle, and quaternions.

use std::ops::{Add, Mul, Sub};

use glam::{DMat3, DQuat, DVec3};

/// `R = Rz(c) Ry(b) Rx(a)` for `[a, b, c]`, radians: the SciPy `"xyz"` (extrinsic) convention.
#[must_use]
pub fn rotation_from_euler_xyz([a, b, c]: [f64; 3]) -> DMat3 {
    let (sa, ca) = libm::sincos(a);
    let (sb, cb) = libm::sincos(b);
    let (sc, cc) = libm::sincos(c);
    DMat3::from_cols(
        DVec3::new(cc * cb, sc * cb, -sb),
        DVec3::new(cc * sb * sa - sc * ca, sc * sb * sa + cc * ca, cb * sa),
        DVec3::new(cc * sb * ca + sc * sa, sc * sb * ca - cc * sa, cb * ca),
    )
}

/// The Euler angles `[a, b, c]` of [`rotation_from_euler_xyz`]; at the pole `b = +-pi/2` the first angle is 0.
#[must_use]
pub fn euler_xyz_from_rotation(rotation: &DMat3) -> [f64; 3] {
    let (x, y, z) = (rotation.x_axis, rotation.y_axis, rotation.z_axis);
    let cos_b = libm::hypot(x.x, x.y);
    let b = libm::atan2(-x.z, cos_b);
    if cos_b > 1e-9 {
        [libm::atan2(y.z, z.z), b, libm::atan2(x.y, x.x)]
    } else {
        [0.0, b, libm::atan2(-y.x, y.y)]
    }
}

/// The rotation about a unit axis by an angle, radians.
#[must_use]
pub fn rotation_about_axis(axis: DVec3, angle: f64) -> DMat3 {
    let (sin, cos) = libm::sincos(angle);
    let rest = 1.0 - cos;
    let DVec3 { x, y, z } = axis;
    DMat3::from_cols(
        DVec3::new(cos + x * x * rest, x * y * rest + z * sin, x * z * rest - y * sin),
        DVec3::new(x * y * rest - z * sin, cos + y * y * rest, y * z * rest + x * sin),
        DVec3::new(x * z * rest + y * sin, y * z * rest - x * sin, cos + z * z * rest),
    )
}

/// The unit quaternion of a rotation, its real part not negative.
#[must_use]
pub fn quaternion(rotation: &DMat3) -> DQuat {
    non_negative(DQuat::from_mat3(rotation).normalize())
}

/// The quaternion itself, or its negative, which is the same rotation: the one whose real part is not negative.
#[must_use]
pub fn non_negative(quaternion: DQuat) -> DQuat {
    if quaternion.w < 0.0 { -quaternion } else { quaternion }
}

/// A unit quaternion of a rotation through its largest component, which is positive; of equal ones the first of w, x, y, z.
///
/// This is the rule of the networks' pose tokens (`docs/spec/stage1.md` section 4). It decides half turns, whose real part
/// is 0, by the components and not by the order of the arithmetic, as [`quaternion`] does.
#[must_use]
pub fn largest_component_quaternion(rotation: &DMat3) -> DQuat {
    let (x, y, z) = (rotation.x_axis, rotation.y_axis, rotation.z_axis);
    let (a, b, c) = (x.x, y.y, z.z);
    // Twice the components w, x, y, z.
    let squares = [1.0 + a + b + c, 1.0 + a - b - c, 1.0 - a + b - c, 1.0 - a - b + c];
    let sizes = squares.map(|value| value.max(0.0).sqrt());
    let mut largest = 0;
    for candidate in 1..4 {
        if sizes[candidate] > sizes[largest] {
            largest = candidate;
        }
    }
    let (difference_x, difference_y, difference_z) = (y.z - z.y, z.x - x.z, x.y - y.x);
    let (sum_xy, sum_xz, sum_yz) = (x.y + y.x, z.x + x.z, y.z + z.y);
    let own = sizes[largest] * sizes[largest];
    let [x, y, z, w] = match largest {
        0 => [difference_x, difference_y, difference_z, own],
        1 => [own, sum_xy, sum_xz, difference_x],
        2 => [sum_xy, own, sum_yz, difference_y],
        _ => [sum_xz, sum_yz, own, difference_z],
    };
    DQuat::from_xyzw(x, y, z, w) * (0.5 / sizes[largest])
}

/// Hamilton product `a b` of quaternions (w, x, y, z) of any length: the rotation `a` after `b`.
#[must_use]
pub fn quaternion_product<T>(a: [T; 4], b: [T; 4]) -> [T; 4]
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T>,
{
    let [aw, ax, ay, az] = a;
    let [bw, bx, by, bz] = b;
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
}

/// A quaternion as the fields hold it: (w, x, y, z) in `f32`.
#[must_use]
pub fn wxyz_f32(quaternion: DQuat) -> [f32; 4] {
    let DQuat { x, y, z, w } = quaternion;
    [w, x, y, z].map(|component| component as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn euler_angles_are_extrinsic_xyz() {
        let [a, b, c] = [0.3, -0.7, 1.1];
        let about = |axis, angle| rotation_about_axis(axis, angle);
        let expected = about(DVec3::Z, c) * about(DVec3::Y, b) * about(DVec3::X, a);
        assert!(
            (rotation_from_euler_xyz([a, b, c]) - expected)
                .to_cols_array()
                .iter()
                .all(|e| e.abs() < 1e-15)
        );
        let back = euler_xyz_from_rotation(&expected);
        assert!(back.iter().zip([a, b, c]).all(|(x, y)| (x - y).abs() < 1e-14));
    }

    #[test]
    fn the_pole_of_the_euler_angles_reproduces_the_rotation() {
        for b in [std::f64::consts::FRAC_PI_2, -std::f64::consts::FRAC_PI_2] {
            let rotation = rotation_from_euler_xyz([0.4, b, -1.2]);
            let again = rotation_from_euler_xyz(euler_xyz_from_rotation(&rotation));
            assert!((rotation - again).to_cols_array().iter().all(|e| e.abs() < 1e-12));
        }
    }

    #[test]
    fn quaternions_are_those_of_their_rotations() {
        let axis = DVec3::new(2.0, -1.0, 2.0) / 3.0;
        for angle in [0.0, 0.3, 1.9, 3.1, -2.9, 3.0 * std::f64::consts::FRAC_PI_2] {
            let rotation = rotation_about_axis(axis, angle);
            let largest = largest_component_quaternion(&rotation);
            for found in [quaternion(&rotation), largest, non_negative(largest)] {
                assert!(DMat3::from_quat(found).abs_diff_eq(rotation, 1e-12), "{angle}: {found}");
            }
            assert!(quaternion(&rotation).w >= 0.0 && non_negative(largest).w >= 0.0);
            let components = largest.to_array();
            let most = components.into_iter().fold(0.0, f64::max);
            assert!(components.iter().all(|component| component.abs() <= most + 1e-15));
        }
    }

    #[test]
    fn the_first_of_equal_components_of_a_half_turn_is_positive() {
        let half_turn = |axis: DVec3| rotation_about_axis(axis.normalize(), std::f64::consts::PI);
        let found = largest_component_quaternion(&half_turn(DVec3::new(-1.0, 2.0, 0.5)));
        assert!(
            found.y > 0.0 && found.x < 0.0 && found.z > 0.0 && found.w.abs() < 1e-15,
            "{found}"
        );
        let exact = DMat3::from_cols(DVec3::Y, DVec3::X, -DVec3::Z);
        let root = std::f64::consts::FRAC_1_SQRT_2;
        let found = largest_component_quaternion(&exact);
        assert!(
            (found - DQuat::from_xyzw(root, root, 0.0, 0.0)).length() < 1e-15,
            "{found}"
        );
    }

    #[test]
    fn products_are_compositions() {
        let (a, b) = (
            rotation_from_euler_xyz([0.1, -0.4, 2.0]),
            rotation_from_euler_xyz([-1.0, 0.2, 0.7]),
        );
        let both = quaternion_product(wxyz_f32(quaternion(&a)), wxyz_f32(quaternion(&b)));
        let expected = quaternion(&(a * b));
        let sign = if both[0] < 0.0 { -1.0 } else { 1.0 };
        for (found, expected) in both.iter().zip(wxyz_f32(expected)) {
            assert!((found * sign - expected).abs() < 1e-6, "{both:?}");
        }
    }
}
