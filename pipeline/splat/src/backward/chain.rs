//! Sections 9.3 to 9.6: from the sums over pixels to the parameters of one Gaussian and the camera.

use crate::camera::{Mode, RasterConfig, View};
use crate::gaussians::{Colour, Gaussians};
use crate::project::{FALLOFF, Projected, direction, rotation};
use crate::sh;

use super::MOMENTS;

/// Everything that is the same for all Gaussians.
pub(super) struct Chain<'a> {
    pub(super) gaussians: &'a Gaussians,
    pub(super) view: &'a View,
    pub(super) config: &'a RasterConfig,
}

/// Where the gradients of one Gaussian are added.
pub(super) struct Rows<'a> {
    pub(super) mean: &'a mut [f32],
    pub(super) quat: &'a mut [f32],
    pub(super) scale: &'a mut [f32],
    pub(super) opacity: &'a mut f32,
    pub(super) colour: &'a mut [f32],
    pub(super) extra: &'a mut [f32],
}

/// Sums over Gaussians.
#[derive(Debug, Default)]
pub(super) struct CameraGradient {
    pub(super) rotation: [f64; 9],
    pub(super) translation: [f64; 3],
    pub(super) not_finite: usize,
}

impl Chain<'_> {
    /// Adds the gradients of one Gaussian, unless they are not finite.
    pub(super) fn run(
        &self,
        index: usize,
        record: &Projected,
        sums: &[f32],
        out: Rows<'_>,
        camera: &mut CameraGradient,
    ) {
        let Self {
            gaussians,
            view,
            config,
        } = self;
        let mean: [f32; 3] = std::array::from_fn(|k| gaussians.means[3 * index + k]);
        let raw_quat: [f32; 4] = std::array::from_fn(|k| gaussians.quats[4 * index + k]);
        let scale: [f32; 3] = std::array::from_fn(|k| gaussians.scales[3 * index + k]);
        let r = &view.r;

        // The forward pass again: camera space, J, N = R R_q diag(s), U = J N.
        let x = r[0] * mean[0] + r[1] * mean[1] + r[2] * mean[2] + view.t[0];
        let y = r[3] * mean[0] + r[4] * mean[1] + r[5] * mean[2] + view.t[1];
        let z = record.z;
        let inv_z = 1.0 / z;
        let (xz, yz) = (x * inv_z, y * inv_z);
        let (ux, uy) = (
            xz.clamp(view.limits[0], view.limits[1]),
            yz.clamp(view.limits[2], view.limits[3]),
        );
        let (fx, fy) = (view.fx, view.fy);
        let j = [fx * inv_z, 0.0, -fx * ux * inv_z, 0.0, fy * inv_z, -fy * uy * inv_z];
        let norm = raw_quat.iter().map(|q| q * q).sum::<f32>().sqrt();
        let quat = raw_quat.map(|q| q / norm);
        let rq = rotation(quat);
        let m: [f32; 9] = std::array::from_fn(|k| rq[k] * scale[k % 3]);
        let n = multiply(r, &m);
        let u: [f32; 6] = std::array::from_fn(|k| {
            let (row, column) = (k / 3, k % 3);
            (0..3).map(|i| j[3 * row + i] * n[3 * i + column]).sum()
        });

        // Projected covariance, and the gradients with respect to it and to the mean in pixels. With
        // p = lc dy^2 - l^2, la = sqrt(k c / det), lb = -la b / c, lc = -k / c and dL/dp = ln 2 dp, every sum below is
        // one of squares or products of small numbers, also for needles.
        let dot3 = |i: usize, k: usize| u[i] * u[k] + u[i + 1] * u[k + 1] + u[i + 2] * u[k + 2];
        let (a, b, c) = (dot3(0, 0) + config.eps2d, dot3(0, 3), dot3(3, 3) + config.eps2d);
        let (la, lb, lc) = (record.la, record.lb, record.lc);
        // la^2 = k c / det.
        let det = FALLOFF * c / (la * la);
        let ln2 = std::f32::consts::LN_2;
        let g_mx = -2.0 * ln2 * la * sums[1];
        let g_my = 2.0 * ln2 * (lc * sums[2] - lb * sums[1]);
        let slope = b / c;
        let (m_ll, m_ly, m_yy) = (ln2 * sums[3], ln2 * sums[4], ln2 * sums[5]);
        let mut s00 = m_ll * c / det;
        let mut s01 = -m_ll * b / det + m_ly * la / c;
        let mut s11 = m_ll * slope * b / det - 2.0 * m_ly * la * slope / c + m_yy * FALLOFF / (c * c);
        let mut g_opacity = sums[0] / record.opacity;
        if config.mode == Mode::Antialiased {
            let rho = record.opacity / gaussians.opacities[index];
            g_opacity *= rho;
            if rho > config.min_compensation && rho > 0.0 {
                // g_rho = o g_o' = sums[0] / rho.
                let half = 0.5 * sums[0] / (rho * rho);
                let (keep, low_pass) = ((1.0 - rho * rho) / det, config.eps2d / det);
                s00 += half * (keep * c - low_pass);
                s01 -= half * keep * b;
                s11 += half * (keep * a - low_pass);
            }
        }

        // S2 = U U^T: G_U = 2 G_S U, G_J = G_U N^T, G_N = J^T G_U.
        let g_u: [f32; 6] = std::array::from_fn(|k| {
            let column = k % 3;
            if k < 3 {
                2.0 * (s00 * u[column] + s01 * u[3 + column])
            } else {
                2.0 * (s01 * u[column] + s11 * u[3 + column])
            }
        });
        let g_j = |row: usize, i: usize| -> f32 { (0..3).map(|k| g_u[3 * row + k] * n[3 * i + k]).sum() };
        let g_n: [f32; 9] = std::array::from_fn(|k| {
            let (i, column) = (k / 3, k % 3);
            j[i] * g_u[column] + j[3 + i] * g_u[3 + column]
        });

        // Section 9.5: the camera-space gradient of the mean.
        let (g00, g02, g11, g12) = (g_j(0, 0), g_j(0, 2), g_j(1, 1), g_j(1, 2));
        let inv_z2 = inv_z * inv_z;
        let mut h = [fx * inv_z * g_mx, fy * inv_z * g_my, 0.0];
        h[2] = -(fx * x * g_mx + fy * y * g_my) * inv_z2 + sums[9] - (fx * g00 + fy * g11) * inv_z2;
        let mut clamped = |axis: usize, ratio: f32, low: f32, high: f32, f: f32, clamped: f32, g: f32| {
            if ratio >= low && ratio <= high {
                h[axis] -= f * inv_z2 * g;
                h[2] += 2.0 * f * clamped * inv_z2 * g;
            } else {
                h[2] += f * clamped * inv_z2 * g;
            }
        };
        clamped(0, xz, view.limits[0], view.limits[1], fx, ux, g02);
        clamped(1, yz, view.limits[2], view.limits[3], fy, uy, g12);
        let mut g_mean: [f32; 3] = std::array::from_fn(|k| r[k] * h[0] + r[3 + k] * h[1] + r[6 + k] * h[2]);

        // Section 9.6.
        let g_m: [f32; 9] = std::array::from_fn(|k| {
            let (row, column) = (k / 3, k % 3);
            r[row] * g_n[column] + r[3 + row] * g_n[3 + column] + r[6 + row] * g_n[6 + column]
        });
        let g_scale: [f32; 3] =
            std::array::from_fn(|k| rq[k] * g_m[k] + rq[3 + k] * g_m[3 + k] + rq[6 + k] * g_m[6 + k]);
        let v: [f32; 9] = std::array::from_fn(|k| g_m[k] * scale[k % 3]);
        let g_quat = quaternion(quat, norm, &v);

        // Section 9.4.
        let g_rgb = [sums[6], sums[7], sums[8]];
        let (g_colour, g_direction_mean) = self.colour(index, record, g_rgb);
        for k in 0..3 {
            g_mean[k] += g_direction_mean[k];
        }

        let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
        let harmonics = &g_colour[..gaussians.colour.values_per_gaussian()];
        if !(finite(&g_mean) && finite(&g_scale) && finite(&g_quat) && finite(harmonics) && g_opacity.is_finite()) {
            camera.not_finite += 1;
            return;
        }
        let add = |to: &mut [f32], from: &[f32]| to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        add(out.mean, &g_mean);
        add(out.quat, &g_quat);
        add(out.scale, &g_scale);
        *out.opacity += g_opacity;
        add(out.colour, harmonics);
        add(out.extra, &sums[MOMENTS..]);

        // Camera: p_c = R mu + t, N = R M, and the direction through the camera centre -R^T t.
        for i in 0..3 {
            camera.translation[i] += f64::from(h[i]);
            for k in 0..3 {
                let through_n: f32 = (0..3).map(|l| g_n[3 * i + l] * m[3 * k + l]).sum();
                // g_centre = -g_direction_mean and centre_k = -sum_i R_ik t_i.
                let through_centre = view.t[i] * g_direction_mean[k];
                camera.rotation[3 * i + k] += f64::from(h[i] * mean[k] + through_n + through_centre);
                camera.translation[i] += f64::from(r[3 * i + k] * g_direction_mean[k]);
            }
        }
    }

    /// Gradients with respect to the colour values and, through the direction, to the mean.
    fn colour(&self, index: usize, record: &Projected, g_rgb: [f32; 3]) -> ([f32; 48], [f32; 3]) {
        let mut g_colour = [0.0; 48];
        let Colour::Sh { degree, coefficients } = &self.gaussians.colour else {
            g_colour[..3].copy_from_slice(&g_rgb);
            return (g_colour, [0.0; 3]);
        };
        let count = sh::coefficient_count(*degree);
        let coefficients = &coefficients[3 * count * index..3 * count * (index + 1)];
        let (direction, distance) = direction(&self.gaussians.means[3 * index..3 * index + 3], self.view);
        // A colour that was clamped to 0 passes nothing on.
        let g: [f32; 3] = std::array::from_fn(|c| if record.rgb[c] > 0.0 { g_rgb[c] } else { 0.0 });
        let basis = sh::basis(*degree, direction);
        let slopes = sh::basis_gradient(*degree, direction);
        let mut g_direction = [0.0; 3];
        for k in 0..count {
            let along: f32 = (0..3).map(|c| coefficients[3 * k + c] * g[c]).sum();
            for c in 0..3 {
                g_colour[3 * k + c] = basis[k] * g[c];
                g_direction[c] += along * slopes[k][c];
            }
        }
        if *degree == 0 || distance <= 0.0 {
            return (g_colour, [0.0; 3]);
        }
        let radial: f32 = (0..3).map(|k| direction[k] * g_direction[k]).sum();
        (
            g_colour,
            std::array::from_fn(|k| (g_direction[k] - direction[k] * radial) / distance),
        )
    }
}

