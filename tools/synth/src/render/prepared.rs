//! A mesh with what shading and ray casts need of each triangle.

use glam::Vec3;

use crate::mesh::TriMesh;

/// A mesh ready to be drawn.
#[derive(Debug, Clone)]
pub(crate) struct PreparedMesh {
    mesh: TriMesh,
    /// One a triangle.
    pub faces: Vec<Face>,
    /// Centre and radius of a sphere around the mesh.
    pub sphere: (Vec3, f32),
}

/// Shading data of one triangle, in the mesh's frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Face {
    pub origin: Vec3,
    /// The barycentric weight of corner 1 at `p` is `weights[0].dot(p - origin)`; of corner 2 likewise.
    pub weights: [Vec3; 2],
    pub normals: [Vec3; 3],
    pub flat: Vec3,
    pub material: u8,
    /// Triangles of one smooth surface share this number; shading changes only slowly over them.
    pub surface: u16,
}

impl PreparedMesh {
    pub(crate) fn new(mesh: TriMesh) -> Self {
        let surfaces = surfaces(&mesh);
        let face = |(index, triangle): (usize, &[u32; 3])| {
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
            let (u, v) = (b - a, c - a);
            let normal = u.cross(v);
            let scale = 1.0 / normal.length_squared();
            Face {
                origin: a,
                weights: [v.cross(normal) * scale, normal.cross(u) * scale],
                normals: triangle.map(|v| mesh.normals[v as usize]),
                flat: normal.normalize(),
                material: mesh.materials[index],
                surface: surfaces[index],
            }
        };
        let faces = mesh.triangles.iter().enumerate().map(face).collect();
        Self {
            faces,
            sphere: mesh.bounding_sphere(),
            mesh,
        }
    }

    pub(crate) fn mesh(&self) -> &TriMesh {
        &self.mesh
    }
}

impl Face {
    /// Shading normal at a point of the face.
    pub(crate) fn normal(&self, point: Vec3) -> Vec3 {
        let [n0, n1, n2] = self.normals;
        let offset = point - self.origin;
        let (b, c) = (
            self.weights[0].dot(offset).clamp(0.0, 1.0),
            self.weights[1].dot(offset).clamp(0.0, 1.0),
        );
        (n0 + (n1 - n0) * b + (n2 - n0) * c).normalize_or(self.flat)
    }
}

/// Numbers the connected parts of the mesh: vertices are shared only where the surface is smooth.
fn surfaces(mesh: &TriMesh) -> Vec<u16> {
    let mut parent: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    fn root(parent: &mut [u32], mut v: u32) -> u32 {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    }
    for t in &mesh.triangles {
        let first = root(&mut parent, t[0]);
        for &other in &t[1..] {
            let other = root(&mut parent, other);
            parent[other as usize] = first;
        }
    }
    mesh.triangles
        .iter()
        .zip(&mesh.materials)
        .map(|(t, &m)| (root(&mut parent, t[0]) as u16) ^ (u16::from(m) << 12))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_barycentric_and_surfaces_split_at_edges() {
        let prepared = PreparedMesh::new(TriMesh::cylinder(0.1, 0.2, 12));
        let mesh = prepared.mesh().clone();
        for (face, triangle) in prepared.faces.iter().zip(&mesh.triangles) {
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
            for (p, expected) in [(a, [0.0, 0.0]), (b, [1.0, 0.0]), (c, [0.0, 1.0])] {
                for k in 0..2 {
                    assert!((face.weights[k].dot(p - face.origin) - expected[k]).abs() < 1e-4);
                }
            }
        }
        let mut numbers: Vec<u16> = prepared.faces.iter().map(|f| f.surface).collect();
        numbers.sort_unstable();
        numbers.dedup();
        assert!(numbers.len() >= 3, "barrel and two ends: {numbers:?}");
    }
}
