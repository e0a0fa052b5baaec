//! Scan conversion of convex polygons with an affine key per pixel: the largest key wins.
//!
//! Cameras use inverse depth as the key, shadow maps the height towards the light; both are affine in the image. A sample
//! point on a shared edge belongs to exactly one of the two polygons, because both solve the same edge line.

use glam::DVec2;

/// A grid of keys, and of the number of the polygon that is seen.
#[derive(Debug, Default)]
pub(crate) struct Layer {
    pub width: usize,
    pub height: usize,
    /// Where in its pixel the sample lies, relative to the centre.
    pub offset: [f64; 2],
    pub key: Vec<f32>,
    pub owner: Vec<u32>,
}

/// Value of [`Layer::owner`] where nothing is seen.
pub(crate) const NOBODY: u32 = u32::MAX;

impl Layer {
    /// Empties the layer for a new image; memory is kept.
    pub(crate) fn reset(&mut self, width: usize, height: usize, offset: [f64; 2], lowest: f32) {
        (self.width, self.height, self.offset) = (width, height, offset);
        self.key.clear();
        self.key.resize(width * height, lowest);
        self.owner.clear();
        self.owner.resize(width * height, NOBODY);
    }

    /// Draws a convex polygon of at most [`MAX_CORNERS`] corners. `key` is (per x, per y, constant) in pixels, `limit`
    /// the largest key of its corners: rounding must not lift slivers above what is in front of them.
    pub(crate) fn draw(&mut self, polygon: &Polygon, key: [f64; 3], limit: f32, owner: u32) {
        let [ox, oy] = [self.offset[0] + 0.5, self.offset[1] + 0.5];
        let first = (polygon.low.y - oy).ceil().max(0.0) as usize;
        let last = (polygon.high.y - oy).floor().min(self.height as f64 - 1.0);
        if last < 0.0 {
            return;
        }
        let (per_x, end_x) = (key[0] as f32, self.width as f64);
        for row in first..=(last as usize) {
            let y = row as f64 + oy;
            let (mut left, mut right) = (polygon.low.x, polygon.high.x);
            let mut outside = false;
            for edge in &polygon.edges[..polygon.count] {
                match edge.kind {
                    EdgeKind::Left => left = left.max(edge.slope * y + edge.start),
                    EdgeKind::Right => right = right.min(edge.slope * y + edge.start),
                    EdgeKind::Below => outside |= y < edge.start,
                    EdgeKind::Above => outside |= y >= edge.start,
                }
            }
            // A sample at x belongs to the polygon when left <= x < right.
            let begin = up((left - ox).clamp(0.0, end_x));
            let end = up((right - ox).clamp(0.0, end_x));
            if outside || begin >= end {
                continue;
            }
            let line = row * self.width;
            let constant = (key[1] * y + key[2] + key[0] * (begin as f64 + ox)) as f32;
            let keys = &mut self.key[line + begin..line + end];
            let owners = &mut self.owner[line + begin..line + end];
            for (step, (held, name)) in keys.iter_mut().zip(owners).enumerate() {
                let value = (per_x * step as f32 + constant).min(limit);
                let nearer = value > *held;
                *held = if nearer { value } else { *held };
                *name = if nearer { owner } else { *name };
            }
        }
    }
}

/// Rounds a number in 0..2^31 up. Without SSE4.1 `ceil` is a call, and this runs for every row of every triangle.
fn up(x: f64) -> usize {
    let cut = x as i32;
    (cut + i32::from(f64::from(cut) < x)) as usize
}

/// Most corners of a [`Polygon`]: a triangle cut by the near plane.
pub(crate) const MAX_CORNERS: usize = 4;

#[derive(Debug, Clone, Copy)]
enum EdgeKind {
    Left,
    Right,
    Below,
    Above,
}

#[derive(Debug, Clone, Copy)]
struct Edge {
    kind: EdgeKind,
    /// x of the edge line is `slope * y + start`; for level edges `start` is y.
    slope: f64,
    start: f64,
}

/// A convex polygon ready to be drawn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Polygon {
    edges: [Edge; MAX_CORNERS],
    count: usize,
    low: DVec2,
    high: DVec2,
}

