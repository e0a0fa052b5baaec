//! Projection: one unit per Gaussian and view (`docs/spec/rasteriser.md` sections 3 to 5), and the tiles that it reaches.

use cubecl::prelude::*;

use super::math::{Ellipse, View, basis, ellipse, is_finite, load_view, log2_upper, reaches, rotation};
use super::{ENTRY, NO_RECORD, RECORD, SHAPE, TILE};

/// `degree` of a scene with plain colours.
pub(crate) const PLAIN: u32 = 4;
/// 0.5 log2(e).
const FALLOFF: f32 = 0.721_347_5;
const ALPHA_CUT: f32 = 1.0 / 255.0;
/// Largest size of colours, coefficients and extra channels.
const MAX_CHANNEL: f32 = 1e30;

/// Whether values are numbers of usable size.
#[cube]
fn usable(values: &[f32], first: usize, count: usize) -> bool {
    let mut bad = 0u32;
    for k in 0..count {
        let v = values[first + k];
        if !is_finite(v) || v.abs() > MAX_CHANNEL {
            bad += 1u32;
        }
    }
    bad == 0u32
}

/// Colour of a Gaussian seen from a camera, one channel.
#[cube]
fn channel(b: &Array<f32>, colours: &[f32], first: usize, #[comptime] degree: u32) -> f32 {
    let mut sum = 0.5f32;
    let count = comptime!(((degree + 1) * (degree + 1)) as usize);
    #[unroll]
    for k in 0..count {
        sum += b[k] * colours[first + 3 * k];
    }
    max(sum, 0.0f32)
}

/// Words of the tally of a view: visible and invalid Gaussians, pairs, and pairs in units of 256, rounded up in every cube,
/// which cannot overflow.
pub(crate) const TALLY: usize = 4;

