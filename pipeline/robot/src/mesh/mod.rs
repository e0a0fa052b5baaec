//! Triangle meshes and their files.
//!
//! Every reader bounds what it allocates by the size of the file, refuses indices out of range and coordinates that are
//! not finite, and reads no other file than those in the robot's folder.

mod axes;
mod dae;
mod gltf_file;
mod obj;
mod primitive;
mod size;
mod stl;

use std::path::Path;

use glam::DVec3;
use rogs_schemas::records::robot::MeshAxes;

pub use size::Sizes;

use crate::error::{Error, Result};
use crate::model::{Geometry, RobotFolder, Shape, read_capped};

/// Largest mesh file that is read, bytes.
pub const MAX_FILE_BYTES: u64 = 256 << 20;
/// Most triangles of one mesh.
pub const MAX_TRIANGLES: usize = 8 << 20;

/// A triangle mesh, metres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// A mesh file that was read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MeshFile {
    /// Its triangles.
    pub mesh: Mesh,
    /// What it says that was left aside, for people.
    pub notes: Vec<String>,
}

/// Message of a reader; the caller knows the path.
type Parsed<T> = std::result::Result<T, String>;

impl Mesh {
    /// The mesh of a shape of a robot, in the frame of its link.
    ///
    /// # Errors
    /// When a mesh file is missing, outside the robot's folder, damaged or of an unknown kind.
    pub fn of_shape(shape: &Shape, folder: &RobotFolder, axes: MeshAxes) -> Result<MeshFile> {
        let plain = |mesh| MeshFile {
            mesh,
            notes: Vec::new(),
        };
        let (mut file, scale) = match &shape.geometry {
            Geometry::Box { size } => (plain(primitive::cuboid(*size)), [1.0; 3]),
            Geometry::Cylinder { radius, length } => (plain(primitive::cylinder(*radius, *length)), [1.0; 3]),
            Geometry::Capsule { radius, length } => (plain(primitive::capsule(*radius, *length)), [1.0; 3]),
            Geometry::Sphere { radius } => (plain(primitive::sphere(*radius)), [1.0; 3]),
            Geometry::Mesh { reference, scale } => (Self::load(&folder.resolve(reference)?, folder, axes)?, *scale),
        };
        for position in &mut file.mesh.positions {
            let scaled = DVec3::from_array(position.map(f64::from)) * DVec3::from_array(scale);
            *position = shape.link_from_shape.point(scaled).as_vec3().to_array();
        }
        if let (Err(what), Geometry::Mesh { reference, .. }) = (file.mesh.check(), &shape.geometry) {
            return Err(Error::Mesh {
                path: reference.into(),
                what,
            });
        }
        file.mesh.weld();
        Ok(file)
    }

    /// Reads a mesh file by the ending of its name: `.stl` (binary or text), `.dae`, `.obj`, `.gltf`, `.glb`.
    ///
    /// Units and axes: STL, OBJ and glTF numbers are metres, COLLADA says its unit. The axes are those of the link after
    /// the transforms of the file's nodes, or with `MeshAxes::Standard` what the formats' standards call up becomes z.
    ///
    /// # Errors
    /// When the file cannot be read, is larger than [`MAX_FILE_BYTES`], is damaged or has an unknown ending.
    pub fn load(path: &Path, folder: &RobotFolder, axes: MeshAxes) -> Result<MeshFile> {
        let ending = path
            .extension()
            .map(|ending| ending.to_string_lossy().to_lowercase())
            .unwrap_or_default();
        let refuse = |what: String| Error::Mesh {
            path: path.to_owned(),
            what,
        };
        if !matches!(ending.as_str(), "stl" | "dae" | "obj" | "gltf" | "glb") {
            return Err(refuse(format!(
                "files ending in `.{ending}` are not read; convert it to one of stl, dae, obj, gltf, glb"
            )));
        }
        let bytes = read_capped(path, MAX_FILE_BYTES)?;
        let external = |reference: &str| {
            let file = folder
                .resolve_beside(path, reference)
                .map_err(|error| error.to_string())?;
            read_capped(&file, MAX_FILE_BYTES).map_err(|error| error.chain())
        };
        Self::parse(&ending, &bytes, axes, &external).map_err(refuse)
    }

    /// Reads the bytes of a mesh file whose name ends in `ending` (lower case); `external` reads the files it refers to.
    ///
    /// # Errors
    /// A message that says what is wrong.
    pub fn parse(
        ending: &str,
        bytes: &[u8],
        axes: MeshAxes,
        external: &dyn Fn(&str) -> Parsed<Vec<u8>>,
    ) -> Parsed<MeshFile> {
        let plain = |mesh| MeshFile {
            mesh,
            notes: Vec::new(),
        };
        let mut file = match ending {
            "stl" => plain(stl::parse(bytes)?),
            "obj" => plain(obj::parse(bytes)?),
            "dae" => dae::parse(bytes, axes)?,
            _ => plain(gltf_file::parse(bytes, axes, external)?),
        };
        file.mesh.check()?;
        if file.mesh.triangles.is_empty() {
            return Err("it has no triangles".into());
        }
        file.mesh.weld();
        Ok(file)
    }