impl Polygon {
    /// From corners in image coordinates, in either order; `None` when it is empty or lies outside the image.
    pub(crate) fn new(corners: &[DVec2], width: usize, height: usize) -> Option<Self> {
        let low = corners.iter().copied().fold(DVec2::INFINITY, DVec2::min);
        let high = corners.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        if !(low.x < width as f64 && low.y < height as f64 && high.x > 0.0 && high.y > 0.0) {
            return None;
        }
        let mut twice_area = 0.0;
        for k in 1..corners.len() - 1 {
            twice_area += (corners[k] - corners[0]).perp_dot(corners[k + 1] - corners[0]);
        }
        if twice_area.abs() < 1e-12 || !twice_area.is_finite() {
            return None;
        }
        let blank = Edge {
            kind: EdgeKind::Above,
            slope: 0.0,
            start: 0.0,
        };
        let mut polygon = Self {
            edges: [blank; MAX_CORNERS],
            count: corners.len(),
            low,
            high,
        };
        for (k, slot) in polygon.edges[..corners.len()].iter_mut().enumerate() {
            let (p, q) = (corners[k], corners[(k + 1) % corners.len()]);
            *slot = edge(p, q, twice_area > 0.0);
        }
        Some(polygon)
    }
}

/// The edge from `p` to `q`. With a positive area (y down) the inside lies to its right in the picture's sense.
fn edge(p: DVec2, q: DVec2, positive: bool) -> Edge {
    // Both polygons of a shared edge must compute the same line: order the ends.
    let (a, b) = if (p.y, p.x) <= (q.y, q.x) { (p, q) } else { (q, p) };
    let goes_down = (p.y, p.x) <= (q.y, q.x);
    let rise = b.y - a.y;
    if rise <= 0.0 {
        let rightwards = q.x > p.x;
        let kind = if rightwards == positive {
            EdgeKind::Below
        } else {
            EdgeKind::Above
        };
        return Edge {
            kind,
            slope: 0.0,
            start: a.y,
        };
    }
    let slope = (b.x - a.x) / rise;
    let kind = if goes_down == positive {
        EdgeKind::Right
    } else {
        EdgeKind::Left
    };
    Edge {
        kind,
        slope,
        start: a.x - slope * a.y,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Draw;

    fn layer(width: usize, height: usize) -> Layer {
        let mut layer = Layer::default();
        layer.reset(width, height, [0.0, 0.0], 0.0);
        layer
    }

    /// A fan of random triangles that tiles a square covers every sample exactly once.
    #[test]
    fn shared_edges_leave_no_gap_and_no_overlap() {
        let mut draw = Draw::new(11, 0);
        for _ in 0..200 {
            let middle = DVec2::new(draw.range(1.0, 19.0).round(), draw.range(1.0, 19.0));
            let outline = [
                [0.0, 0.0],
                [7.0, 0.0],
                [20.0, 0.0],
                [20.0, 13.5],
                [20.0, 20.0],
                [3.0, 20.0],
                [0.0, 20.0],
                [0.0, 5.5],
            ];
            let mut count = vec![0; 400];
            for k in 0..outline.len() {
                let corners = [middle, outline[k].into(), outline[(k + 1) % outline.len()].into()];
                let mut layer = layer(20, 20);
                if let Some(polygon) = Polygon::new(&corners, 20, 20) {
                    layer.draw(&polygon, [0.0, 0.0, 1.0], 1.0, 7);
                }
                for (total, owner) in count.iter_mut().zip(&layer.owner) {
                    *total += usize::from(*owner == 7);
                }
            }
            assert!(count.iter().all(|&n| n == 1), "{count:?}");
        }
    }

    #[test]
    fn the_larger_key_wins_in_either_order() {
        let corners = |x: f64| [DVec2::new(x, 1.0), DVec2::new(x + 8.0, 2.0), DVec2::new(x + 1.0, 9.0)];
        let mut picture = Vec::new();
        for order in [[1u32, 2], [2, 1]] {
            let mut layer = layer(12, 10);
            for owner in order {
                let polygon = Polygon::new(&corners(f64::from(owner)), 12, 10).unwrap();
                layer.draw(&polygon, [0.0, 0.0, f64::from(owner)], 9.0, owner);
            }
            picture.push(layer.owner);
        }
        assert_eq!(picture[0], picture[1]);
        assert!(picture[0].contains(&1) && picture[0].contains(&2));
    }
}
