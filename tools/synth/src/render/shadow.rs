//! Height maps seen from a light: where the key light reaches, and how much of the sky a point sees.

use glam::{Affine3A, DVec2, Mat3A, Vec3, Vec3A};

use super::raster::{Layer, Polygon};
use crate::math::floor;

/// A parallel projection along a direction, with the surface nearest to the light at every texel.
#[derive(Debug)]
pub(crate) struct LightMap {
    /// Base frame to (column, row, height) of the map.
    pub map_from_base: Affine3A,
    /// Texels per metre.
    pub texels: f32,
    layer: Layer,
    tops: Tops,
}

/// The highest surface within [`FAR_RING`] of any texel of a block: where that is not above a point, nothing covers its sky.
#[derive(Debug, Default)]
struct Tops {
    /// Blocks of a row.
    count: usize,
    heights: Vec<f32>,
}

/// Texels of a block of [`Tops`].
const BLOCK: usize = 6;
/// Distances at which a point looks for what stands around it, metres.
const NEAR_RING: f32 = 0.018;
const FAR_RING: f32 = 0.07;
/// What rises less than this covers nothing, metres.
const LEAST_RISE: f32 = 0.004;

/// Where things throw shadows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ShadowRegion {
    /// Half its width, metres.
    pub half_width: f32,
    /// Its middle in the base frame, metres.
    pub middle: Vec3A,
}

impl ShadowRegion {
    /// The workspace of the robot.
    pub(crate) const WORKSPACE: Self = Self {
        half_width: 1.0,
        middle: Vec3A::new(0.40, 0.0, 0.15),
    };
}

impl LightMap {
    /// An empty map of `size` x `size` texels for light from the unit vector `towards`.
    pub(crate) fn new(towards: Vec3, size: usize, region: ShadowRegion) -> Self {
        let z = Vec3A::from(towards);
        let x = if z.x.abs() < 0.9 { Vec3A::X } else { Vec3A::Y };
        let x = (x - z * z.dot(x)).normalize();
        let y = z.cross(x);
        let texels = size as f32 / (2.0 * region.half_width);
        // Rows of the rotation are the axes; columns and rows are scaled to texels, height stays in metres.
        let rotation = Mat3A::from_cols(x * texels, y * texels, z).transpose();
        let shift = Vec3A::new(0.5 * size as f32, 0.5 * size as f32, 0.0) - rotation * region.middle;
        let mut layer = Layer::default();
        layer.reset(size, size, [0.0, 0.0], f32::NEG_INFINITY);
        Self {
            map_from_base: Affine3A::from_mat3_translation(rotation.into(), shift.into()),
            texels,
            layer,
            tops: Tops::default(),
        }
    }

    /// Prepares the finished map for [`Self::openness`].
    pub(crate) fn finish(&mut self) {
        let size = self.layer.width;
        let count = size.div_ceil(BLOCK);
        let mut own = vec![f32::NEG_INFINITY; count * count];
        for (row, line) in self.layer.key.chunks_exact(size).enumerate() {
            let blocks = &mut own[row / BLOCK * count..][..count];
            for (top, texels) in blocks.iter_mut().zip(line.chunks(BLOCK)) {
                *top = texels.iter().fold(*top, |top, &height| top.max(height));
            }
        }
        // Taps lie at most this many blocks away, one more for the place within the block.
        let reach = (FAR_RING * self.texels) as usize / BLOCK + 2;
        let near = |place: usize| place.saturating_sub(reach)..(place + reach + 1).min(count);
        let heights = (0..count * count).map(|block| {
            let columns = near(block % count);
            let rows = near(block / count).flat_map(|row| &own[row * count..][columns.clone()]);
            rows.fold(f32::NEG_INFINITY, |top, &height| top.max(height))
        });
        self.tops = Tops {
            count,
            heights: heights.collect(),
        };
    }

    /// Whether nothing near a point rises above it. Points outside the map are for the taps to decide.
    fn clear(&self, point: Vec3A) -> bool {
        let (column, row) = (point.x as usize / BLOCK, point.y as usize / BLOCK);
        let inside = point.x >= 0.0 && point.y >= 0.0 && column < self.tops.count && row < self.tops.count;
        inside && self.tops.heights[row * self.tops.count + column] - point.z <= LEAST_RISE
    }

    /// Whether a ball may throw a shadow into the map; its centre is given in the map's frame, its radius in metres.
    pub(crate) fn reaches(&self, centre: Vec3A, radius: f32) -> bool {
        let (around, size) = (radius * self.texels * 1.001 + 1.0, self.layer.width as f32);
        let within = |x: f32| x + around > 0.0 && x - around < size;
        within(centre.x) && within(centre.y)
    }

    /// Draws a mesh whose corners are given in the map's frame.
    pub(crate) fn draw(&mut self, corners: &[Vec3A], triangles: &[[u32; 3]]) {
        let (width, height) = (self.layer.width, self.layer.height);
        for triangle in triangles {
            let [a, b, c] = triangle.map(|v| corners[v as usize].as_dvec3());
            let normal = (b - a).cross(c - a);
            // Seen from the light's side only; surfaces edge-on throw no shadow of their own.
            if normal.z <= 1e-12 {
                continue;
            }
            let points = [a, b, c].map(|p| DVec2::new(p.x, p.y));
            let Some(polygon) = Polygon::new(&points, width, height) else {
                continue;
            };
            let key = [-normal.x / normal.z, -normal.y / normal.z, normal.dot(a) / normal.z];
            self.layer.draw(&polygon, key, a.z.max(b.z).max(c.z) as f32, 0);
        }
    }

