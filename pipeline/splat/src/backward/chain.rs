//! `docs/spec/rasteriser.md` sections 9.3 to 9.6: from the sums over pixels to the parameters of the Gaussians and the
//! camera.
//!
//! Sixteen Gaussians at a time, in plain lane loops that the compiler vectorises (see `project`).

use pulp::{Simd, WithSimd};

use crate::camera::{Mode, RasterConfig, View};
use crate::gaussians::{Colour, Gaussians};
use crate::project::{FALLOFF, Projected, direction, rotation};
use crate::sh;
use crate::simd::LANES;

use super::MOMENTS;

/// The Gaussians of one chunk: what is known of them and where their gradients go.
pub(super) struct Chain<'a> {
    pub(super) gaussians: &'a Gaussians,
    pub(super) view: &'a View,
    pub(super) config: &'a RasterConfig,
    /// Records of the chunk, and their sums over tiles, `[records, MOMENTS + E]`.
    pub(super) records: &'a [Projected],
    pub(super) sums: &'a [f32],
    /// Index of the chunk's first Gaussian.
    pub(super) first: usize,
    /// Whether `rows` holds zeros, so that it need not be read.
    pub(super) fresh: bool,
    pub(super) rows: Rows<'a>,
}

/// Gradients of the chunk's Gaussians.
pub(super) struct Rows<'a> {
    pub(super) means: &'a mut [f32],
    pub(super) quats: &'a mut [f32],
    pub(super) scales: &'a mut [f32],
    pub(super) opacities: &'a mut [f32],
    pub(super) colours: &'a mut [f32],
    pub(super) extra: &'a mut [f32],
    /// Empty where nobody asks for it.
    pub(super) screen: &'a mut [f32],
}

/// Sums over Gaussians.
#[derive(Debug, Default)]
pub(super) struct CameraGradient {
    pub(super) rotation: [f64; 9],
    pub(super) translation: [f64; 3],
    pub(super) not_finite: usize,
}

type L = [f32; LANES];

/// Inputs of sixteen Gaussians, component-major.
struct Input {
    mean: [L; 3],
    quat: [L; 4],
    scale: [L; 3],
    opacity: L,
    /// From the record: la, lb, lc, opacity with compensation, z.
    record: [L; 5],
    sums: [L; MOMENTS],
}

/// Gradients of sixteen Gaussians, component-major.
struct Output {
    mean: [L; 3],
    quat: [L; 4],
    scale: [L; 3],
    opacity: L,
    screen: [L; 2],
    /// Rotation 9, translation 3.
    camera: [L; 12],
    /// 0 where all of the above are finite, not a number elsewhere.
    check: L,
}

impl WithSimd for Chain<'_> {
    type Output = CameraGradient;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _simd: S) -> CameraGradient {
        let stride = MOMENTS + self.gaussians.extra_channels;
        let mut input = Input::new();
        let mut output = Output::new();
        let mut camera = CameraGradient::default();
        let mut poses = [[0.0_f64; LANES]; 12];
        let mut live = [0; LANES];
        let mut count = 0;
        let records = self.records.len();
        for local in 0..records {
            let own = &self.sums[local * stride..(local + 1) * stride];
            if own.iter().any(|&s| s != 0.0) {
                input.put(count, self.gaussians, &self.records[local], own);
                live[count] = local;
                count += 1;
            }
            if count == LANES || (local + 1 == records && count > 0) {
                chain_lanes(&input, self.view, self.config, &mut output);
                let mut counted = [0.0; LANES];
                for lane in 0..count {
                    let taken = self.take(live[lane], lane, &mut output, stride);
                    camera.not_finite += usize::from(!taken);
                    counted[lane] = f32::from(taken);
                }
                add_poses(&output, &counted, &mut poses);
                count = 0;
            }
        }
        for (k, lanes) in poses.iter().enumerate() {
            let sum = lanes.iter().sum();
            if k < 9 {
                camera.rotation[k] = sum;
            } else {
                camera.translation[k - 9] = sum;
            }
        }
        camera
    }
}

