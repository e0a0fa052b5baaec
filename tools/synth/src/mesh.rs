//! Closed triangle meshes of simple solids: the only shapes that are rendered, written and ray-cast.

use glam::{DVec3, Vec3};
use rogs_geometry::Pose;

use crate::frame::BodyFrame;

/// A set of closed solids as triangles, counter-clockwise seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriMesh {
    /// Vertex positions, metres.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one a vertex; edges that are meant to be sharp have their vertices twice.
    pub normals: Vec<Vec3>,
    /// Corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Material of each triangle, an index into the body's materials.
    pub materials: Vec<u8>,
}

/// A closed curve in a plane of constant height: one cross section of a [`TriMesh::loft`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Section {
    /// Height along the axis, metres.
    pub z: f64,
    /// Centre.
    pub centre: [f64; 2],
    /// Half widths.
    pub half: [f64; 2],
    /// 2 is an ellipse, larger is squarer.
    pub power: f64,
}

impl Section {
    pub(crate) fn circle(z: f64, radius: f64) -> Self {
        Self {
            z,
            centre: [0.0; 2],
            half: [radius; 2],
            power: 2.0,
        }
    }

    pub(crate) fn oval(z: f64, centre: [f64; 2], half: [f64; 2], power: f64) -> Self {
        Self { z, centre, half, power }
    }

    fn point(&self, turn: f64) -> DVec3 {
        let angle = std::f64::consts::TAU * turn;
        let bend = |v: f64| v.signum() * libm::pow(v.abs(), 2.0 / self.power);
        DVec3::new(
            self.centre[0] + self.half[0] * bend(libm::cos(angle)),
            self.centre[1] + self.half[1] * bend(libm::sin(angle)),
            self.z,
        )
    }
}

impl TriMesh {
    /// Sections ascending in z are joined to a shell with flat ends. Where the outline bends by more than about 40
    /// degrees between bands, the edge is sharp.
    pub(crate) fn loft(sections: &[Section], segments: usize) -> Self {
        let rings: Vec<Vec<DVec3>> = sections
            .iter()
            .map(|section| {
                (0..segments)
                    .map(|i| section.point(i as f64 / segments as f64))
                    .collect()
            })
            .collect();
        Self::skin(&rings, true)
    }

    /// Revolves a profile of (radius, z), z ascending along the outside; it starts and ends on the axis by flat ends.
    pub(crate) fn lathe(profile: &[[f64; 2]], segments: usize) -> Self {
        let rings: Vec<Vec<DVec3>> = profile
            .iter()
            .map(|&[radius, z]| {
                let point = |i: usize| {
                    let angle = std::f64::consts::TAU * i as f64 / segments as f64;
                    DVec3::new(radius * libm::cos(angle), radius * libm::sin(angle), z)
                };
                (0..segments).map(point).collect()
            })
            .collect();
        Self::skin(&rings, true)
    }

    /// A tube of rings, counter-clockwise about the direction from the first to the last, closed by fans.
    fn skin(rings: &[Vec<DVec3>], smooth: bool) -> Self {
        let mut mesh = Self::default();
        let n = rings[0].len();
        for pair in rings.windows(2) {
            for i in 0..n {
                let j = (i + 1) % n;
                let corners = [pair[0][i], pair[0][j], pair[1][j], pair[1][i]];
                mesh.quad(corners);
            }
        }
        for (ring, first) in [(&rings[0], true), (&rings[rings.len() - 1], false)] {
            let centre = ring.iter().sum::<DVec3>() / n as f64;
            for i in 0..n {
                let (a, b) = (ring[i], ring[(i + 1) % n]);
                if first {
                    mesh.triangle([centre, b, a])
                } else {
                    mesh.triangle([centre, a, b])
                }
            }
        }
        if smooth { mesh.smoothed(0.76) } else { mesh }
    }