/// Projects Gaussian `x` into view `y` of the grid.
#[cube(launch)]
pub fn project(
    shapes: &[f32],
    colours: &[f32],
    extra: &[f32],
    views: &[f32],
    records: &mut [f32],
    entries: &mut [u32],
    tally: &[Atomic<u32>],
    gaussians: u32,
    extra_channels: u32,
    #[comptime] degree: u32,
    #[comptime] antialiased: bool,
) {
    let view_index = CUBE_POS_Y as usize;
    let g = (CUBE_POS_X * CUBE_DIM + UNIT_POS) as usize;
    let count = gaussians as usize;
    let seen = Shared::<[Atomic<u32>]>::new_slice(3usize);
    if UNIT_POS < 3u32 {
        seen[UNIT_POS as usize].store(0u32);
    }
    sync_cube();
    if g < count {
        let view = load_view(views, view_index);
        let entry = view_index * count + g;
        let own = g * SHAPE;
        let m0 = shapes[own];
        let m1 = shapes[own + 1];
        let m2 = shapes[own + 2];
        let q0 = shapes[own + 3];
        let q1 = shapes[own + 4];
        let q2 = shapes[own + 5];
        let q3 = shapes[own + 6];
        let s0 = shapes[own + 7];
        let s1 = shapes[own + 8];
        let s2 = shapes[own + 9];
        let o = shapes[own + 10];
        let norm2 = q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3;
        let per = comptime!(if degree == PLAIN {
            3usize
        } else {
            3 * ((degree + 1) * (degree + 1)) as usize
        });
        let mut valid = is_finite(m0) && is_finite(m1) && is_finite(m2) && is_finite(norm2);
        valid = valid && is_finite(s0) && is_finite(s1) && is_finite(s2) && is_finite(o);
        valid = valid && norm2 > 1e-20f32 && s0 >= 0.0f32 && s1 >= 0.0f32 && s2 >= 0.0f32 && o >= 0.0f32;
        valid = valid && is_finite(s0 + s1 + s2 + o + norm2);
        valid = valid && usable(colours, g * per, per);
        valid = valid && usable(extra, g * extra_channels as usize, extra_channels as usize);

        let x = view.r0 * m0 + view.r1 * m1 + view.r2 * m2 + view.t0;
        let y = view.r3 * m0 + view.r4 * m1 + view.r5 * m2 + view.t1;
        let z = view.r6 * m0 + view.r7 * m1 + view.r8 * m2 + view.t2;
        let in_range = is_finite(z) && z >= view.near && z <= view.far;
        let mut pairs = 0u32;
        if valid && in_range {
            let inv_norm = 1.0f32 / norm2.sqrt();
            let rq = rotation(q0 * inv_norm, q1 * inv_norm, q2 * inv_norm, q3 * inv_norm);
            let inv_z = 1.0f32 / z;
            let xz = x * inv_z;
            let yz = y * inv_z;
            let ux = max(min(xz, view.high_x), view.low_x);
            let uy = max(min(yz, view.high_y), view.low_y);
            let j0 = view.fx * inv_z;
            let j2 = -view.fx * ux * inv_z;
            let j4 = view.fy * inv_z;
            let j5 = -view.fy * uy * inv_z;
            let a0 = j0 * view.r0 + j2 * view.r6;
            let a1 = j0 * view.r1 + j2 * view.r7;
            let a2 = j0 * view.r2 + j2 * view.r8;
            let b0 = j4 * view.r3 + j5 * view.r6;
            let b1 = j4 * view.r4 + j5 * view.r7;
            let b2 = j4 * view.r5 + j5 * view.r8;
            let u0 = (a0 * rq[0] + a1 * rq[3] + a2 * rq[6]) * s0;
            let u1 = (a0 * rq[1] + a1 * rq[4] + a2 * rq[7]) * s1;
            let u2 = (a0 * rq[2] + a1 * rq[5] + a2 * rq[8]) * s2;
            let v0 = (b0 * rq[0] + b1 * rq[3] + b2 * rq[6]) * s0;
            let v1 = (b0 * rq[1] + b1 * rq[4] + b2 * rq[7]) * s1;
            let v2 = (b0 * rq[2] + b1 * rq[5] + b2 * rq[8]) * s2;
            let ca = u0 * u0 + u1 * u1 + u2 * u2;
            let cc = v0 * v0 + v1 * v1 + v2 * v2;
            let cb = u0 * v0 + u1 * v1 + u2 * v2;
            // Determinant before the low-pass as a sum of squares, which no needle cancels.
            let n0 = u0 * v1 - u1 * v0;
            let n1 = u0 * v2 - u2 * v0;
            let n2 = u1 * v2 - u2 * v1;
            let det0 = n0 * n0 + n1 * n1 + n2 * n2;
            let eps = view.eps2d;
            let cov_a = ca + eps;
            let cov_c = cc + eps;
            let det = det0 + eps * (ca + cc) + eps * eps;
            let mut representable = is_finite(det) && is_finite(cov_a) && is_finite(cov_c) && is_finite(cb);
            representable = representable && det > 1e-30f32 && cov_a < 1e30f32 && cov_c > 1e-30f32 && cov_c < 1e30f32;
            let inv_det = 1.0f32 / select(representable, det, 1.0f32);
            let inv_c = 1.0f32 / select(representable, cov_c, 1.0f32);
            let mut opacity = o;
            if comptime!(antialiased) {
                opacity = o * max(det0 * inv_det, view.min_compensation * view.min_compensation).sqrt();
            }
            let enough = opacity >= ALPHA_CUT && o > view.min_opacity;
            // Finite inputs that overflow on the way count as invalid too, unless they are out of sight anyway.
            valid = representable || !enough;
            if representable && enough {
                let la = (FALLOFF * cov_c * inv_det).sqrt();
                let lb = -la * cb * inv_c;
                let level = log2_upper(max(255.0f32 * opacity, 1.0f32));
                let reach = 1.386_294_4f32 * (level + 1e-4f32);
                let half_x = (reach * cov_a).sqrt() * 1.0001f32 + 0.002f32;
                let half_y = (reach * cov_c).sqrt() * 1.0001f32 + 0.002f32;
                let px = view.fx * xz + view.cx;
                let py = view.fy * yz + view.cy;
                let x0 = max((px - half_x - 0.5f32).ceil(), 0.0f32);
                let x1 = min((px + half_x - 0.5f32).floor(), view.width - 1.0f32);
                let y0 = max((py - half_y - 0.5f32).ceil(), 0.0f32);
                let y1 = min((py + half_y - 0.5f32).floor(), view.height - 1.0f32);
                if is_finite(px) && is_finite(py) && x0 <= x1 && y0 <= y1 {
                    let rounding = 1e-6f32 * (la * half_x + lb.abs() * half_y) * level.sqrt();
                    let own = Ellipse {
                        x: px,
                        y: py,
                        la,
                        lb,
                        lc: -FALLOFF * inv_c,
                        power_min: -(level + 1e-4f32 + 2.0f32 * rounding),
                    };
                    let at = entry * RECORD;
                    records[at] = own.x;
                    records[at + 1] = own.y;
                    records[at + 2] = own.la;
                    records[at + 3] = own.lb;
                    records[at + 4] = own.lc;
                    records[at + 5] = opacity;
                    colour(records, at + 6, colours, g, m0, m1, m2, &view, degree);
                    records[at + 9] = z;
                    records[at + 10] = own.power_min;
                    let column0 = u32::cast_from(x0) / comptime!(TILE as u32);
                    let column1 = u32::cast_from(x1) / comptime!(TILE as u32);
                    let row0 = u32::cast_from(y0) / comptime!(TILE as u32);
                    let row1 = u32::cast_from(y1) / comptime!(TILE as u32);
                    pairs = count_tiles(&own, column0, column1, row0, row1);
                    entries[entry * ENTRY] = column0 | (column1 << 16u32);
                    entries[entry * ENTRY + 1] = row0 | (row1 << 16u32);
                }
            }
        }
        entries[entry * ENTRY + 2] = pairs;
        entries[entry * ENTRY + 3] = select(pairs > 0u32, u32::reinterpret(z), 0xffff_ffffu32.runtime());
        if pairs > 0u32 {
            seen[0].fetch_add(1u32);
            seen[2].fetch_add(pairs);
        }
        if !valid {
            seen[1].fetch_add(1u32);
        }
    }
    sync_cube();
    if UNIT_POS < 3u32 {
        tally[TALLY * view_index + UNIT_POS as usize].fetch_add(seen[UNIT_POS as usize].load());
    } else if UNIT_POS == 3u32 {
        tally[TALLY * view_index + 3].fetch_add(seen[2].load().div_ceil(256u32));
    }
}