impl Chain<'_> {
    /// Adds the gradients of one lane to its Gaussian's, unless they are not finite.
    #[inline(always)]
    fn take(&mut self, local: usize, lane: usize, output: &mut Output, stride: usize) -> bool {
        let record = &self.records[local];
        let sums = &self.sums[local * stride..(local + 1) * stride];
        let row = record.gaussian as usize - self.first;
        let mut mean = [output.mean[0][lane], output.mean[1][lane], output.mean[2][lane]];
        let [w, x, y, z] = &output.quat;
        let quat = [w[lane], x[lane], y[lane], z[lane]];
        let scale = [output.scale[0][lane], output.scale[1][lane], output.scale[2][lane]];
        let opacity = output.opacity[lane];
        let finite = |values: &[f32]| values.iter().fold(0.0_f32, |sum, v| sum + v * 0.0) == 0.0;
        let extra = &sums[MOMENTS..];
        if output.check[lane] != 0.0 || (!extra.is_empty() && !finite(extra)) {
            return false;
        }
        let fresh = self.fresh;
        let add = |to: &mut [f32], from: &[f32]| {
            for (to, from) in to.iter_mut().zip(from) {
                *to = if fresh { *from } else { *to + *from };
            }
        };
        if let Colour::Sh { degree, coefficients } = &self.gaussians.colour {
            let (colour, through_mean) = self.harmonics(record, [sums[6], sums[7], sums[8]], *degree, coefficients);
            let colour = &colour[..3 * sh::coefficient_count(*degree)];
            for k in 0..3 {
                mean[k] += through_mean[k];
                for i in 0..3 {
                    // g_centre = -g_mean and centre_k = -sum_i R_ik t_i.
                    output.camera[3 * i + k][lane] += self.view.t[i] * through_mean[k];
                    output.camera[9 + i][lane] += self.view.r[3 * i + k] * through_mean[k];
                }
            }
            if !finite(colour) || !finite(&mean) {
                return false;
            }
            let per = colour.len();
            add(&mut self.rows.colours[per * row..per * (row + 1)], colour);
        }
        if matches!(self.gaussians.colour, Colour::Rgb(_)) {
            add(&mut self.rows.colours[3 * row..3 * row + 3], &sums[6..9]);
        }
        add(&mut self.rows.means[3 * row..3 * row + 3], &mean);
        add(&mut self.rows.quats[4 * row..4 * row + 4], &quat);
        add(&mut self.rows.scales[3 * row..3 * row + 3], &scale);
        add(&mut self.rows.opacities[row..=row], &[opacity]);
        let channels = extra.len();
        add(&mut self.rows.extra[channels * row..channels * (row + 1)], extra);
        if let Some(screen) = self.rows.screen.get_mut(2 * row..2 * row + 2) {
            add(screen, &[output.screen[0][lane], output.screen[1][lane]]);
        }
        true
    }

    /// Section 9.4: gradients with respect to the coefficients and, through the direction, to the mean.
    fn harmonics(
        &self,
        record: &Projected,
        g_rgb: [f32; 3],
        degree: usize,
        coefficients: &[f32],
    ) -> ([f32; 48], [f32; 3]) {
        let index = record.gaussian as usize;
        let mut g_colour = [0.0; 48];
        let count = sh::coefficient_count(degree);
        let coefficients = &coefficients[3 * count * index..3 * count * (index + 1)];
        let (direction, distance) = direction(&self.gaussians.means[3 * index..3 * index + 3], self.view);
        // A colour that was clamped to 0 passes nothing on.
        let g: [f32; 3] = std::array::from_fn(|c| if record.rgb[c] > 0.0 { g_rgb[c] } else { 0.0 });
        let basis = sh::basis(degree, direction);
        let slopes = sh::basis_gradient(degree, direction);
        let mut g_direction = [0.0; 3];
        for k in 0..count {
            let along: f32 = (0..3).map(|c| coefficients[3 * k + c] * g[c]).sum();
            for c in 0..3 {
                g_colour[3 * k + c] = basis[k] * g[c];
                g_direction[c] += along * slopes[k][c];
            }
        }
        if degree == 0 || distance <= 0.0 {
            return (g_colour, [0.0; 3]);
        }
        let radial: f32 = (0..3).map(|k| direction[k] * g_direction[k]).sum();
        (
            g_colour,
            std::array::from_fn(|k| (g_direction[k] - direction[k] * radial) / distance),
        )
    }
}

