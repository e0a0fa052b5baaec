//! The rigid motion that takes one set of weighted points to another (`docs/spec/baseline-som.md` section 4).

use glam::{DMat3, DQuat, DVec3};

/// Sweeps of the eigenvalue iteration; it converges quadratically and is done after six or so.
const SWEEPS: usize = 24;

/// Rotation R and translation t that make `sum w |R source + t - target|^2` smallest; R is proper even where a reflection
/// would fit better. `None` where the weights have no positive, finite sum.
///
/// R is the eigenvector of the largest eigenvalue of Horn's 4 x 4 matrix, which is the optimum of the singular value
/// decomposition with its sign turned where the determinant asks for it.
#[must_use]
pub fn rigid_motion(source: &[DVec3], target: &[DVec3], weights: &[f64]) -> Option<(DMat3, DVec3)> {
    let total: f64 = weights.iter().sum();
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    let mean = |points: &[DVec3]| points.iter().zip(weights).map(|(&p, &w)| p * w).sum::<DVec3>() / total;
    let (from, to) = (mean(source), mean(target));
    let mut s = [[0.0; 3]; 3];
    for ((&a, &b), &w) in source.iter().zip(target).zip(weights) {
        let (a, b) = ((a - from).to_array(), (b - to).to_array());
        for i in 0..3 {
            for j in 0..3 {
                s[i][j] += w / total * a[i] * b[j];
            }
        }
    }
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = s;
    let matrix = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ];
    let [w, x, y, z] = largest_eigenvector(matrix);
    let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let translation = to - rotation * from;
    (rotation.is_finite() && translation.is_finite()).then_some((rotation, translation))
}

/// Eigenvector of the largest eigenvalue of a symmetric matrix, by Jacobi rotations in a fixed order.
fn largest_eigenvector(mut a: [[f64; 4]; 4]) -> [f64; 4] {
    let mut v = [[0.0; 4]; 4];
    for k in 0..4 {
        v[k][k] = 1.0;
    }
    for _ in 0..SWEEPS {
        for p in 0..3 {
            for q in p + 1..4 {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for k in 0..4 {
                    let (kp, kq) = (a[k][p], a[k][q]);
                    (a[k][p], a[k][q]) = (c * kp - s * kq, s * kp + c * kq);
                }
                for k in 0..4 {
                    let (pk, qk) = (a[p][k], a[q][k]);
                    (a[p][k], a[q][k]) = (c * pk - s * qk, s * pk + c * qk);
                    let (kp, kq) = (v[k][p], v[k][q]);
                    (v[k][p], v[k][q]) = (c * kp - s * kq, s * kp + c * kq);
                }
            }
        }
    }
    let largest = (1..4).fold(0, |best, k| if a[k][k] > a[best][best] { k } else { best });
    std::array::from_fn(|k| v[k][largest])
}

#[cfg(test)]
mod tests {
    use rogs_geometry::rotation_from_euler_xyz;

    use super::*;

    #[test]
    fn a_rigid_motion_is_found_again() {
        let source: Vec<DVec3> = (0..9)
            .map(|k| DVec3::new(f64::from(k * 5 % 7), f64::from(k * 3 % 5), f64::from(k % 4)))
            .collect();
        for angles in [[0.0; 3], [0.3, -1.2, 2.9], [std::f64::consts::PI, 0.0, 0.0]] {
            let (rotation, shift) = (rotation_from_euler_xyz(angles), DVec3::new(0.2, -3.0, 1.0));
            let target: Vec<DVec3> = source.iter().map(|&p| rotation * p + shift).collect();
            let weights: Vec<f64> = (0..9).map(|k| 1.0 + f64::from(k)).collect();
            let (r, t) = rigid_motion(&source, &target, &weights).unwrap();
            assert!(r.abs_diff_eq(rotation, 1e-12) && t.abs_diff_eq(shift, 1e-11), "{r} {t}");
        }
        assert!(rigid_motion(&source, &source, &[0.0; 9]).is_none());
    }
}