    /// Triangles that others made, once for each side; whatever hangs together is one part, the larger parts have materials of
    /// their own, up to `most_parts`. Triangles without an area are left out.
    pub(crate) fn two_sided(positions: &[[f32; 3]], triangles: &[[u32; 3]], most_parts: usize) -> Self {
        let part_of = connected(positions.len(), triangles);
        let mut sizes = vec![0usize; positions.len()];
        for [corner, ..] in triangles {
            sizes[part_of[*corner as usize]] += 1;
        }
        let mut order: Vec<usize> = (0..sizes.len()).filter(|&part| sizes[part] > 0).collect();
        order.sort_by_key(|&part| (std::cmp::Reverse(sizes[part]), part));
        let mut material = vec![0u8; sizes.len()];
        for (rank, &part) in order.iter().enumerate() {
            material[part] = (rank % most_parts.max(1)) as u8;
        }
        let mut mesh = Self::default();
        for triangle in triangles {
            let [a, b, c] = triangle.map(|v| Vec3::from_array(positions[v as usize]).as_dvec3());
            let before = mesh.triangles.len();
            mesh.triangle([a, b, c]);
            mesh.triangle([a, c, b]);
            mesh.materials[before..].fill(material[part_of[triangle[0] as usize]]);
        }
        mesh.smoothed(0.76)
    }

    fn quad(&mut self, [a, b, c, d]: [DVec3; 4]) {
        self.triangle([a, b, c]);
        self.triangle([a, c, d]);
    }

    fn triangle(&mut self, corners: [DVec3; 3]) {
        let cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        // Bands of a cone's tip and the like collapse to lines; they enclose nothing.
        if cross.length() < 1e-12 {
            return;
        }
        let start = self.positions.len() as u32;
        self.positions.extend(corners.map(|corner| corner.as_vec3()));
        self.normals.extend([cross.normalize().as_vec3(); 3]);
        self.triangles.push([start, start + 1, start + 2]);
        self.materials.push(0);
    }

    /// Averages normals of equal positions whose faces differ by less than the angle of this cosine; merges vertices.
    fn smoothed(self, cosine: f32) -> Self {
        let key = |p: Vec3| p.to_array().map(|v| (f64::from(v) * 1e7).round() as i64);
        let mut order: Vec<usize> = (0..self.positions.len()).collect();
        order.sort_by_key(|&i| (key(self.positions[i]), i));
        let face_area = |vertex: usize| {
            let [a, b, c] = [0, 1, 2].map(|k| self.positions[vertex / 3 * 3 + k]);
            (b - a).cross(c - a)
        };
        let mut result = Self {
            materials: self.materials.clone(),
            ..Self::default()
        };
        let mut index_of = vec![0u32; self.positions.len()];
        for group in order.chunk_by(|&a, &b| key(self.positions[a]) == key(self.positions[b])) {
            let first_new = result.positions.len();
            for &vertex in group {
                let own = self.normals[vertex];
                let near = group.iter().filter(|&&other| self.normals[other].dot(own) > cosine);
                let normal = near.map(|&other| face_area(other)).sum::<Vec3>().normalize_or(own);
                let same = (first_new..result.positions.len()).find(|&i| result.normals[i].dot(normal) > 0.9999);
                index_of[vertex] = same.unwrap_or_else(|| {
                    result.positions.push(self.positions[group[0]]);
                    result.normals.push(normal);
                    result.positions.len() - 1
                }) as u32;
            }
        }
        result.triangles = self.triangles.iter().map(|t| t.map(|v| index_of[v as usize])).collect();
        result
    }

    /// A box with flat faces.
    pub(crate) fn cuboid(half: [f64; 3]) -> Self {
        let [x, y, z] = half;
        let ring = |z: f64| {
            [[-x, -y], [x, -y], [x, y], [-x, y]]
                .map(|[a, b]| DVec3::new(a, b, z))
                .to_vec()
        };
        Self::skin(&[ring(-z), ring(z)], false)
    }

