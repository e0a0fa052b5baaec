//! The kernel: displacements of mesh points with their links, sparse and dense.

use std::ops::Range;

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use rogs_geometry::{Link, Pose, PosedCamera, Recon};
use rogs_schemas::units::UNITS_PER_METRE;

/// The motion of one link between two times as a displacement field: `d = matrix * p + offset` with `p` in metres and
/// `d` in internal units, both in the reconstruction frame. Row-major 3x4.
pub type LinkDisplacement = [f32; 12];

/// `3.5 (T(t) T(s)^-1 - 1)` of a link. Exactly zero when the link did not move.
#[must_use]
pub fn link_displacement(source: &Pose<Recon, Link>, query: &Pose<Recon, Link>) -> LinkDisplacement {
    if source == query {
        return [0.0; 12];
    }
    let motion: Pose<Recon, Recon> = *query * source.inverse();
    // The difference to the identity is taken in f64: it is small, its f32 form then keeps all its digits.
    let matrix = (motion.rotation - DMat3::IDENTITY) * UNITS_PER_METRE;
    let offset = motion.translation * UNITS_PER_METRE;
    let row = |row: usize| {
        [matrix.x_axis[row], matrix.y_axis[row], matrix.z_axis[row], offset[row]].map(|value| value as f32)
    };
    let [a, b, c] = [row(0), row(1), row(2)];
    std::array::from_fn(|entry| [a, b, c][entry / 4][entry % 4])
}

/// The supported pixels of one source view with their mesh points.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SourcePoints {
    /// Row-major pixel indices, ascending. `[M]`
    pub pixels: Vec<u32>,
    /// Link ids. `[M]`
    pub link: Vec<u8>,
    /// Mesh depth, metres. `[M]`
    pub depth_m: Vec<f32>,
    /// Mesh points in the reconstruction frame, metres, one array per axis. `[M]`
    pub point_m: [Vec<f32>; 3],
    /// Runs of neighbouring pixels on one link.
    runs: Vec<Run>,
}

/// Neighbouring pixels on one link.
#[derive(Debug, Clone, PartialEq)]
struct Run {
    link: usize,
    first_pixel: usize,
    points: Range<usize>,
}

impl SourcePoints {
    /// Collects the pixels with `support != 0` and unprojects them at their centres.
    ///
    /// # Panics
    /// When a map is smaller than the camera's image.
    #[must_use]
    pub fn new(camera: &PosedCamera<Recon>, depth_m: &[f32], link: &[u8], support: &[u8]) -> Self {
        let PosedCamera {
            lens,
            world_from_camera: recon_from_camera,
        } = camera;
        let mut points = Self::default();
        points.reserve(support.iter().filter(|&&value| value != 0).count());
        let columns: Vec<f64> = (0..lens.width).map(|column| lens.ray(column, 0).x).collect();
        for row in 0..lens.height {
            let y = lens.ray(0, row).y;
            let start = (row * lens.width) as usize;
            for (column, &x) in columns.iter().enumerate() {
                let pixel = start + column;
                if support[pixel] == 0 {
                    continue;
                }
                let point = recon_from_camera.point(DVec3::new(x, y, 1.0) * f64::from(depth_m[pixel]));
                points.push(pixel, link[pixel], depth_m[pixel], point);
            }
        }
        points
    }

    fn reserve(&mut self, count: usize) {
        self.pixels.reserve_exact(count);
        self.link.reserve_exact(count);
        self.depth_m.reserve_exact(count);
        self.point_m.iter_mut().for_each(|axis| axis.reserve_exact(count));
    }

    fn push(&mut self, pixel: usize, link: u8, depth_m: f32, point: DVec3) {
        let index = self.pixels.len();
        self.pixels.push(pixel as u32);
        self.link.push(link);
        self.depth_m.push(depth_m);
        for (axis, value) in self.point_m.iter_mut().zip(point.to_array()) {
            axis.push(value as f32);
        }
        match self.runs.last_mut() {
            Some(run) if run.link == usize::from(link) && run.first_pixel + run.points.len() == pixel => {
                run.points.end = index + 1;
            }
            _ => self.runs.push(Run {
                link: usize::from(link),
                first_pixel: pixel,
                points: index..index + 1,
            }),
        }
    }

    /// Displacements of all points, internal units, into `out`. `[M, 3]`; `links` is indexed by link id.
    ///
    /// # Panics
    /// When `out` has another size or a link has no displacement.
    pub fn displace(&self, links: &[LinkDisplacement], out: &mut [f32]) {
        assert_eq!(out.len(), 3 * self.pixels.len(), "displacements must be [M, 3]");
        let (out, _) = out.as_chunks_mut::<3>();
        for run in &self.runs {
            let m = &links[run.link];
            let [x, y, z] = self.axes(run);
            for (i, out) in out[run.points.clone()].iter_mut().enumerate() {
                *out = std::array::from_fn(|row| displaced(m, row, x[i], y[i], z[i]));
            }
        }
    }

    fn axes(&self, run: &Run) -> [&[f32]; 3] {
        [0, 1, 2].map(|axis| &self.point_m[axis][run.points.clone()])
    }