impl Input {
    fn new() -> Self {
        // Ones, so that lanes that are never filled compute ordinary numbers.
        let one = [1.0; LANES];
        Self {
            mean: [one; 3],
            quat: [one; 4],
            scale: [one; 3],
            opacity: one,
            record: [one; 5],
            sums: [one; MOMENTS],
        }
    }

    #[inline(always)]
    fn put(&mut self, lane: usize, gaussians: &Gaussians, record: &Projected, sums: &[f32]) {
        let index = record.gaussian as usize;
        for k in 0..3 {
            self.mean[k][lane] = gaussians.means[3 * index + k];
            self.scale[k][lane] = gaussians.scales[3 * index + k];
        }
        for k in 0..4 {
            self.quat[k][lane] = gaussians.quats[4 * index + k];
        }
        self.opacity[lane] = gaussians.opacities[index];
        for (k, value) in [record.la, record.lb, record.lc, record.opacity, record.z]
            .into_iter()
            .enumerate()
        {
            self.record[k][lane] = value;
        }
        for k in 0..MOMENTS {
            self.sums[k][lane] = sums[k];
        }
    }
}

impl Output {
    fn new() -> Self {
        let zero = [0.0; LANES];
        Self {
            mean: [zero; 3],
            quat: [zero; 4],
            scale: [zero; 3],
            opacity: zero,
            screen: [zero; 2],
            camera: [zero; 12],
            check: zero,
        }
    }
}

/// Adds the pose gradients of the lanes that count.
#[inline(always)]
fn add_poses(output: &Output, counted: &L, poses: &mut [[f64; LANES]; 12]) {
    for k in 0..12 {
        for lane in 0..LANES {
            let value = if counted[lane] > 0.0 {
                output.camera[k][lane]
            } else {
                0.0
            };
            poses[k][lane] += f64::from(value);
        }
    }
}