/// Writes the colour of a record.
#[cube]
fn colour(
    records: &mut [f32],
    at: usize,
    colours: &[f32],
    g: usize,
    m0: f32,
    m1: f32,
    m2: f32,
    view: &View,
    #[comptime] degree: u32,
) {
    if comptime!(degree == PLAIN) {
        records[at] = colours[3 * g];
        records[at + 1] = colours[3 * g + 1];
        records[at + 2] = colours[3 * g + 2];
    } else {
        let per = comptime!(3 * ((degree + 1) * (degree + 1)) as usize);
        let dx = m0 - view.centre_x;
        let dy = m1 - view.centre_y;
        let dz = m2 - view.centre_z;
        let length = (dx * dx + dy * dy + dz * dz).sqrt();
        let there = length > 0.0f32;
        let inverse = 1.0f32 / select(there, length, 1.0f32);
        let b = basis(
            select(there, dx * inverse, 0.0f32),
            select(there, dy * inverse, 0.0f32),
            select(there, dz * inverse, 1.0f32),
            degree,
        );
        records[at] = channel(&b, colours, per * g, degree);
        records[at + 1] = channel(&b, colours, per * g + 1, degree);
        records[at + 2] = channel(&b, colours, per * g + 2, degree);
    }
}

/// Whether a Gaussian reaches a tile of its rectangle.
#[cube]
fn reaches_tile(g: &Ellipse, column: u32, row: u32, narrow: bool) -> bool {
    // The level set touches all sides of its box, so it reaches every tile of a single row or column.
    let side = comptime!((TILE - 1) as f32);
    let x = f32::cast_from(column * comptime!(TILE as u32));
    let y = f32::cast_from(row * comptime!(TILE as u32));
    narrow || reaches(g, x, y, side)
}

