//! Exact rays against the triangles of a scene: which points of a track a camera sees.

use glam::DVec3;
use rogs_geometry::{Base, Pose};

use crate::frame::BodyFrame;
use crate::scene::Body;

/// Distance along `direction` (in its own lengths) to the nearest front face, and the index of the body; nothing nearer than
/// `from` counts.
pub(crate) fn first_hit(
    bodies: &[Body],
    poses: &[Pose<Base, BodyFrame>],
    origin: DVec3,
    direction: DVec3,
    from: f64,
) -> Option<(f64, usize)> {
    let mut best: Option<(f64, usize)> = None;
    for (index, (body, pose)) in bodies.iter().zip(poses).enumerate() {
        let body_from_base = pose.inverse();
        let o = body_from_base.point(origin);
        let d = body_from_base.direction(direction);
        let (centre, radius) = body.mesh.sphere;
        let to_centre = centre.as_dvec3() - o;
        let along = to_centre.dot(d) / d.length_squared();
        let miss = (to_centre - d * along).length();
        if miss > f64::from(radius) * 1.0001 + 1e-6 {
            continue;
        }
        let mesh = body.mesh.mesh();
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
            if let Some(t) = hit(o, d, a, b, c)
                && t > from
                && best.is_none_or(|(nearest, _)| t < nearest)
            {
                best = Some((t, index));
            }
        }
    }
    best
}

fn hit(o: DVec3, d: DVec3, a: DVec3, b: DVec3, c: DVec3) -> Option<f64> {
    let (u, v) = (b - a, c - a);
    let normal = u.cross(v);
    let facing = normal.dot(d);
    if facing >= 0.0 {
        return None;
    }
    let t = normal.dot(a - o) / facing;
    let p = o + d * t - a;
    // Twice the areas of the parts, along the normal.
    let (w1, w2) = (p.cross(v).dot(normal), u.cross(p).dot(normal));
    let whole = normal.length_squared();
    (w1 >= 0.0 && w2 >= 0.0 && w1 + w2 <= whole).then_some(t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_hit_front_faces_inside_the_triangle() {
        let (a, b, c) = (
            DVec3::new(0.0, 0.0, 2.0),
            DVec3::new(0.0, 1.0, 2.0),
            DVec3::new(1.0, 0.0, 2.0),
        );
        let ray = |x: f64, y: f64| hit(DVec3::ZERO, DVec3::new(x, y, 1.0), a, b, c);
        assert_eq!(ray(0.1, 0.1), Some(2.0));
        assert_eq!(ray(0.3, 0.3), None);
        assert_eq!(ray(-0.01, 0.1), None);
        assert_eq!(
            hit(DVec3::new(0.1, 0.1, 4.0), DVec3::NEG_Z, a, b, c),
            None,
            "a back face"
        );
    }
}