/// Everything but colours, without branches.
#[inline(always)]
#[expect(clippy::too_many_lines, reason = "one derivation, step by step in the order of the formulas")]
fn chain_lanes(input: &Input, view: &View, config: &RasterConfig, out: &mut Output) {
    let r = view.r;
    let (fx, fy) = (view.fx, view.fy);
    let antialiased = config.mode == Mode::Antialiased;
    for lane in 0..LANES {
        let mean = [input.mean[0][lane], input.mean[1][lane], input.mean[2][lane]];
        let raw = [
            input.quat[0][lane],
            input.quat[1][lane],
            input.quat[2][lane],
            input.quat[3][lane],
        ];
        let scale = [input.scale[0][lane], input.scale[1][lane], input.scale[2][lane]];
        let [la, lb, lc, opacity, z] = [0, 1, 2, 3, 4].map(|k| input.record[k][lane]);
        let sum = |k: usize| input.sums[k][lane];

        // The forward pass again: camera space, J, N = R R_q diag(s), U = J N.
        let x = r[0] * mean[0] + r[1] * mean[1] + r[2] * mean[2] + view.t[0];
        let y = r[3] * mean[0] + r[4] * mean[1] + r[5] * mean[2] + view.t[1];
        let inv_z = 1.0 / z;
        let (xz, yz) = (x * inv_z, y * inv_z);
        let ux = xz.min(view.limits[1]).max(view.limits[0]);
        let uy = yz.min(view.limits[3]).max(view.limits[2]);
        let (j0, j2, j4, j5) = (fx * inv_z, -fx * ux * inv_z, fy * inv_z, -fy * uy * inv_z);
        let inv_norm = 1.0 / (raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3]).sqrt();
        let quat = [
            raw[0] * inv_norm,
            raw[1] * inv_norm,
            raw[2] * inv_norm,
            raw[3] * inv_norm,
        ];
        let rq = rotation(quat);
        let m = scaled(&rq, scale);
        let n = multiply(&r, &m);
        let u = [j0 * n[0] + j2 * n[6], j0 * n[1] + j2 * n[7], j0 * n[2] + j2 * n[8]];
        let v = [j4 * n[3] + j5 * n[6], j4 * n[4] + j5 * n[7], j4 * n[5] + j5 * n[8]];

        // Projected covariance, and the gradients with respect to it and to the mean in pixels. With
        // p = lc dy^2 - l^2, la = sqrt(k c / det), lb = -la b / c, lc = -k / c and dL/dp = ln 2 dp, every sum below is
        // one of squares or products of small numbers, also for needles.
        let a = u[0] * u[0] + u[1] * u[1] + u[2] * u[2] + config.eps2d;
        let b = u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
        let c = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + config.eps2d;
        let inv_c = 1.0 / c;
        let inv_det = la * la / FALLOFF * inv_c;
        let ln2 = std::f32::consts::LN_2;
        let g_mx = -2.0 * ln2 * la * sum(1);
        let g_my = 2.0 * ln2 * (lc * sum(2) - lb * sum(1));
        let slope = b * inv_c;
        let (m_ll, m_ly, m_yy) = (ln2 * sum(3) * inv_det, ln2 * sum(4) * la * inv_c, ln2 * sum(5));
        let mut s00 = m_ll * c;
        let mut s01 = m_ly - m_ll * b;
        let mut s11 = m_ll * slope * b - 2.0 * m_ly * slope + m_yy * FALLOFF * inv_c * inv_c;
        let mut g_opacity = sum(0) / opacity;
        if antialiased {
            let rho = opacity / input.opacity[lane];
            g_opacity *= rho;
            // g_rho = o g_o' = sum(0) / rho; nothing passes at the floor.
            let above = (rho > config.min_compensation) & (rho > 0.0);
            let half = if above { 0.5 * sum(0) / (rho * rho) } else { 0.0 };
            let (keep, low_pass) = ((1.0 - rho * rho) * inv_det, config.eps2d * inv_det);
            s00 += half * (keep * c - low_pass);
            s01 -= half * keep * b;
            s11 += half * (keep * a - low_pass);
        }

        // S2 = (U; V)(U; V)^T: G_U = 2 G_S (U; V), G_J = G_U N^T, G_N = J^T G_U.
        let gu = [0, 1, 2].map(|k| 2.0 * (s00 * u[k] + s01 * v[k]));
        let gv = [0, 1, 2].map(|k| 2.0 * (s01 * u[k] + s11 * v[k]));
        let dot = |g: &[f32; 3], i: usize| g[0] * n[3 * i] + g[1] * n[3 * i + 1] + g[2] * n[3 * i + 2];
        let (g00, g02, g11, g12) = (dot(&gu, 0), dot(&gu, 2), dot(&gv, 1), dot(&gv, 2));
        let g_n = [
            j0 * gu[0],
            j0 * gu[1],
            j0 * gu[2],
            j4 * gv[0],
            j4 * gv[1],
            j4 * gv[2],
            j2 * gu[0] + j5 * gv[0],
            j2 * gu[1] + j5 * gv[1],
            j2 * gu[2] + j5 * gv[2],
        ];

        // Section 9.5: the camera-space gradient of the mean; where the Jacobian is clamped, x/z is a constant in it.
        let inv_z2 = inv_z * inv_z;
        let free_x = if (xz >= view.limits[0]) & (xz <= view.limits[1]) {
            1.0
        } else {
            0.0
        };
        let free_y = if (yz >= view.limits[2]) & (yz <= view.limits[3]) {
            1.0
        } else {
            0.0
        };
        let h = [
            fx * inv_z * g_mx - free_x * fx * inv_z2 * g02,
            fy * inv_z * g_my - free_y * fy * inv_z2 * g12,
            inv_z2
                * ((1.0 + free_x) * fx * ux * g02 + (1.0 + free_y) * fy * uy * g12
                    - fx * (x * g_mx + g00)
                    - fy * (y * g_my + g11))
                + sum(9),
        ];

        // Section 9.6.
        let g_m = multiply_transposed(&r, &g_n);
        let v_r = scaled(&g_m, scale);
        let g_quat = quaternion(quat, inv_norm, &v_r);
        for k in 0..3 {
            out.mean[k][lane] = r[k] * h[0] + r[3 + k] * h[1] + r[6 + k] * h[2];
            out.scale[k][lane] = rq[k] * g_m[k] + rq[3 + k] * g_m[3 + k] + rq[6 + k] * g_m[6 + k];
            out.camera[9 + k][lane] = h[k];
            for i in 0..3 {
                // p_c = R mu + t and N = R M.
                let through_n = g_n[3 * i] * m[3 * k] + g_n[3 * i + 1] * m[3 * k + 1] + g_n[3 * i + 2] * m[3 * k + 2];
                out.camera[3 * i + k][lane] = h[i] * mean[k] + through_n;
            }
        }
        for k in 0..4 {
            out.quat[k][lane] = g_quat[k];
        }
        out.opacity[lane] = g_opacity;
        out.screen[0][lane] = g_mx;
        out.screen[1][lane] = g_my;
        let mut check = g_opacity * 0.0;
        for k in 0..3 {
            check += out.mean[k][lane] * 0.0 + out.scale[k][lane] * 0.0 + sum(6 + k) * 0.0;
        }
        for k in 0..12 {
            check += out.camera[k][lane] * 0.0;
        }
        out.check[lane] = check + (g_quat[0] * 0.0 + g_quat[1] * 0.0 + g_quat[2] * 0.0 + g_quat[3] * 0.0);
    }
}

