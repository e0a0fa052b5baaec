//! From the sums of the pairs to the parameters of the Gaussians and the cameras (`docs/spec/rasteriser.md` sections 9.3 to
//! 9.6). The formulas are those of `crate::backward`.

use cubecl::prelude::*;

use super::math::{View, basis, basis_gradient, is_finite, load_view, rotation};
use super::project::PLAIN;
use super::{ENTRY, MOMENTS, NO_RECORD, POSE, RECORD, SHAPE};

/// Units of a cube of `chain`.
pub(crate) const CHAIN_UNITS: usize = 64;
const FALLOFF: f32 = 0.721_347_5;
const LN_2: f32 = std::f32::consts::LN_2;

/// Sums of every entry over its pairs, in tile order: `[views N, MOMENTS + E]`. One unit an entry; entries that are not
/// visible are left as they are.
#[cube(launch)]
pub fn gather(
    entries: &[u32],
    first_pair: &[u32],
    pair_record: &[u32],
    pair_sums: &[f32],
    out: &mut [f32],
    count: u32,
    stride: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let pairs = entries[ABSOLUTE_POS * ENTRY + 2];
        if pairs > 0u32 {
            let first = first_pair[ABSOLUTE_POS];
            for k in 0..stride {
                let mut sum = 0.0f32;
                for pair in first..first + pairs {
                    if pair_record[pair as usize] != NO_RECORD {
                        sum += pair_sums[(pair * stride + k) as usize];
                    }
                }
                out[ABSOLUTE_POS * stride as usize + k as usize] = sum;
            }
        }
    }
}

/// Adds the gradients of all views to those of the Gaussians: `geometry` `[N, SHAPE]`, `colour` and `g_extra` as the
/// scene's. `poses` gets one partial sum per view and cube, `[views, cubes, POSE]`; `tally` counts what is not finite.
#[cube(launch)]
pub fn chain(
    shapes: &[f32],
    colours: &[f32],
    views: &[f32],
    records: &[f32],
    entries: &[u32],
    sums: &[f32],
    geometry: &mut [f32],
    g_colours: &mut [f32],
    g_extra: &mut [f32],
    poses: &mut [f32],
    tally: &[Atomic<u32>],
    gaussians: u32,
    view_count: u32,
    cubes: u32,
    extra_channels: u32,
    #[comptime] degree: u32,
    #[comptime] antialiased: bool,
) {
    let unit = UNIT_POS as usize;
    let g = CUBE_POS * CHAIN_UNITS + unit;
    let count = gaussians as usize;
    let channels = extra_channels as usize;
    let stride = MOMENTS + channels;
    let mut shared = Shared::<[f32]>::new_slice(comptime!(CHAIN_UNITS * POSE));
    let mut pose = Array::<f32>::new(POSE);
    let mut total = Array::<f32>::new(SHAPE);
    for view_index in 0..view_count {
        #[unroll]
        for k in 0..POSE {
            pose[k] = 0.0f32;
        }
        if g < count {
            let entry = view_index as usize * count + g;
            if entries[entry * ENTRY + 2] > 0u32 {
                let from = entry * stride;
                let mut any = 0u32;
                for k in 0..stride {
                    if sums[from + k] != 0.0f32 {
                        any += 1u32;
                    }
                }
                if any > 0u32 {
                    let view = load_view(views, view_index as usize);
                    let mut own = Array::<f32>::new(SHAPE);
                    shape(
                        shapes,
                        records,
                        sums,
                        g,
                        entry,
                        from,
                        &view,
                        &mut own,
                        &mut pose,
                        antialiased,
                    );
                    let mut bad = 0u32;
                    let mut g_rgb = Array::<f32>::new(3usize);
                    #[unroll]
                    for k in 0..3usize {
                        g_rgb[k] = sums[from + 6 + k];
                    }
                    if comptime!(degree != PLAIN) {
                        through_direction(
                            shapes, colours, records, g, entry, &view, &mut g_rgb, &mut own, &mut pose, degree,
                        );
                    }
                    #[unroll]
                    for k in 0..SHAPE {
                        if !is_finite(own[k]) {
                            bad += 1u32;
                        }
                    }
                    #[unroll]
                    for k in 0..POSE {
                        if !is_finite(pose[k]) {
                            bad += 1u32;
                        }
                    }
                    #[unroll]
                    for k in 0..3usize {
                        if !is_finite(g_rgb[k]) {
                            bad += 1u32;
                        }
                    }
                    for k in 0..channels {
                        if !is_finite(sums[from + MOMENTS + k]) {
                            bad += 1u32;
                        }
                    }
                    if bad > 0u32 {
                        tally[0].fetch_add(1u32);
                        #[unroll]
                        for k in 0..POSE {
                            pose[k] = 0.0f32;
                        }
                    } else {
                        #[unroll]
                        for k in 0..SHAPE {
                            total[k] += own[k];
                        }
                        if comptime!(degree == PLAIN) {
                            #[unroll]
                            for k in 0..3usize {
                                g_colours[3 * g + k] += g_rgb[k];
                            }
                        } else {
                            coefficients(shapes, g_colours, g, &view, &g_rgb, degree);
                        }
                        for k in 0..channels {
                            g_extra[g * channels + k] += sums[from + MOMENTS + k];
                        }
                    }
                }
            }
        }
        #[unroll]
        for k in 0..POSE {
            shared[unit * POSE + k] = pose[k];
        }
        sync_cube();
        if unit < POSE && CUBE_POS < cubes as usize {
            let mut sum = 0.0f32;
            for other in 0..CHAIN_UNITS {
                sum += shared[other * POSE + unit];
            }
            poses[(view_index as usize * cubes as usize + CUBE_POS) * POSE + unit] = sum;
        }
        sync_cube();
    }
    if g < count {
        #[unroll]
        for k in 0..SHAPE {
            geometry[g * SHAPE + k] += total[k];
        }
    }
}