/// Gradient with respect to the quaternion as given, from that with respect to its rotation matrix.
fn quaternion([w, x, y, z]: [f32; 4], norm: f32, v: &[f32; 9]) -> [f32; 4] {
    let e = [
        2.0 * (x * (v[7] - v[5]) + y * (v[2] - v[6]) + z * (v[3] - v[1])),
        2.0 * (-2.0 * x * (v[4] + v[8]) + y * (v[3] + v[1]) + z * (v[6] + v[2]) + w * (v[7] - v[5])),
        2.0 * (x * (v[3] + v[1]) - 2.0 * y * (v[0] + v[8]) + z * (v[7] + v[5]) + w * (v[2] - v[6])),
        2.0 * (x * (v[6] + v[2]) + y * (v[7] + v[5]) - 2.0 * z * (v[0] + v[4]) + w * (v[3] - v[1])),
    ];
    let q = [w, x, y, z];
    let radial: f32 = (0..4).map(|k| q[k] * e[k]).sum();
    std::array::from_fn(|k| (e[k] - q[k] * radial) / norm)
}

fn multiply(a: &[f32; 9], b: &[f32; 9]) -> [f32; 9] {
    std::array::from_fn(|k| {
        let (row, column) = (k / 3, k % 3);
        a[3 * row] * b[column] + a[3 * row + 1] * b[3 + column] + a[3 * row + 2] * b[6 + column]
    })
}