/// Gradient with respect to the quaternion as given, from that with respect to its rotation matrix.
#[inline(always)]
fn quaternion([w, x, y, z]: [f32; 4], inv_norm: f32, v: &[f32; 9]) -> [f32; 4] {
    let e = [
        2.0 * (x * (v[7] - v[5]) + y * (v[2] - v[6]) + z * (v[3] - v[1])),
        2.0 * (-2.0 * x * (v[4] + v[8]) + y * (v[3] + v[1]) + z * (v[6] + v[2]) + w * (v[7] - v[5])),
        2.0 * (x * (v[3] + v[1]) - 2.0 * y * (v[0] + v[8]) + z * (v[7] + v[5]) + w * (v[2] - v[6])),
        2.0 * (x * (v[6] + v[2]) + y * (v[7] + v[5]) - 2.0 * z * (v[0] + v[4]) + w * (v[3] - v[1])),
    ];
    let radial = w * e[0] + x * e[1] + y * e[2] + z * e[3];
    [
        (e[0] - w * radial) * inv_norm,
        (e[1] - x * radial) * inv_norm,
        (e[2] - y * radial) * inv_norm,
        (e[3] - z * radial) * inv_norm,
    ]
}

/// Columns times scales.
#[inline(always)]
fn scaled(a: &[f32; 9], s: [f32; 3]) -> [f32; 9] {
    [
        a[0] * s[0],
        a[1] * s[1],
        a[2] * s[2],
        a[3] * s[0],
        a[4] * s[1],
        a[5] * s[2],
        a[6] * s[0],
        a[7] * s[1],
        a[8] * s[2],
    ]
}

#[inline(always)]
fn multiply(a: &[f32; 9], b: &[f32; 9]) -> [f32; 9] {
    let at = |i: usize, k: usize| a[3 * i] * b[k] + a[3 * i + 1] * b[3 + k] + a[3 * i + 2] * b[6 + k];
    [
        at(0, 0),
        at(0, 1),
        at(0, 2),
        at(1, 0),
        at(1, 1),
        at(1, 2),
        at(2, 0),
        at(2, 1),
        at(2, 2),
    ]
}

/// A^T B.
#[inline(always)]
fn multiply_transposed(a: &[f32; 9], b: &[f32; 9]) -> [f32; 9] {
    let at = |i: usize, k: usize| a[i] * b[k] + a[3 + i] * b[3 + k] + a[6 + i] * b[6 + k];
    [
        at(0, 0),
        at(0, 1),
        at(0, 2),
        at(1, 0),
        at(1, 1),
        at(1, 2),
        at(2, 0),
        at(2, 1),
        at(2, 2),
    ]
}