/// Everything but colours, of one Gaussian in one view.
#[cube]
fn shape(
    shapes: &[f32],
    records: &[f32],
    sums: &[f32],
    g: usize,
    entry: usize,
    from: usize,
    view: &View,
    out: &mut Array<f32>,
    pose: &mut Array<f32>,
    #[comptime] antialiased: bool,
) {
    let own = g * SHAPE;
    let m0 = shapes[own];
    let m1 = shapes[own + 1];
    let m2 = shapes[own + 2];
    let w = shapes[own + 3];
    let qx = shapes[own + 4];
    let qy = shapes[own + 5];
    let qz = shapes[own + 6];
    let s0 = shapes[own + 7];
    let s1 = shapes[own + 8];
    let s2 = shapes[own + 9];
    let record = entry * RECORD;
    let la = records[record + 2];
    let lb = records[record + 3];
    let lc = records[record + 4];
    let opacity = records[record + 5];
    let z = records[record + 9];

    // The forward pass again: camera space, J, N = R R_q diag(s), U = J N.
    let x = view.r0 * m0 + view.r1 * m1 + view.r2 * m2 + view.t0;
    let y = view.r3 * m0 + view.r4 * m1 + view.r5 * m2 + view.t1;
    let inv_z = 1.0f32 / z;
    let xz = x * inv_z;
    let yz = y * inv_z;
    let ux = max(min(xz, view.high_x), view.low_x);
    let uy = max(min(yz, view.high_y), view.low_y);
    let j0 = view.fx * inv_z;
    let j2 = -view.fx * ux * inv_z;
    let j4 = view.fy * inv_z;
    let j5 = -view.fy * uy * inv_z;
    let inv_norm = 1.0f32 / (w * w + qx * qx + qy * qy + qz * qz).sqrt();
    let rq = rotation(w * inv_norm, qx * inv_norm, qy * inv_norm, qz * inv_norm);
    // M = R_q diag(s), N = R M.
    let mut m = Array::<f32>::new(9usize);
    #[unroll]
    for i in 0..3usize {
        m[3 * i] = rq[3 * i] * s0;
        m[3 * i + 1] = rq[3 * i + 1] * s1;
        m[3 * i + 2] = rq[3 * i + 2] * s2;
    }
    let mut n = Array::<f32>::new(9usize);
    #[unroll]
    for k in 0..3usize {
        n[k] = view.r0 * m[k] + view.r1 * m[3 + k] + view.r2 * m[6 + k];
        n[3 + k] = view.r3 * m[k] + view.r4 * m[3 + k] + view.r5 * m[6 + k];
        n[6 + k] = view.r6 * m[k] + view.r7 * m[3 + k] + view.r8 * m[6 + k];
    }
    let mut u = Array::<f32>::new(3usize);
    let mut v = Array::<f32>::new(3usize);
    #[unroll]
    for k in 0..3usize {
        u[k] = j0 * n[k] + j2 * n[6 + k];
        v[k] = j4 * n[3 + k] + j5 * n[6 + k];
    }
    let a = u[0] * u[0] + u[1] * u[1] + u[2] * u[2] + view.eps2d;
    let b = u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    let c = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + view.eps2d;
    let inv_c = 1.0f32 / c;
    let inv_det = la * la / FALLOFF * inv_c;
    let g_mx = -2.0f32 * LN_2 * la * sums[from + 1];
    let g_my = 2.0f32 * LN_2 * (lc * sums[from + 2] - lb * sums[from + 1]);
    let slope = b * inv_c;
    let m_ll = LN_2 * sums[from + 3] * inv_det;
    let m_ly = LN_2 * sums[from + 4] * la * inv_c;
    let m_yy = LN_2 * sums[from + 5];
    let mut s00 = m_ll * c;
    let mut s01 = m_ly - m_ll * b;
    let mut s11 = m_ll * slope * b - 2.0f32 * m_ly * slope + m_yy * FALLOFF * inv_c * inv_c;
    let mut g_opacity = sums[from] / opacity;
    if comptime!(antialiased) {
        let rho = opacity / shapes[own + 10];
        g_opacity *= rho;
        // g_rho = o g_o' = sum(0) / rho; nothing passes at the floor.
        if rho > view.min_compensation && rho > 0.0f32 {
            let half = 0.5f32 * sums[from] / (rho * rho);
            let keep = (1.0f32 - rho * rho) * inv_det;
            let low_pass = view.eps2d * inv_det;
            s00 += half * (keep * c - low_pass);
            s01 -= half * keep * b;
            s11 += half * (keep * a - low_pass);
        }
    }

    // S2 = (U; V)(U; V)^T: G_U = 2 G_S (U; V), G_J = G_U N^T, G_N = J^T G_U.
    let mut gu = Array::<f32>::new(3usize);
    let mut gv = Array::<f32>::new(3usize);
    #[unroll]
    for k in 0..3usize {
        gu[k] = 2.0f32 * (s00 * u[k] + s01 * v[k]);
        gv[k] = 2.0f32 * (s01 * u[k] + s11 * v[k]);
    }
    let g00 = gu[0] * n[0] + gu[1] * n[1] + gu[2] * n[2];
    let g02 = gu[0] * n[6] + gu[1] * n[7] + gu[2] * n[8];
    let g11 = gv[0] * n[3] + gv[1] * n[4] + gv[2] * n[5];
    let g12 = gv[0] * n[6] + gv[1] * n[7] + gv[2] * n[8];
    let mut g_n = Array::<f32>::new(9usize);
    #[unroll]
    for k in 0..3usize {
        g_n[k] = j0 * gu[k];
        g_n[3 + k] = j4 * gv[k];
        g_n[6 + k] = j2 * gu[k] + j5 * gv[k];
    }

    // Section 9.5: where the Jacobian is clamped, x/z is a constant in it.
    let inv_z2 = inv_z * inv_z;
    let free_x = select(
        xz >= view.low_x && xz <= view.high_x,
        1.0f32.runtime(),
        0.0f32.runtime(),
    );
    let free_y = select(
        yz >= view.low_y && yz <= view.high_y,
        1.0f32.runtime(),
        0.0f32.runtime(),
    );
    let mut h = Array::<f32>::new(3usize);
    h[0] = view.fx * inv_z * g_mx - free_x * view.fx * inv_z2 * g02;
    h[1] = view.fy * inv_z * g_my - free_y * view.fy * inv_z2 * g12;
    h[2] = inv_z2
        * ((1.0f32 + free_x) * view.fx * ux * g02 + (1.0f32 + free_y) * view.fy * uy * g12
            - view.fx * (x * g_mx + g00)
            - view.fy * (y * g_my + g11))
        + sums[from + 9];

    out[0] = view.r0 * h[0] + view.r3 * h[1] + view.r6 * h[2];
    out[1] = view.r1 * h[0] + view.r4 * h[1] + view.r7 * h[2];
    out[2] = view.r2 * h[0] + view.r5 * h[1] + view.r8 * h[2];
    // Section 9.6, G_M = R^T G_N.
    let mut g_m = Array::<f32>::new(9usize);
    #[unroll]
    for k in 0..3usize {
        g_m[k] = view.r0 * g_n[k] + view.r3 * g_n[3 + k] + view.r6 * g_n[6 + k];
        g_m[3 + k] = view.r1 * g_n[k] + view.r4 * g_n[3 + k] + view.r7 * g_n[6 + k];
        g_m[6 + k] = view.r2 * g_n[k] + view.r5 * g_n[3 + k] + view.r8 * g_n[6 + k];
    }
    #[unroll]
    for k in 0..3usize {
        out[7 + k] = rq[k] * g_m[k] + rq[3 + k] * g_m[3 + k] + rq[6 + k] * g_m[6 + k];
    }
    #[unroll]
    for i in 0..3usize {
        g_m[3 * i] *= s0;
        g_m[3 * i + 1] *= s1;
        g_m[3 * i + 2] *= s2;
    }
    quaternion(
        w * inv_norm,
        qx * inv_norm,
        qy * inv_norm,
        qz * inv_norm,
        inv_norm,
        &g_m,
        out,
    );
    out[10] = g_opacity;
    #[unroll]
    for i in 0..3usize {
        // p_c = R mu + t and N = R M.
        pose[3 * i] = h[i] * m0 + g_n[3 * i] * m[0] + g_n[3 * i + 1] * m[1] + g_n[3 * i + 2] * m[2];
        pose[3 * i + 1] = h[i] * m1 + g_n[3 * i] * m[3] + g_n[3 * i + 1] * m[4] + g_n[3 * i + 2] * m[5];
        pose[3 * i + 2] = h[i] * m2 + g_n[3 * i] * m[6] + g_n[3 * i + 1] * m[7] + g_n[3 * i + 2] * m[8];
        pose[9 + i] = h[i];
    }
}

