//! Clipping of triangles that reach before the near plane or far outside the image.

use super::project::{FixedPinhole, GUARD_PX, SUBPIXEL_BITS};

type Point = [f64; 3];

/// The part of a triangle (camera frame) behind the near plane and inside the guard band, as a convex polygon; may be
/// empty. A new corner depends on its edge alone, so that neighbouring triangles stay joined.
pub(super) fn clip(triangle: [Point; 3], pinhole: &FixedPinhole, near: f64) -> impl Iterator<Item = Point> {
    // Half a pixel inside the guard band, so that rounding cannot leave it.
    let guard = (GUARD_PX - 0.5) * f64::from(1u32 << SUBPIXEL_BITS);
    // Signed distances, non-negative inside; each plane cuts off at most one corner of a convex polygon.
    let FixedPinhole { fx, fy, cx, cy } = *pinhole;
    let planes: [[f64; 4]; 5] = [
        [0.0, 0.0, 1.0, -near],
        [fx, 0.0, cx + guard, 0.0],
        [-fx, 0.0, guard - cx, 0.0],
        [0.0, fy, cy + guard, 0.0],
        [0.0, -fy, guard - cy, 0.0],
    ];
    let mut polygon: Vec<Point> = triangle.to_vec();
    for plane in planes {
        polygon = clip_plane(&polygon, plane);
    }
    polygon.into_iter()
}

fn clip_plane(polygon: &[Point], [a, b, c, d]: [f64; 4]) -> Vec<Point> {
    let distance = |point: &Point| a * point[0] + b * point[1] + c * point[2] + d;
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (index, point) in polygon.iter().enumerate() {
        let next = &polygon[(index + 1) % polygon.len()];
        let (here, there) = (distance(point), distance(next));
        if here >= 0.0 {
            kept.push(*point);
        }
        if (here >= 0.0) != (there >= 0.0) {
            // Always from the inner to the outer end: the same numbers for both triangles of the edge.
            let (inner, outer, from, to) = if here >= 0.0 {
                (point, next, here, there)
            } else {
                (next, point, there, here)
            };
            let t = from / (from - to);
            kept.push(std::array::from_fn(|axis| {
                inner[axis] + t * (outer[axis] - inner[axis])
            }));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    const PINHOLE: FixedPinhole = FixedPinhole {
        fx: 100.0 * 65536.0,
        fy: 100.0 * 65536.0,
        cx: 0.0,
        cy: 0.0,
    };

    #[test]
    fn one_corner_before_the_near_plane_gives_a_quadrilateral() {
        let polygon: Vec<Point> = clip([[0.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]], &PINHOLE, 0.1).collect();
        assert_eq!(polygon.len(), 4);
        assert!(polygon.iter().all(|point| point[2] >= 0.1 - 1e-12));
    }

    #[test]
    fn everything_before_the_near_plane_vanishes() {
        assert_eq!(
            clip([[0.0, 0.0, -1.0], [1.0, 0.0, 0.05], [-1.0, 0.0, -1.0]], &PINHOLE, 0.1).count(),
            0
        );
    }

    #[test]
    fn far_corners_end_in_the_guard_band() {
        let polygon: Vec<Point> = clip([[0.0, 0.0, 1.0], [1e6, 0.0, 1.0], [0.0, 1e6, 1.0]], &PINHOLE, 0.1).collect();
        assert!(polygon.len() >= 3);
        assert!(
            polygon
                .iter()
                .all(|p| p[0] / p[2] * 100.0 <= GUARD_PX && p[1] / p[2] * 100.0 <= GUARD_PX)
        );
    }
}