    /// A box with chamfered edges.
    pub(crate) fn chamfered(half: [f64; 3], chamfer: f64) -> Self {
        let [x, y, z] = half;
        let c = chamfer.min(0.45 * x.min(y).min(z));
        let ring = |inset: f64, z: f64| {
            let (x, y) = (x - inset, y - inset);
            let points = [
                [-x + c, -y],
                [x - c, -y],
                [x, -y + c],
                [x, y - c],
                [x - c, y],
                [-x + c, y],
                [-x, y - c],
                [-x, -y + c],
            ];
            points.map(|[a, b]| DVec3::new(a, b, z)).to_vec()
        };
        Self::skin(&[ring(c, -z), ring(0.0, -z + c), ring(0.0, z - c), ring(c, z)], false)
    }

    /// A cylinder along z, centred, with slightly rounded rims.
    pub(crate) fn cylinder(radius: f64, half_length: f64, segments: usize) -> Self {
        let rim = 0.12 * radius.min(half_length);
        let (r, h) = (radius, half_length);
        Self::lathe(&[[r - rim, -h], [r, -h + rim], [r, h - rim], [r - rim, h]], segments)
    }

    /// A prism with a regular polygon as base.
    pub(crate) fn prism(radius: f64, half_length: f64, sides: usize) -> Self {
        let ring = |z: f64| {
            let point = |i: usize| {
                let angle = std::f64::consts::TAU * i as f64 / sides as f64;
                DVec3::new(radius * libm::cos(angle), radius * libm::sin(angle), z)
            };
            (0..sides).map(point).collect::<Vec<_>>()
        };
        Self::skin(&[ring(-half_length), ring(half_length)], false)
    }

    /// A sphere, or with `scale` an ellipsoid.
    pub(crate) fn ellipsoid(half: [f64; 3], segments: usize) -> Self {
        let rows = segments / 2;
        let profile: Vec<[f64; 2]> = (0..=rows)
            .map(|i| {
                let angle = std::f64::consts::PI * i as f64 / rows as f64;
                [libm::sin(angle).max(0.0), -libm::cos(angle)]
            })
            .collect();
        let scale = DVec3::from_array(half);
        let mut mesh = Self::lathe(&profile, segments);
        for (p, n) in mesh.positions.iter_mut().zip(&mut mesh.normals) {
            *p *= scale.as_vec3();
            *n = (*n / scale.as_vec3()).normalize();
        }
        mesh
    }

    /// An arc of a ring in the x-z plane: `major` and `minor` radii, from `start` to `end` turns.
    pub(crate) fn handle(major: f64, minor: f64, start: f64, end: f64, segments: usize) -> Self {
        let rings: Vec<Vec<DVec3>> = (0..=segments)
            .map(|i| {
                let angle = std::f64::consts::TAU * (start + (end - start) * i as f64 / segments as f64);
                let radial = DVec3::new(libm::cos(angle), 0.0, libm::sin(angle));
                let point = |k: usize| {
                    let turn = std::f64::consts::TAU * k as f64 / 8.0;
                    radial * (major + minor * libm::cos(turn)) + DVec3::Y * (minor * libm::sin(turn))
                };
                (0..8).map(point).collect()
            })
            .collect();
        Self::skin(&rings, true)
    }

    /// The same mesh moved rigidly.
    pub(crate) fn placed(mut self, pose: Pose<BodyFrame, BodyFrame>) -> Self {
        let rotation = pose.rotation;
        for position in &mut self.positions {
            *position = pose.point(position.as_dvec3()).as_vec3();
        }
        for normal in &mut self.normals {
            *normal = (rotation * normal.as_dvec3()).as_vec3().normalize();
        }
        self
    }

    /// The same mesh, larger by a factor.
    pub(crate) fn scaled(mut self, factor: f64) -> Self {
        self.positions
            .iter_mut()
            .for_each(|position| *position *= factor as f32);
        self
    }

    /// The same mesh shifted.
    pub(crate) fn at(self, x: f64, y: f64, z: f64) -> Self {
        self.placed(Pose::from_translation(DVec3::new(x, y, z)))
    }

    /// The same mesh, all of one material.
    pub(crate) fn of(mut self, material: u8) -> Self {
        self.materials.fill(material);
        self
    }

    /// Adds the solids of another mesh.
    pub(crate) fn join(&mut self, other: Self) {
        let start = self.positions.len() as u32;
        self.positions.extend(other.positions);
        self.normals.extend(other.normals);
        self.triangles
            .extend(other.triangles.iter().map(|t| t.map(|v| v + start)));
        self.materials.extend(other.materials);
    }

