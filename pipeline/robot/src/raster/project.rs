//! Vertices to fixed-point image coordinates.

use rayon::prelude::*;
use rogs_geometry::{Camera, Link, Pinhole, Pose};

use super::{MeshScene, RenderOptions};

/// Fractional bits of image coordinates.
pub(super) const SUBPIXEL_BITS: u32 = 16;
/// Image coordinates must stay within this many pixels of the origin, so that products of differences fit in 62 bits.
pub(super) const GUARD_PX: f64 = 8191.0;
const ONE: f64 = (1u32 << SUBPIXEL_BITS) as f64;
/// Adding this rounds a f64 of magnitude below 2^31 to the nearest integer, which is then in its low bits.
const ROUNDING: f64 = 6_755_399_441_055_744.0;

/// Projected vertices of a scene. Pixel centres lie at multiples of `1 << SUBPIXEL_BITS`.
#[derive(Debug, Default)]
pub(super) struct ScreenVertices {
    pub(super) x: Vec<i32>,
    pub(super) y: Vec<i32>,
    /// 1/z, 1/metres; 0 when the vertex lies before the near plane or outside the guard band and its triangles need
    /// clipping.
    pub(super) inverse_z: Vec<f32>,
    /// True when any vertex needs clipping.
    pub(super) any_clipped: bool,
}

/// A pinhole in fixed-point units with pixel centres at integers.
#[derive(Debug, Clone, Copy)]
pub(super) struct FixedPinhole {
    pub(super) fx: f64,
    pub(super) fy: f64,
    pub(super) cx: f64,
    pub(super) cy: f64,
}

impl FixedPinhole {
    pub(super) fn new(camera: &Pinhole) -> Self {
        let k = camera.intrinsics;
        Self {
            fx: k.fx * ONE,
            fy: k.fy * ONE,
            cx: (k.cx - 0.5) * ONE,
            cy: (k.cy - 0.5) * ONE,
        }
    }

    /// Fixed-point coordinates of a point with positive z inside the guard band.
    pub(super) fn project(&self, [x, y, z]: [f64; 3]) -> (i32, i32, f32) {
        let inverse_z = 1.0 / z;
        (
            round(self.fx * (x * inverse_z) + self.cx),
            round(self.fy * (y * inverse_z) + self.cy),
            inverse_z as f32,
        )
    }
}

/// Row-major 3x4 matrix of a pose.
pub(super) fn matrix(pose: &Pose<Camera, Link>) -> [[f64; 4]; 3] {
    let m = pose.to_matrix4();
    [
        [m[0], m[1], m[2], m[3]],
        [m[4], m[5], m[6], m[7]],
        [m[8], m[9], m[10], m[11]],
    ]
}

/// A point of a link in the camera frame.
#[inline(always)]
pub(super) fn transform(m: &[[f64; 4]; 3], x: f32, y: f32, z: f32) -> [f64; 3] {
    let (x, y, z) = (f64::from(x), f64::from(y), f64::from(z));
    [
        m[0][0] * x + m[0][1] * y + m[0][2] * z + m[0][3],
        m[1][0] * x + m[1][1] * y + m[1][2] * z + m[1][3],
        m[2][0] * x + m[2][1] * y + m[2][2] * z + m[2][3],
    ]
}

#[inline(always)]
fn round(value: f64) -> i32 {
    (value + ROUNDING).to_bits() as i32
}

/// Vertices that a thread projects at a time.
const CHUNK: usize = 4096;

/// A run of vertices of one part with the place of their results.
struct Chunk<'a> {
    pose: [[f64; 4]; 3],
    input: [&'a [f32]; 3],
    output: (&'a mut [i32], &'a mut [i32], &'a mut [f32]),
}

impl ScreenVertices {
    pub(super) fn project(
        &mut self,
        scene: &MeshScene,
        camera: &Pinhole,
        camera_from_link: &[Pose<Camera, Link>],
        options: &RenderOptions,
        parallel: bool,
    ) {
        let count = scene.x.len();
        self.x.resize(count, 0);
        self.y.resize(count, 0);
        self.inverse_z.resize(count, 0.0);
        let pinhole = FixedPinhole::new(camera);
        let arch = pulp::Arch::new();
        // Same operations in the same order for every instruction set: no fused multiply-add is introduced.
        let run = |chunk: Chunk<'_>| {
            arch.dispatch(|| project_chunk(chunk.input, chunk.output, &chunk.pose, pinhole, options.near_m))
        };
        let chunks = self.chunks(scene, camera_from_link);
        let all_inside = if parallel {
            chunks.into_par_iter().map(run).reduce(|| true, |a, b| a & b)
        } else {
            chunks.into_iter().map(run).fold(true, |a, b| a & b)
        };
        self.any_clipped = !all_inside;
    }

    fn chunks<'a>(&'a mut self, scene: &'a MeshScene, camera_from_link: &[Pose<Camera, Link>]) -> Vec<Chunk<'a>> {
        let mut chunks = Vec::new();
        let (mut xs, mut ys, mut zs) = (&mut self.x[..], &mut self.y[..], &mut self.inverse_z[..]);
        for part in &scene.parts {
            let pose = matrix(&camera_from_link[part.link as usize]);
            for start in part.vertices.clone().step_by(CHUNK) {
                let range = start..(start + CHUNK).min(part.vertices.end);
                let output;
                (output, (xs, ys, zs)) = {
                    let (x, rest_x) = xs.split_at_mut(range.len());
                    let (y, rest_y) = ys.split_at_mut(range.len());
                    let (z, rest_z) = zs.split_at_mut(range.len());
                    ((x, y, z), (rest_x, rest_y, rest_z))
                };
                let input = [&scene.x[range.clone()], &scene.y[range.clone()], &scene.z[range]];
                chunks.push(Chunk { pose, input, output });
            }
        }
        chunks
    }
}

/// Projects a run of vertices; true when none needs clipping.
#[inline(always)]
fn project_chunk(
    [xs, ys, zs]: [&[f32]; 3],
    (out_x, out_y, out_inverse_z): (&mut [i32], &mut [i32], &mut [f32]),
    pose: &[[f64; 4]; 3],
    pinhole: FixedPinhole,
    near: f64,
) -> bool {
    let count = xs.len();
    let (ys, zs) = (&ys[..count], &zs[..count]);
    let (out_x, out_y, out_inverse_z) = (&mut out_x[..count], &mut out_y[..count], &mut out_inverse_z[..count]);
    let guard = GUARD_PX * ONE;
    let mut outside = 0u32;
    for i in 0..count {
        let [x, y, z] = transform(pose, xs[i], ys[i], zs[i]);
        let inverse_z = 1.0 / z;
        let u = pinhole.fx * (x * inverse_z) + pinhole.cx;
        let v = pinhole.fy * (y * inverse_z) + pinhole.cy;
        let inside = (z >= near) & (u.abs() <= guard) & (v.abs() <= guard);
        out_x[i] = round(u);
        out_y[i] = round(v);
        out_inverse_z[i] = if inside { inverse_z as f32 } else { 0.0 };
        outside += u32::from(!inside);
    }
    outside == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_to_the_nearest_integer() {
        for (value, expected) in [
            (0.4, 0),
            (0.6, 1),
            (-0.6, -1),
            (-3.2, -3),
            (5e8 + 0.4, 500_000_000),
            (-5e8 - 0.6, -500_000_001),
        ] {
            assert_eq!(round(value), expected);
        }
    }
}
