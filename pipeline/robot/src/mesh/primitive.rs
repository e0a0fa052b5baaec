//! The primitive shapes of URDF as meshes.

use super::Mesh;

/// Corners around a circle: the polygon stays within 0.22 % of the radius.
const SEGMENTS: u32 = 48;

/// A box centred at the origin.
pub(super) fn cuboid(size: [f64; 3]) -> Mesh {
    let corner =
        |index: u32| std::array::from_fn(|axis| (size[axis] * if index >> axis & 1 == 1 { 0.5 } else { -0.5 }) as f32);
    let faces: [[u32; 4]; 6] = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Mesh {
        positions: (0..8).map(corner).collect(),
        triangles,
    }
}

/// A cylinder around z, centred at the origin.
pub(super) fn cylinder(radius: f64, length: f64) -> Mesh {
    let mut mesh = Mesh::default();
    for end in [-0.5, 0.5] {
        mesh.positions.push([0.0, 0.0, (end * length) as f32]);
        mesh.positions
            .extend((0..SEGMENTS).map(|step| ring(step, radius, end * length)));
    }
    let upper = SEGMENTS + 1;
    for step in 0..SEGMENTS {
        let (this, next) = (1 + step, 1 + (step + 1) % SEGMENTS);
        mesh.triangles.extend([
            [0, next, this],
            [upper, upper + this, upper + next],
            [this, next, upper + next],
            [this, upper + next, upper + this],
        ]);
    }
    mesh
}

/// A sphere centred at the origin.
pub(super) fn sphere(radius: f64) -> Mesh {
    capsule(radius, 0.0)
}

/// A cylinder around z with half a sphere at each end, centred at the origin; `length` is that of the cylinder.
pub(super) fn capsule(radius: f64, length: f64) -> Mesh {
    let bands = SEGMENTS / 2;
    let mut mesh = Mesh::default();
    let half = 0.5 * length;
    // The rings from below to above; that of the equator is there twice where a cylinder lies between.
    let mut rings: Vec<(f64, f64)> = (1..bands)
        .map(|band| {
            let (sin, cos) = libm::sincos(std::f64::consts::PI * f64::from(band) / f64::from(bands));
            let shift = if 2 * band > bands { half } else { -half };
            (radius * sin, -radius * cos + shift)
        })
        .collect();
    if length > 0.0 {
        rings.insert((bands / 2) as usize, (radius, half));
    }
    mesh.positions.push([0.0, 0.0, (-radius - half) as f32]);
    for &(around, z) in &rings {
        mesh.positions.extend((0..SEGMENTS).map(|step| ring(step, around, z)));
    }
    mesh.positions.push([0.0, 0.0, (radius + half) as f32]);
    let rings = rings.len() as u32;
    let vertex = |ring: u32, step: u32| 1 + ring * SEGMENTS + step % SEGMENTS;
    let last = 1 + rings * SEGMENTS;
    for step in 0..SEGMENTS {
        mesh.triangles.push([0, vertex(0, step + 1), vertex(0, step)]);
        for ring in 0..rings - 1 {
            let (a, b) = (vertex(ring, step), vertex(ring, step + 1));
            let (c, d) = (vertex(ring + 1, step), vertex(ring + 1, step + 1));
            mesh.triangles.extend([[a, b, d], [a, d, c]]);
        }
        mesh.triangles
            .push([last, vertex(rings - 1, step), vertex(rings - 1, step + 1)]);
    }
    mesh
}

fn ring(step: u32, radius: f64, z: f64) -> [f32; 3] {
    let (sin, cos) = libm::sincos(2.0 * std::f64::consts::PI * f64::from(step) / f64::from(SEGMENTS));
    [(radius * cos) as f32, (radius * sin) as f32, z as f32]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// Signed volume: positive for a closed mesh whose faces turn outwards.
    fn volume(mesh: &Mesh) -> f64 {
        let at = |corner: u32| DVec3::from_array(mesh.positions[corner as usize].map(f64::from));
        mesh.triangles
            .iter()
            .map(|&[a, b, c]| at(a).dot(at(b).cross(at(c))) / 6.0)
            .sum()
    }

    #[test]
    fn volumes_are_right_and_faces_turn_outwards() {
        assert!((volume(&cuboid([1.0, 2.0, 3.0])) - 6.0).abs() < 1e-6);
        let pi = std::f64::consts::PI;
        assert!((volume(&cylinder(0.5, 2.0)) / (pi * 0.5) - 1.0).abs() < 4e-3);
        assert!((volume(&sphere(0.5)) / (pi / 6.0) - 1.0).abs() < 8e-3);
        assert!((volume(&capsule(0.5, 2.0)) / (pi * (0.5 + 1.0 / 6.0)) - 1.0).abs() < 8e-3);
        let top = |mesh: &Mesh| mesh.positions.iter().map(|position| position[2]).fold(0.0, f32::max);
        assert_eq!(top(&capsule(0.5, 2.0)), 1.5);
    }

    #[test]
    fn every_edge_has_two_faces() {
        for mesh in [cuboid([1.0; 3]), cylinder(1.0, 1.0), sphere(1.0), capsule(1.0, 1.0)] {
            let mut edges: Vec<(u32, u32)> = mesh
                .triangles
                .iter()
                .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
                .collect();
            edges.sort_unstable();
            assert!(edges.iter().all(|&(a, b)| edges.binary_search(&(b, a)).is_ok()));
        }
    }
}