/// Gradient with respect to the quaternion as given, from that with respect to its rotation matrix.
#[cube]
fn quaternion(w: f32, x: f32, y: f32, z: f32, inv_norm: f32, v: &Array<f32>, out: &mut Array<f32>) {
    let e0 = 2.0f32 * (x * (v[7] - v[5]) + y * (v[2] - v[6]) + z * (v[3] - v[1]));
    let e1 = 2.0f32 * (-2.0f32 * x * (v[4] + v[8]) + y * (v[3] + v[1]) + z * (v[6] + v[2]) + w * (v[7] - v[5]));
    let e2 = 2.0f32 * (x * (v[3] + v[1]) - 2.0f32 * y * (v[0] + v[8]) + z * (v[7] + v[5]) + w * (v[2] - v[6]));
    let e3 = 2.0f32 * (x * (v[6] + v[2]) + y * (v[7] + v[5]) - 2.0f32 * z * (v[0] + v[4]) + w * (v[3] - v[1]));
    let radial = w * e0 + x * e1 + y * e2 + z * e3;
    out[3] = (e0 - w * radial) * inv_norm;
    out[4] = (e1 - x * radial) * inv_norm;
    out[5] = (e2 - y * radial) * inv_norm;
    out[6] = (e3 - z * radial) * inv_norm;
}