#[cube]
fn count_tiles(g: &Ellipse, column0: u32, column1: u32, row0: u32, row1: u32) -> u32 {
    let narrow = column0 == column1 || row0 == row1;
    let mut pairs = 0u32;
    for row in row0..row1 + 1u32 {
        for column in column0..column1 + 1u32 {
            if reaches_tile(g, column, row, narrow) {
                pairs += 1u32;
            }
        }
    }
    pairs
}

/// Depths and identities of all entries, for the sort.
#[cube(launch)]
pub fn depths(entries: &[u32], keys: &mut [u32], values: &mut [u32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        keys[ABSOLUTE_POS] = entries[ABSOLUTE_POS * ENTRY + 3];
        values[ABSOLUTE_POS] = ABSOLUTE_POS as u32;
    }
}

/// Numbers of pairs in depth order.
#[cube(launch)]
pub fn counts(entries: &[u32], order: &[u32], counts: &mut [u32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        counts[ABSOLUTE_POS] = entries[order[ABSOLUTE_POS] as usize * ENTRY + 2];
    }
}

/// Files the pairs of every entry, in depth order. A pair that the count promised but this kernel does not find (the
/// compiler may round differently here) is filed behind all tiles and marked; one that it finds beyond the count is left
/// out: the reach test has slack far above rounding.
#[cube(launch)]
pub fn file(
    records: &[f32],
    entries: &[u32],
    order: &[u32],
    offsets: &[u32],
    keys: &mut [u32],
    values: &mut [u32],
    pair_record: &mut [u32],
    first_pair: &mut [u32],
    count: u32,
    gaussians: u32,
    columns: u32,
    tiles: u32,
    last_key: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let entry = order[ABSOLUTE_POS];
        let at = entry as usize * ENTRY;
        let pairs = entries[at + 2];
        let offset = offsets[ABSOLUTE_POS];
        first_pair[entry as usize] = offset;
        if pairs > 0u32 {
            let column0 = entries[at] & 0xffffu32;
            let column1 = entries[at] >> 16u32;
            let row0 = entries[at + 1] & 0xffffu32;
            let row1 = entries[at + 1] >> 16u32;
            let narrow = column0 == column1 || row0 == row1;
            let view = entry / gaussians;
            let own = ellipse(records, entry as usize);
            let mut found = 0u32;
            for row in row0..row1 + 1u32 {
                for column in column0..column1 + 1u32 {
                    if found < pairs && reaches_tile(&own, column, row, narrow) {
                        let pair = (offset + found) as usize;
                        keys[pair] = view * tiles + row * columns + column;
                        values[pair] = pair as u32;
                        pair_record[pair] = entry;
                        found += 1u32;
                    }
                }
            }
            while found < pairs {
                let pair = (offset + found) as usize;
                keys[pair] = last_key;
                values[pair] = pair as u32;
                pair_record[pair] = NO_RECORD;
                found += 1u32;
            }
        }
    }
}

/// First and last pair of every tile, from the sorted keys; `ranges` starts as zeros.
#[cube(launch)]
pub fn ranges(keys: &[u32], ranges: &mut [u32], count: u32, last_key: u32) {
    let i = ABSOLUTE_POS;
    let n = count as usize;
    if i < n {
        let key = keys[i];
        if key < last_key {
            let before = if i > 0 { keys[i - 1] } else { last_key };
            if before != key {
                ranges[2 * key as usize] = i as u32;
            }
            let after = if i + 1 < n { keys[i + 1] } else { last_key };
            if after != key {
                ranges[2 * key as usize + 1] = i as u32 + 1u32;
            }
        }
    }
}

/// Puts values, `[count, width]`, into columns of the shapes.
#[cube(launch)]
pub fn place(values: &[f32], shapes: &mut [f32], count: u32, width: u32, column: u32) {
    if ABSOLUTE_POS < count as usize {
        for k in 0..width {
            shapes[ABSOLUTE_POS * SHAPE + (column + k) as usize] = values[ABSOLUTE_POS * width as usize + k as usize];
        }
    }
}

/// A copy.
#[cube(launch)]
pub fn copy(from: &[f32], to: &mut [f32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        to[ABSOLUTE_POS] = from[ABSOLUTE_POS];
    }
}

/// Zeros.
#[cube(launch)]
pub fn clear(values: &mut [u32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        values[ABSOLUTE_POS] = 0u32;
    }
}