    /// Merges vertices with equal coordinates and drops unused ones. Order of triangles and their corners is kept, so
    /// that neighbouring triangles share vertices and are rasterised without cracks.
    pub fn weld(&mut self) {
        // -0.0 and 0.0 are the same place.
        let key = |position: &[f32; 3]| position.map(|value| (value + 0.0).to_bits());
        let mut used = vec![false; self.positions.len()];
        for corner in self.triangles.iter().flatten() {
            used[*corner as usize] = true;
        }
        let mut order: Vec<u32> = (0..self.positions.len() as u32)
            .filter(|&vertex| used[vertex as usize])
            .collect();
        order.sort_unstable_by_key(|&vertex| (key(&self.positions[vertex as usize]), vertex));
        // The first vertex of each group of equal ones stands for all of them.
        let mut representative = vec![u32::MAX; self.positions.len()];
        let mut group = None;
        for &vertex in &order {
            let place = key(&self.positions[vertex as usize]);
            match group {
                Some((previous, first)) if previous == place => representative[vertex as usize] = first,
                _ => {
                    group = Some((place, vertex));
                    representative[vertex as usize] = vertex;
                }
            }
        }
        let mut new_index = vec![u32::MAX; self.positions.len()];
        let mut positions = Vec::with_capacity(self.positions.len());
        for triangle in &mut self.triangles {
            for corner in triangle {
                let vertex = representative[*corner as usize] as usize;
                if new_index[vertex] == u32::MAX {
                    new_index[vertex] = positions.len() as u32;
                    positions.push(self.positions[vertex]);
                }
                *corner = new_index[vertex];
            }
        }
        self.positions = positions;
    }

    /// Appends another mesh.
    pub fn append(&mut self, other: &Self) {
        let start = self.positions.len() as u32;
        self.positions.extend_from_slice(&other.positions);
        self.triangles.extend(
            other
                .triangles
                .iter()
                .map(|triangle| triangle.map(|corner| corner + start)),
        );
    }

    fn check(&self) -> Parsed<()> {
        if self.triangles.len() > MAX_TRIANGLES || self.positions.len() > 3 * MAX_TRIANGLES {
            return Err(format!(
                "it has {} triangles, at most {MAX_TRIANGLES} are read",
                self.triangles.len()
            ));
        }
        if let Some(index) = self
            .positions
            .iter()
            .position(|p| !p.iter().all(|value| value.is_finite() && value.abs() < 1e6))
        {
            return Err(format!(
                "vertex {index} has the invalid position {:?}",
                self.positions[index]
            ));
        }
        let count = self.positions.len();
        let out_of_range = |triangle: &[u32; 3]| triangle.iter().any(|&corner| corner as usize >= count);
        if let Some(index) = self.triangles.iter().position(out_of_range) {
            return Err(format!(
                "triangle {index} refers to vertex {:?} of {count}",
                self.triangles[index]
            ));
        }
        Ok(())
    }
}

/// Splits a polygon into triangles around its first corner.
fn fan(polygon: &[u32], triangles: &mut Vec<[u32; 3]>) {
    for pair in polygon.windows(2).skip(1) {
        triangles.push([polygon[0], pair[0], pair[1]]);
    }
}

/// Splits a strip into triangles that turn the same way.
fn strip(corners: &[u32], triangles: &mut Vec<[u32; 3]>) {
    for (index, window) in corners.windows(3).enumerate() {
        triangles.push(match index % 2 {
            0 => [window[0], window[1], window[2]],
            _ => [window[1], window[0], window[2]],
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn welding_keeps_the_surface() {
        let mut mesh = Mesh {
            positions: vec![
                [0.0; 3],
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [-0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [9.0; 3],
                [0.0, 0.0, 1.0],
            ],
            triangles: vec![[0, 1, 2], [3, 4, 6]],
        };
        let corners = |mesh: &Mesh| -> Vec<[[f32; 3]; 3]> {
            mesh.triangles
                .iter()
                .map(|triangle| triangle.map(|corner| mesh.positions[corner as usize]))
                .collect()
        };
        let before = corners(&mesh);
        mesh.weld();
        assert_eq!(corners(&mesh), before);
        assert_eq!(mesh.positions.len(), 4);
        assert_eq!(mesh.triangles[1][0], mesh.triangles[0][0]);
    }

    #[test]
    fn wrong_indices_and_positions_are_refused() {
        let good = Mesh {
            positions: vec![[0.0; 3]; 3],
            triangles: vec![[0, 1, 2]],
        };
        assert!(good.check().is_ok());
        assert!(
            Mesh {
                triangles: vec![[0, 1, 3]],
                ..good.clone()
            }
            .check()
            .unwrap_err()
            .contains("triangle 0")
        );
        assert!(
            Mesh {
                positions: vec![[f32::NAN; 3]; 3],
                ..good
            }
            .check()
            .unwrap_err()
            .contains("vertex 0")
        );
    }
}