    fn height(&self, column: i32, row: i32) -> f32 {
        let size = self.layer.width as i32;
        if column < 0 || row < 0 || column >= size || row >= size {
            return f32::NEG_INFINITY;
        }
        self.layer.key[(row * size + column) as usize]
    }

    /// Share of the light that reaches a point given in the map's frame: a smooth 4 x 4 window of `spread` texels.
    pub(crate) fn light(&self, point: Vec3A, bias: f32, spread: f32) -> f32 {
        let limit = point.z + bias;
        let (u, v) = (point.x / spread - 0.5, point.y / spread - 0.5);
        let (u0, v0) = (floor(u), floor(v));
        let (fu, fv) = (u - u0, v - v0);
        // Box of three cells, centred: weights 1-f, 1, 1, f along each axis.
        let (wu, wv) = ([1.0 - fu, 1.0, 1.0, fu], [1.0 - fv, 1.0, 1.0, fv]);
        let column = |k: usize| ((u0 + k as f32 - 0.5) * spread) as i32;
        let columns = [0, 1, 2, 3].map(column);
        let size = self.layer.width as i32;
        let rows = [0, 1, 2, 3].map(|k: usize| ((v0 + k as f32 - 0.5) * spread) as i32);
        if columns[0] < 0 || rows[0] < 0 || columns[3] >= size || rows[3] >= size || u0 < 1.0 || v0 < 1.0 {
            return 1.0;
        }
        let mut sum = 0.0;
        for (row, wv) in rows.into_iter().zip(wv) {
            let line = &self.layer.key[(row * size) as usize..][..size as usize];
            let mut along = 0.0;
            for (column, wu) in columns.into_iter().zip(wu) {
                along += if line[column as usize] > limit { 0.0 } else { wu };
            }
            sum += along * wv;
        }
        sum / 9.0
    }

    /// Share of the sky over a point: the map looks straight down, and what stands up around the point covers some.
    pub(crate) fn openness(&self, point: Vec3A, turn: f32) -> f32 {
        // Four directions at two distances, turned from pixel to pixel.
        const RING: [(f32, f32); 4] = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)];
        if self.clear(point) {
            return 1.0;
        }
        let mut covered = 0.0;
        for (ring, metres) in [NEAR_RING, FAR_RING].into_iter().enumerate() {
            let (c, s) = ((turn + ring as f32 * 0.35) * 0.9, 1.0);
            let scale = metres * self.texels / (c * c + s * s).sqrt();
            for (x, y) in RING {
                let (dx, dy) = ((x * c - y * s) * scale, (x * s + y * c) * scale);
                let height = self.height(floor(point.x + dx) as i32, floor(point.y + dy) as i32);
                let rise = height - point.z;
                if rise > LEAST_RISE {
                    // Things high above cover little of the sky, near walls cover half of it.
                    let slope = (rise / metres).min(2.0) * 0.5;
                    covered += slope / (1.0 + (rise / 0.25) * (rise / 0.25));
                }
            }
        }
        1.0 - (covered / 8.0).min(0.85)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriMesh;

    fn drawn(towards: Vec3) -> LightMap {
        let mut map = LightMap::new(towards, 400, ShadowRegion::WORKSPACE);
        let mesh = TriMesh::cuboid([0.1, 0.1, 0.1]).at(0.4, 0.0, 0.1);
        let corners: Vec<Vec3A> = mesh
            .positions
            .iter()
            .map(|p| map.map_from_base.transform_point3a((*p).into()))
            .collect();
        map.draw(&corners, &mesh.triangles);
        map.finish();
        map
    }

    #[test]
    fn a_box_shades_what_lies_behind_it() {
        let map = drawn(Vec3::new(1.0, 0.0, 1.0).normalize());
        let at = |x: f32, y: f32| map.light(map.map_from_base.transform_point3a(Vec3A::new(x, y, 0.0)), 0.003, 1.0);
        // The shadow of its 20 cm reaches from x = 0.3 down to 0.1.
        assert_eq!(at(0.2, 0.0), 0.0);
        assert_eq!(at(0.05, 0.0), 1.0);
        assert_eq!(at(0.2, 0.2), 1.0);
        let edge = at(0.2, 0.1);
        assert!(edge > 0.0 && edge < 1.0, "{edge}");
    }

    #[test]
    fn the_foot_of_a_box_sees_less_sky() {
        let map = drawn(Vec3::Z);
        let at = |x: f32| map.openness(map.map_from_base.transform_point3a(Vec3A::new(x, 0.0, 0.0)), 0.2);
        assert!(at(0.51) < at(0.55) && at(0.55) < at(0.75));
        assert_eq!(at(0.75), 1.0);
    }

    #[test]
    fn the_short_cut_changes_nothing() {
        let map = drawn(Vec3::Z);
        let whole = LightMap {
            tops: Tops::default(),
            ..drawn(Vec3::Z)
        };
        let mut covered = 0;
        for step in 0..20_000 {
            let (x, y) = ((step % 141) as f32 * 3.0 - 10.0, (step / 141) as f32 * 3.0 - 10.0);
            let point = Vec3A::new(x, y, 0.01 * (step % 7) as f32 - 0.02);
            let open = map.openness(point, 0.1 * (step % 11) as f32);
            assert_eq!(open, whole.openness(point, 0.1 * (step % 11) as f32));
            covered += usize::from(open < 1.0);
        }
        assert!(covered > 300, "{covered}");
    }
}
