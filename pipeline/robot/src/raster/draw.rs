//! Triangles to pixels.

use std::ops::Range;

use rogs_geometry::{Camera, Link, Pinhole, Pose};

use super::clip::clip;
use super::project::{FixedPinhole, SUBPIXEL_BITS, ScreenVertices, matrix, transform};
use super::{MeshScene, RenderOptions};

/// Key of a pixel that nothing covers. Other keys hold the bits of the depth above the number of the triangle: for
/// positive floats the order of bits is the order of values, so the least key is the nearest surface.
pub(super) const EMPTY: u64 = u64::MAX;

/// Everything triangles are drawn from.
pub(super) struct Context<'a> {
    pub(super) scene: &'a MeshScene,
    pub(super) screen: &'a ScreenVertices,
    pub(super) camera: &'a Pinhole,
    pub(super) camera_from_link: &'a [Pose<Camera, Link>],
    pub(super) options: &'a RenderOptions,
}

/// A projected corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    pub(super) x: i32,
    pub(super) y: i32,
    pub(super) inverse_z: f32,
}

/// The image that keys are written to.
pub(super) struct Target<'a> {
    pub(super) keys: &'a mut [u64],
    pub(super) width: i32,
    pub(super) height: i32,
}

impl Context<'_> {
    /// Draws a range of triangles into a layer of keys.
    pub(super) fn draw(&self, range: Range<usize>, keys: &mut [u64]) {
        let mut target = Target {
            keys,
            width: self.camera.width as i32,
            height: self.camera.height as i32,
        };
        let triangles = &self.scene.triangles[range.clone()];
        let (xs, ys, inverse_zs) = (&self.screen.x[..], &self.screen.y[..], &self.screen.inverse_z[..]);
        for (index, triangle) in triangles.iter().enumerate() {
            let number = (range.start + index) as u32;
            let [a, b, c] = triangle.map(|corner| corner as usize);
            if self.screen.any_clipped && (inverse_zs[a] == 0.0 || inverse_zs[b] == 0.0 || inverse_zs[c] == 0.0) {
                self.draw_clipped(number, triangle, &mut target);
                continue;
            }
            let columns = target_range(xs[a], xs[b], xs[c], target.width);
            let rows = target_range(ys[a], ys[b], ys[c], target.height);
            if columns.0 > columns.1 || rows.0 > rows.1 {
                continue;
            }
            let corner = |vertex: usize| Corner {
                x: xs[vertex],
                y: ys[vertex],
                inverse_z: inverse_zs[vertex],
            };
            target.fill([corner(a), corner(b), corner(c)], columns, rows, number);
        }
    }

    #[cold]
    fn draw_clipped(&self, number: u32, triangle: &[u32; 3], target: &mut Target<'_>) {
        let link = self.scene.triangle_link[number as usize];
        let pose = matrix(&self.camera_from_link[link as usize]);
        let scene = self.scene;
        let corners = triangle.map(|corner| {
            let vertex = corner as usize;
            transform(&pose, scene.x[vertex], scene.y[vertex], scene.z[vertex])
        });
        let pinhole = FixedPinhole::new(self.camera);
        let polygon = clip(corners, &pinhole, self.options.near_m);
        let projected = polygon.map(|point| {
            let (x, y, inverse_z) = pinhole.project(point);
            Corner { x, y, inverse_z }
        });
        let projected: Vec<Corner> = projected.collect();
        for pair in projected.windows(2).skip(1) {
            let [a, b, c] = [projected[0], pair[0], pair[1]];
            let columns = target_range(a.x, b.x, c.x, target.width);
            let rows = target_range(a.y, b.y, c.y, target.height);
            if columns.0 <= columns.1 && rows.0 <= rows.1 {
                target.fill([a, b, c], columns, rows, number);
            }
        }
    }
}

/// First and last pixel centre between three coordinates, within the image; empty when the first exceeds the last.
#[inline(always)]
fn target_range(a: i32, b: i32, c: i32, size: i32) -> (i32, i32) {
    const FRACTION: i32 = (1 << SUBPIXEL_BITS) - 1;
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    (
        ((low + FRACTION) >> SUBPIXEL_BITS).max(0),
        (high >> SUBPIXEL_BITS).min(size - 1),
    )
}

/// An edge function: positive inside, with the top-left rule folded into `bias`.
#[derive(Clone, Copy)]
struct Edge {
    /// Value at the first pixel centre, without bias.
    value: i64,
    step_x: i64,
    step_y: i64,
    bias: i64,
}

impl Edge {
    /// The edge from `p` to `q` of a triangle that runs clockwise on the screen (y down).
    #[inline(always)]
    fn new(p: Corner, q: Corner, x: i64, y: i64) -> Self {
        let (dx, dy) = (i64::from(q.x) - i64::from(p.x), i64::from(q.y) - i64::from(p.y));
        let value = dx * (y - i64::from(p.y)) - dy * (x - i64::from(p.x));
        // Pixels exactly on a top edge (to the right) or a left edge (upwards) belong to the triangle.
        let owns_boundary = dy < 0 || (dy == 0 && dx > 0);
        Self {
            value,
            step_x: -dy << SUBPIXEL_BITS,
            step_y: dx << SUBPIXEL_BITS,
            bias: if owns_boundary { 0 } else { -1 },
        }
    }
}

impl Target<'_> {
    /// Draws one triangle whose bounding box holds the given pixel centres.
    #[inline(always)]
    pub(super) fn fill(&mut self, [a, b, c]: [Corner; 3], columns: (i32, i32), rows: (i32, i32), number: u32) {
        let cross = |p: Corner, q: Corner, r: Corner| {
            (i64::from(q.x) - i64::from(p.x)) * (i64::from(r.y) - i64::from(p.y))
                - (i64::from(r.x) - i64::from(p.x)) * (i64::from(q.y) - i64::from(p.y))
        };
        let area = cross(a, b, c);
        if area == 0 {
            return;
        }
        let (b, c) = if area > 0 { (b, c) } else { (c, b) };
        let area = area.abs() as f64;
        let (x, y) = (
            i64::from(columns.0) << SUBPIXEL_BITS,
            i64::from(rows.0) << SUBPIXEL_BITS,
        );
        let mut edges = [Edge::new(b, c, x, y), Edge::new(c, a, x, y), Edge::new(a, b, x, y)];
        let weights = [a, b, c].map(|corner| f64::from(corner.inverse_z));
        for row in rows.0..=rows.1 {
            let start = (row * self.width + columns.0) as usize;
            let length = (columns.1 - columns.0 + 1) as usize;
            let mut values = edges.map(|edge| edge.value);
            let mut entered = false;
            for key in &mut self.keys[start..start + length] {
                let outside = (values[0] + edges[0].bias) | (values[1] + edges[1].bias) | (values[2] + edges[2].bias);
                if outside >= 0 {
                    entered = true;
                    let inverse =
                        values[0] as f64 * weights[0] + values[1] as f64 * weights[1] + values[2] as f64 * weights[2];
                    let depth = (area / inverse) as f32;
                    *key = (*key).min(u64::from(depth.to_bits()) << 32 | u64::from(number));
                } else if entered {
                    break;
                }
                for (value, edge) in values.iter_mut().zip(&edges) {
                    *value += edge.step_x;
                }
            }
            for edge in &mut edges {
                edge.value += edge.step_y;
            }
        }
    }
}
