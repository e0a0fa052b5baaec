//! Arithmetic that all kernels share; the formulas are those of the kernels on the CPU.

use cubecl::prelude::*;

use super::{RECORD, VIEW};

/// Whether a number is finite, from its bits: shader compilers may assume that there are no others.
#[cube]
pub fn is_finite(x: f32) -> bool {
    (u32::reinterpret(x) & 0x7f80_0000u32) != 0x7f80_0000u32
}

/// 2^x for x in [-125, 0], relative error below 2e-7; smaller x are taken as -125. See `crate::simd::exp2`.
#[cube]
pub fn exp2(x: f32) -> f32 {
    let x = max(x, -125.0f32);
    let n = x.round();
    let f = x - n;
    let mut p = 1.326_472_7e-3f32;
    p = fma(p, f, 9.671_513e-3f32);
    p = fma(p, f, 5.550_733_6e-2f32);
    p = fma(p, f, 0.240_222_42f32);
    p = fma(p, f, 0.693_146_98f32);
    p = fma(p, f, 1.0f32);
    p * f32::reinterpret(u32::cast_from(n + 127.0f32) << 23u32)
}

/// Upper bound of log2 of a positive normal number, at most 0.012 too high.
#[cube]
pub fn log2_upper(x: f32) -> f32 {
    let bits = u32::reinterpret(x);
    let exponent = f32::cast_from(bits >> 23u32) - 127.0f32;
    let m = f32::reinterpret((bits & 0x007f_ffffu32) | 0x3f80_0000u32);
    exponent + ((-0.335_828_78f32 * m + 2.0f32) * m - 1.658_71f32) + 0.006f32
}

/// log2 of the falloff at an offset, given `l = la dx + lb dy`.
#[cube]
pub fn falloff_power(l: f32, lc: f32, dy: f32) -> f32 {
    fma(-l, l, lc * dy * dy)
}

/// What the reach test needs of a record.
#[derive(CubeType, Clone, Copy)]
pub struct Ellipse {
    pub x: f32,
    pub y: f32,
    pub la: f32,
    pub lb: f32,
    pub lc: f32,
    pub power_min: f32,
}

/// The ellipse of a record.
#[cube]
pub fn ellipse(records: &[f32], record: usize) -> Ellipse {
    let at = record * RECORD;
    Ellipse {
        x: records[at],
        y: records[at + 1],
        la: records[at + 2],
        lb: records[at + 3],
        lc: records[at + 4],
        power_min: records[at + 10],
    }
}

/// Whether the level set of a Gaussian reaches the pixel centres of a tile with its corner at (x, y) and its last pixel
/// `side` further. See `crate::project::reaches`.
#[cube]
pub fn reaches(g: &Ellipse, x: f32, y: f32, side: f32) -> bool {
    let xl = x + 0.5f32 - g.x;
    let yl = y + 0.5f32 - g.y;
    let xh = xl + side;
    let yh = yl + side;
    let ex = max(min(0.0f32, xh), xl);
    let ey = max(min(0.0f32, yh), yl);
    // Best point on the vertical line through ex and on the horizontal line through ey.
    let y_best = max(min(g.la * g.lb / (g.lc - g.lb * g.lb) * ex, yh), yl);
    let x_best = max(min(-g.lb / g.la * ey, xh), xl);
    let l1 = g.la * ex + g.lb * y_best;
    let l2 = g.la * x_best + g.lb * ey;
    let p1 = falloff_power(l1, g.lc, y_best);
    let p2 = falloff_power(l2, g.lc, ey);
    max(p1, p2) >= g.power_min
}

/// A camera with settings, unpacked.
#[derive(CubeType)]
pub struct View {
    pub fx: f32,
    pub fy: f32,
    pub cx: f32,
    pub cy: f32,
    pub width: f32,
    pub height: f32,
    pub r0: f32,
    pub r1: f32,
    pub r2: f32,
    pub r3: f32,
    pub r4: f32,
    pub r5: f32,
    pub r6: f32,
    pub r7: f32,
    pub r8: f32,
    pub t0: f32,
    pub t1: f32,
    pub t2: f32,
    pub low_x: f32,
    pub high_x: f32,
    pub low_y: f32,
    pub high_y: f32,
    pub centre_x: f32,
    pub centre_y: f32,
    pub centre_z: f32,
    pub near: f32,
    pub far: f32,
    pub eps2d: f32,
    pub min_opacity: f32,
    pub min_compensation: f32,
}

#[cube]
pub fn load_view(views: &[f32], view: usize) -> View {
    let at = view * VIEW;
    View {
        fx: views[at],
        fy: views[at + 1],
        cx: views[at + 2],
        cy: views[at + 3],
        width: views[at + 4],
        height: views[at + 5],
        r0: views[at + 6],
        r1: views[at + 7],
        r2: views[at + 8],
        r3: views[at + 9],
        r4: views[at + 10],
        r5: views[at + 11],
        r6: views[at + 12],
        r7: views[at + 13],
        r8: views[at + 14],
        t0: views[at + 15],
        t1: views[at + 16],
        t2: views[at + 17],
        low_x: views[at + 18],
        high_x: views[at + 19],
        low_y: views[at + 20],
        high_y: views[at + 21],
        centre_x: views[at + 22],
        centre_y: views[at + 23],
        centre_z: views[at + 24],
        near: views[at + 25],
        far: views[at + 26],
        eps2d: views[at + 27],
        min_opacity: views[at + 28],
        min_compensation: views[at + 29],
    }
}