    /// Support, depth and displacement into five planes; every value of the planes is written.
    fn fill(&self, links: &[LinkDisplacement], area: usize, out: &mut [f32]) {
        let mut planes = out.chunks_exact_mut(area);
        let planes = [(); 5].map(|()| planes.next());
        let [Some(support), Some(depth), Some(dx), Some(dy), Some(dz)] = planes else {
            return;
        };
        let mut written = 0;
        for run in &self.runs {
            let pixels = run.first_pixel..run.first_pixel + run.points.len();
            for plane in [&mut *support, &mut *depth, &mut *dx, &mut *dy, &mut *dz] {
                plane[written..pixels.start].fill(0.0);
            }
            written = pixels.end;
            support[pixels.clone()].fill(1.0);
            depth[pixels.clone()].copy_from_slice(&self.depth_m[run.points.clone()]);
            let m = &links[run.link];
            let [x, y, z] = self.axes(run);
            for (row, plane) in [&mut *dx, &mut *dy, &mut *dz].into_iter().enumerate() {
                for (i, out) in plane[pixels.clone()].iter_mut().enumerate() {
                    *out = displaced(m, row, x[i], y[i], z[i]);
                }
            }
        }
        for plane in [support, depth, dx, dy, dz] {
            plane[written..].fill(0.0);
        }
    }
}

#[inline(always)]
fn displaced(m: &LinkDisplacement, row: usize, x: f32, y: f32, z: f32) -> f32 {
    m[4 * row] * x + m[4 * row + 1] * y + m[4 * row + 2] * z + m[4 * row + 3]
}

/// Dense maps of the five channels that the robot fills (support, depth, displacement), straight from the points.
///
/// `points[s]` and `links[s * queries + q]` give map `(s, q)` of `out`, `[S, Q, 5, H, W]`.
///
/// # Panics
/// When the sizes do not fit.
pub fn fill_dense_batch(
    points: &[SourcePoints],
    links: &[Vec<LinkDisplacement>],
    queries: usize,
    area: usize,
    out: &mut [f32],
) {
    assert_eq!(
        links.len(),
        points.len() * queries,
        "one list of link displacements per map"
    );
    assert_eq!(out.len(), links.len() * 5 * area, "dense maps must be [S, Q, 5, H, W]");
    let maps = out.par_chunks_exact_mut(5 * area).enumerate();
    maps.for_each(|(index, out)| points[index / queries].fill(&links[index], area, out));
}

#[cfg(test)]
mod tests {
    use rogs_geometry::Pinhole;
    use rogs_schemas::Intrinsics;

    use super::*;

    #[test]
    fn the_batch_fill_equals_the_scattered_sparse_form() {
        let (w, h) = (12u32, 7u32);
        let intrinsics = Intrinsics {
            fx: 10.0,
            fy: 11.0,
            cx: 6.0,
            cy: 3.5,
        };
        let lens = Pinhole {
            intrinsics,
            width: w,
            height: h,
        };
        let area = (w * h) as usize;
        let support: Vec<u8> = (0..area)
            .map(|pixel| u8::from(pixel % 5 != 0 && pixel > 8 && pixel < 70))
            .collect();
        let link: Vec<u8> = (0..area).map(|pixel| u8::from(pixel % 12 > 6)).collect();
        let depth: Vec<f32> = (0..area).map(|pixel| 0.5 + 0.01 * pixel as f32).collect();
        let recon_from_camera = Pose::from_xyz_euler([0.1, 0.2, 0.3], [0.4, 0.5, 0.6]);
        let camera = PosedCamera::new(lens, recon_from_camera);
        let points = SourcePoints::new(&camera, &depth, &link, &support);
        let pose = |value: f64| Pose::<Recon, Link>::from_xyz_euler([value, 0.0, 0.1], [0.2, value, 0.0]);
        let links = vec![
            vec![
                link_displacement(&pose(0.1), &pose(0.3)),
                link_displacement(&pose(0.2), &pose(0.2)),
            ],
            vec![
                link_displacement(&pose(0.1), &pose(-0.3)),
                link_displacement(&pose(0.2), &pose(0.7)),
            ],
        ];
        let mut dense = vec![9.0f32; 2 * 5 * area];
        fill_dense_batch(std::slice::from_ref(&points), &links, 2, area, &mut dense);
        for (query, map) in dense.chunks_exact(5 * area).enumerate() {
            let mut displacement = vec![0.0f32; 3 * points.pixels.len()];
            points.displace(&links[query], &mut displacement);
            let mut expected = vec![0.0f32; 5 * area];
            for (index, &pixel) in points.pixels.iter().enumerate() {
                let d = &displacement[3 * index..];
                for (plane, value) in [1.0, points.depth_m[index], d[0], d[1], d[2]].into_iter().enumerate() {
                    expected[plane * area + pixel as usize] = value;
                }
            }
            assert_eq!(map, expected);
        }
        assert!(dense[2 * area..3 * area].iter().any(|value| value.abs() > 0.1));
    }
}
