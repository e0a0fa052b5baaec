//! The kernel: displacements of mesh points with their links, sparse and dense.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use rogs_geometry::{Link, Pinhole, Pose, Recon};
use rogs_schemas::records::conditioning::{Conditioning, GripperPrior, KAPPA_CHANNELS};
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
    /// Mesh points in the reconstruction frame, metres. `[M, 3]`
    pub point_m: Vec<[f32; 3]>,
    /// Runs of consecutive points on one link: link and end index.
    runs: Vec<(u8, u32)>,
}

impl SourcePoints {
    /// Collects the pixels with `support != 0` and unprojects them at their centres.
    ///
    /// # Panics
    /// When a map is smaller than the camera's image.
    #[must_use]
    pub fn new(
        camera: &Pinhole,
        recon_from_camera: &Pose<Recon, rogs_geometry::Camera>,
        depth_m: &[f32],
        link: &[u8],
        support: &[u8],
    ) -> Self {
        let mut points = Self::default();
        for row in 0..camera.height {
            for column in 0..camera.width {
                let pixel = (row * camera.width + column) as usize;
                if support[pixel] == 0 {
                    continue;
                }
                let point: DVec3 = recon_from_camera.point(camera.ray(column, row) * f64::from(depth_m[pixel]));
                points.pixels.push(pixel as u32);
                points.link.push(link[pixel]);
                points.depth_m.push(depth_m[pixel]);
                points.point_m.push(point.as_vec3().to_array());
            }
        }
        for (index, &link) in points.link.iter().enumerate() {
            match points.runs.last_mut() {
                Some((last, end)) if *last == link => *end = index as u32 + 1,
                _ => points.runs.push((link, index as u32 + 1)),
            }
        }
        points
    }

    /// Displacements of all points, internal units, into `out`. `[M, 3]`; `links` is indexed by link id.
    ///
    /// # Panics
    /// When `out` has another size or a link has no displacement.
    pub fn displace(&self, links: &[LinkDisplacement], out: &mut [f32]) {
        assert_eq!(out.len(), 3 * self.point_m.len(), "displacements must be [M, 3]");
        let (out, _) = out.as_chunks_mut::<3>();
        let mut start = 0;
        for &(link, end) in &self.runs {
            let end = end as usize;
            let m = &links[link as usize];
            for (point, out) in self.point_m[start..end].iter().zip(&mut out[start..end]) {
                *out = displaced(m, point);
            }
            start = end;
        }
    }
}

#[inline(always)]
fn displaced(m: &LinkDisplacement, &[x, y, z]: &[f32; 3]) -> [f32; 3] {
    [
        m[0] * x + m[1] * y + m[2] * z + m[3],
        m[4] * x + m[5] * y + m[6] * z + m[7],
        m[8] * x + m[9] * y + m[10] * z + m[11],
    ]
}

/// The dense map of view `view` at stored query `query` into `out`, planar `[7, H, W]`: the same values as
/// [`Conditioning::dense`], for callers that fill many maps into one buffer.
///
/// # Panics
/// When `out` has another size, or view or query do not exist.
pub fn fill_dense(conditioning: &Conditioning, view: usize, query: usize, prior: &[f32], out: &mut [f32]) {
    let area = (conditioning.height * conditioning.width) as usize;
    assert_eq!(out.len(), KAPPA_CHANNELS * area, "a dense map must be [7, H, W]");
    let maps = &conditioning.view_maps[view];
    let count = maps.pixels.len();
    let displacement = &maps.displacement_iu[query * count * 3..(query + 1) * count * 3];
    out[..5 * area].fill(0.0);
    scatter(&maps.pixels, &maps.depth_m, displacement, area, out);
    out[5 * area..6 * area].fill(f32::from(maps.available[query]));
    out[6 * area..].copy_from_slice(prior);
}

/// The gripper prior of a view at every pixel, `[H, W]`; the same for all query times. The Gaussian is separable, so
/// that one exponential per row and column is enough; the products are within one rounding of [`GripperPrior::at`].
#[must_use]
pub fn dense_prior(prior: &GripperPrior, width: u32, height: u32) -> Vec<f32> {
    if prior.depth_m <= 0.01 {
        return vec![0.0; (width * height) as usize];
    }
    let along = |count: u32, axis: usize| -> Vec<f64> {
        let metres = prior.depth_m / prior.focal_px[axis];
        let distance = |index: u32| (f64::from(index) + 0.5 - prior.centre_px[axis]) * metres;
        (0..count)
            .map(|index| libm::exp(-0.5 * distance(index).powi(2) / (prior.sigma_m * prior.sigma_m)))
            .collect()
    };
    let (columns, rows) = (along(width, 0), along(height, 1));
    rows.iter()
        .flat_map(|row| columns.iter().map(move |column| (row * column) as f32))
        .collect()
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
    out.par_chunks_exact_mut(5 * area).enumerate().for_each(|(index, out)| {
        let points = &points[index / queries];
        let mut displacement = vec![0.0f32; 3 * points.pixels.len()];
        points.displace(&links[index], &mut displacement);
        out.fill(0.0);
        scatter(&points.pixels, &points.depth_m, &displacement, area, out);
    });
}

/// Writes support, depth and displacement of the supported pixels into planes that are zero elsewhere.
fn scatter(pixels: &[u32], depth_m: &[f32], displacement: &[f32], area: usize, out: &mut [f32]) {
    let mut planes = out.chunks_exact_mut(area);
    let planes = [(); 5].map(|()| planes.next());
    let [Some(support), Some(depth), Some(x), Some(y), Some(z)] = planes else {
        return;
    };
    let (displacement, _) = displacement.as_chunks::<3>();
    for ((&pixel, &metres), d) in pixels.iter().zip(depth_m).zip(displacement) {
        let pixel = pixel as usize;
        support[pixel] = 1.0;
        depth[pixel] = metres;
        (x[pixel], y[pixel], z[pixel]) = (d[0], d[1], d[2]);
    }
}