/// Rotation matrix of a unit quaternion (w, x, y, z), row-major.
#[cube]
pub fn rotation(w: f32, x: f32, y: f32, z: f32) -> Array<f32> {
    let mut r = Array::<f32>::new(9usize);
    r[0] = 1.0f32 - 2.0f32 * (y * y + z * z);
    r[1] = 2.0f32 * (x * y - w * z);
    r[2] = 2.0f32 * (x * z + w * y);
    r[3] = 2.0f32 * (x * y + w * z);
    r[4] = 1.0f32 - 2.0f32 * (x * x + z * z);
    r[5] = 2.0f32 * (y * z - w * x);
    r[6] = 2.0f32 * (x * z - w * y);
    r[7] = 2.0f32 * (y * z + w * x);
    r[8] = 1.0f32 - 2.0f32 * (x * x + y * y);
    r
}

/// Basis functions of the spherical harmonics at a unit direction; see `crate::sh`.
#[cube]
pub fn basis(x: f32, y: f32, z: f32, #[comptime] degree: u32) -> Array<f32> {
    let mut b = Array::<f32>::new(16usize);
    b[0] = 0.282_094_8f32;
    if comptime!(degree >= 1) {
        b[1] = -0.488_602_51f32 * y;
        b[2] = 0.488_602_51f32 * z;
        b[3] = -0.488_602_51f32 * x;
    }
    if comptime!(degree >= 2) {
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        b[4] = 1.092_548_4f32 * x * y;
        b[5] = -1.092_548_4f32 * y * z;
        b[6] = 0.315_391_57f32 * (2.0f32 * zz - xx - yy);
        b[7] = -1.092_548_4f32 * x * z;
        b[8] = 0.546_274_2f32 * (xx - yy);
        if comptime!(degree >= 3) {
            b[9] = -0.590_043_6f32 * y * (3.0f32 * xx - yy);
            b[10] = 2.890_611_4f32 * x * y * z;
            b[11] = -0.457_045_8f32 * y * (4.0f32 * zz - xx - yy);
            b[12] = 0.373_176_34f32 * z * (2.0f32 * zz - 3.0f32 * xx - 3.0f32 * yy);
            b[13] = -0.457_045_8f32 * x * (4.0f32 * zz - xx - yy);
            b[14] = 1.445_305_7f32 * z * (xx - yy);
            b[15] = -0.590_043_6f32 * x * (xx - 3.0f32 * yy);
        }
    }
    b
}

/// Derivatives of the basis functions with respect to x, y and z: `[16, 3]`.
#[cube]
pub fn basis_gradient(x: f32, y: f32, z: f32, #[comptime] degree: u32) -> Array<f32> {
    let mut d = Array::<f32>::new(48usize);
    if comptime!(degree >= 1) {
        d[4] = -0.488_602_51f32;
        d[8] = 0.488_602_51f32;
        d[9] = -0.488_602_51f32;
    }
    if comptime!(degree >= 2) {
        d[12] = 1.092_548_4f32 * y;
        d[13] = 1.092_548_4f32 * x;
        d[16] = -1.092_548_4f32 * z;
        d[17] = -1.092_548_4f32 * y;
        d[18] = -0.630_783_14f32 * x;
        d[19] = -0.630_783_14f32 * y;
        d[20] = 1.261_566_3f32 * z;
        d[21] = -1.092_548_4f32 * z;
        d[23] = -1.092_548_4f32 * x;
        d[24] = 1.092_548_4f32 * x;
        d[25] = -1.092_548_4f32 * y;
    }
    if comptime!(degree >= 3) {
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        d[27] = -3.540_261_6f32 * x * y;
        d[28] = -0.590_043_6f32 * (3.0f32 * xx - 3.0f32 * yy);
        d[30] = 2.890_611_4f32 * y * z;
        d[31] = 2.890_611_4f32 * x * z;
        d[32] = 2.890_611_4f32 * x * y;
        d[33] = 0.914_091_6f32 * x * y;
        d[34] = -0.457_045_8f32 * (4.0f32 * zz - xx - 3.0f32 * yy);
        d[35] = -3.656_366_4f32 * y * z;
        d[36] = -2.239_058f32 * x * z;
        d[37] = -2.239_058f32 * y * z;
        d[38] = 0.373_176_34f32 * (6.0f32 * zz - 3.0f32 * xx - 3.0f32 * yy);
        d[39] = -0.457_045_8f32 * (4.0f32 * zz - 3.0f32 * xx - yy);
        d[40] = 0.914_091_6f32 * x * y;
        d[41] = -3.656_366_4f32 * x * z;
        d[42] = 2.890_611_4f32 * x * z;
        d[43] = -2.890_611_4f32 * y * z;
        d[44] = 1.445_305_7f32 * (xx - yy);
        d[45] = -0.590_043_6f32 * (3.0f32 * xx - 3.0f32 * yy);
        d[46] = 3.540_261_6f32 * x * y;
    }
    d
}