    /// Centre and radius of a sphere around all vertices.
    #[must_use]
    pub fn bounding_sphere(&self) -> (Vec3, f32) {
        let low = self.positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let high = self.positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        let centre = 0.5 * (low + high);
        (
            centre,
            self.positions.iter().map(|p| p.distance(centre)).fold(0.0, f32::max),
        )
    }

    /// Six times the enclosed volume divided by six: positive when faces look outwards.
    #[must_use]
    pub fn volume(&self) -> f64 {
        let corner = |v: u32| self.positions[v as usize].as_dvec3();
        let term = |t: &[u32; 3]| corner(t[0]).dot(corner(t[1]).cross(corner(t[2])));
        self.triangles.iter().map(term).sum::<f64>() / 6.0
    }
}

/// The part of every vertex: the smallest vertex that it hangs together with.
pub(crate) fn connected(vertices: usize, triangles: &[[u32; 3]]) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..vertices).collect();
    fn root(parent: &mut [usize], mut v: usize) -> usize {
        while parent[v] != v {
            parent[v] = parent[parent[v]];
            v = parent[v];
        }
        v
    }
    for triangle in triangles {
        let roots = triangle.map(|v| root(&mut parent, v as usize));
        let least = roots[0].min(roots[1]).min(roots[2]);
        roots.iter().for_each(|&other| parent[other] = least);
    }
    (0..vertices).map(|v| root(&mut parent, v)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Every edge of a closed surface is walked as often in one direction as in the other.
    pub(crate) fn is_closed(mesh: &TriMesh) -> bool {
        let key = |v: u32| {
            mesh.positions[v as usize]
                .to_array()
                .map(|x| (f64::from(x) * 1e7).round() as i64)
        };
        let mut balance: BTreeMap<_, i64> = BTreeMap::new();
        for t in &mesh.triangles {
            for k in 0..3 {
                let (a, b) = (key(t[k]), key(t[(k + 1) % 3]));
                let (edge, sign) = if a < b { ((a, b), 1) } else { ((b, a), -1) };
                *balance.entry(edge).or_default() += sign;
            }
        }
        balance.values().all(|&count| count == 0)
    }

    #[test]
    fn solids_are_closed_and_face_outwards() {
        let sphere = TriMesh::ellipsoid([0.1, 0.2, 0.3], 24);
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.1 * 0.2 * 0.3;
        assert!(
            (sphere.volume() / exact - 1.0).abs() < 0.05,
            "{}",
            sphere.volume() / exact
        );
        let solids = [
            sphere,
            TriMesh::cuboid([0.1, 0.2, 0.3]),
            TriMesh::chamfered([0.1, 0.2, 0.3], 0.02),
            TriMesh::cylinder(0.1, 0.2, 16),
            TriMesh::prism(0.1, 0.1, 3),
            TriMesh::handle(0.03, 0.005, -0.25, 0.25, 10),
            TriMesh::loft(
                &[
                    Section::circle(0.0, 0.05),
                    Section::oval(0.1, [0.02, 0.0], [0.04, 0.02], 4.0),
                ],
                16,
            ),
            TriMesh::lathe(&[[0.0, 0.0], [0.05, 0.0], [0.0, 0.1]], 12),
        ];
        for (index, solid) in solids.iter().enumerate() {
            assert!(is_closed(solid), "solid {index} has an open edge");
            assert!(solid.volume() > 0.0, "solid {index} is inside out");
        }
    }

    #[test]
    fn rims_stay_sharp_and_barrels_smooth() {
        let cylinder = TriMesh::lathe(&[[0.1, 0.0], [0.1, 0.2]], 24);
        let upright = cylinder.normals.iter().filter(|n| n.z.abs() > 0.99).count();
        let radial = cylinder.normals.iter().filter(|n| n.z.abs() < 0.01).count();
        assert_eq!(upright + radial, cylinder.normals.len());
        assert_eq!(radial, 48);
    }
}