/// Unit direction from the camera centre to a Gaussian, and the distance.
#[cube]
fn direction(shapes: &[f32], g: usize, view: &View) -> Array<f32> {
    let mut d = Array::<f32>::new(4usize);
    let dx = shapes[g * SHAPE] - view.centre_x;
    let dy = shapes[g * SHAPE + 1] - view.centre_y;
    let dz = shapes[g * SHAPE + 2] - view.centre_z;
    let length = (dx * dx + dy * dy + dz * dz).sqrt();
    let there = length > 0.0f32;
    let inverse = 1.0f32 / select(there, length, 1.0f32.runtime());
    d[0] = dx * inverse;
    d[1] = dy * inverse;
    d[2] = select(there, dz * inverse, 1.0f32.runtime());
    d[3] = length;
    d
}

/// Section 9.4 without the coefficients: drops clamped colours, and carries the rest to mean and pose.
#[cube]
fn through_direction(
    shapes: &[f32],
    colours: &[f32],
    records: &[f32],
    g: usize,
    entry: usize,
    view: &View,
    g_rgb: &mut Array<f32>,
    own: &mut Array<f32>,
    pose: &mut Array<f32>,
    #[comptime] degree: u32,
) {
    #[unroll]
    for c in 0..3usize {
        // A colour that was clamped to 0 passes nothing on.
        if records[entry * RECORD + 6 + c] <= 0.0f32 {
            g_rgb[c] = 0.0f32;
        }
    }
    if comptime!(degree > 0) {
        let count = comptime!(((degree + 1) * (degree + 1)) as usize);
        let d = direction(shapes, g, view);
        if d[3] > 0.0f32 {
            let slopes = basis_gradient(d[0], d[1], d[2], degree);
            let mut along = Array::<f32>::new(3usize);
            #[unroll]
            for k in 0..count {
                let at = 3 * (count * g + k);
                let weight = colours[at] * g_rgb[0] + colours[at + 1] * g_rgb[1] + colours[at + 2] * g_rgb[2];
                #[unroll]
                for c in 0..3usize {
                    along[c] += weight * slopes[3 * k + c];
                }
            }
            let radial = d[0] * along[0] + d[1] * along[1] + d[2] * along[2];
            let mut mean = Array::<f32>::new(3usize);
            #[unroll]
            for k in 0..3usize {
                mean[k] = (along[k] - d[k] * radial) / d[3];
                own[k] += mean[k];
                // g_centre = -g_mean and centre_k = -sum_i R_ik t_i.
                pose[k] += view.t0 * mean[k];
                pose[3 + k] += view.t1 * mean[k];
                pose[6 + k] += view.t2 * mean[k];
            }
            pose[9] += view.r0 * mean[0] + view.r1 * mean[1] + view.r2 * mean[2];
            pose[10] += view.r3 * mean[0] + view.r4 * mean[1] + view.r5 * mean[2];
            pose[11] += view.r6 * mean[0] + view.r7 * mean[1] + view.r8 * mean[2];
        }
    }
}

/// Adds the gradients of the coefficients.
#[cube]
fn coefficients(
    shapes: &[f32],
    g_colours: &mut [f32],
    g: usize,
    view: &View,
    g_rgb: &Array<f32>,
    #[comptime] degree: u32,
) {
    let count = comptime!(((degree + 1) * (degree + 1)) as usize);
    let d = direction(shapes, g, view);
    let b = basis(d[0], d[1], d[2], degree);
    #[unroll]
    for k in 0..count {
        #[unroll]
        for c in 0..3usize {
            g_colours[3 * (count * g + k) + c] += b[k] * g_rgb[c];
        }
    }
}
