//! The mesh rasteriser: depth, link id and triangle id of an articulated robot, sampled at pixel centres.
//!
//! Vertices are projected in f64 and rounded to 2^-16 of a pixel; coverage is then decided by exact integer edge functions
//! with the top-left rule, so that meshes have no cracks and no pixel is drawn twice along an edge. Depth is linear camera
//! z, perspective-correct (1/z is linear in the image). The nearest surface wins, and of equal depths the lower triangle
//! number, so the result does not depend on drawing order or thread count. Back faces are drawn: robot meshes are often
//! open.

mod clip;
mod draw;
mod project;

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use rogs_geometry::{Camera, Link, Pinhole, Pose};
use rogs_schemas::records::robot::{NO_LINK, RobotSpec};

use crate::error::{Error, Result};
use crate::mesh::{Mesh, Sizes};
use crate::model::{Geometry, RobotModel};
use crate::names;

use draw::EMPTY;
use project::ScreenVertices;

/// Largest image side, pixels.
pub const MAX_SIDE: u32 = 4096;
/// Value of [`MeshImage::triangle`] where nothing is hit.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// Triangles that a thread takes at a time.
const BATCH: usize = 2048;
/// Pixels that a thread resolves at a time.
const RESOLVE_CHUNK: usize = 16_384;

/// The meshes of a robot, each in the frame of its link.
#[derive(Debug, Clone, Default)]
pub struct MeshScene {
    /// What the mesh files say that was left aside, and sizes that do not fit the robot, one line each.
    pub notes: Vec<String>,
    parts: Vec<Part>,
    // Positions of all parts, one array per axis. [V]
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    // Indices into the arrays above. [T, 3]
    triangles: Vec<[u32; 3]>,
    // Link id of each triangle. [T]
    triangle_link: Vec<u8>,
}

/// A run of vertices and triangles that move with one link.
#[derive(Debug, Clone)]
struct Part {
    link: u8,
    vertices: std::ops::Range<usize>,
}

/// How to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RenderOptions {
    /// Surfaces nearer than this camera z are cut away, metres.
    pub near_m: f64,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { near_m: 0.01 }
    }
}

/// What a camera sees of the meshes. Row-major, `[H, W]`.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshImage {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Camera z at the pixel centre, metres; 0 where nothing is hit.
    pub depth_m: Vec<f32>,
    /// Link id; `NO_LINK` where nothing is hit.
    pub link: Vec<u8>,
    /// Triangle number in the scene; [`NO_TRIANGLE`] where nothing is hit.
    pub triangle: Vec<u32>,
}

impl MeshScene {
    /// An empty scene.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The anchor meshes of a robot: all links but the excluded ones; collision geometry where the specification says
    /// so, visual geometry elsewhere. Triangles are numbered in link order. Meshes whose size does not fit the robot are
    /// noted.
    ///
    /// # Errors
    /// When a mesh cannot be read, or when nothing is selected.
    pub fn of_robot(model: &RobotModel, spec: &RobotSpec) -> Result<Self> {
        let mut scene = Self::new();
        let mut sizes = Sizes::new(model);
        for (id, link) in model.links.iter().enumerate() {
            if names::matches_any(&spec.exclude_links, &link.name) {
                continue;
            }
            let collision = names::matches_any(&spec.collision_links, &link.name);
            let mut mesh = Mesh::default();
            for shape in if collision { &link.collision } else { &link.visual } {
                let file = Mesh::of_shape(shape, &model.folder, spec.mesh_axes)?;
                if let Geometry::Mesh { reference, .. } = &shape.geometry {
                    let notes = file.notes.iter().map(|note| format!("mesh `{reference}`: {note}"));
                    scene
                        .notes
                        .extend(notes.filter(|note| !scene.notes.contains(note)).collect::<Vec<_>>());
                    sizes.add(format!("mesh `{reference}`"), true, &file.mesh);
                } else {
                    sizes.add(format!("a shape of link `{}`", link.name), false, &file.mesh);
                }
                mesh.append(&file.mesh);
            }
            scene.add(id as u8, &mesh);
        }
        if scene.triangles.is_empty() {
            return Err(Error::Raster {
                what: format!("robot `{}`: no link has a mesh under the given selection", model.name),
            });
        }
        scene.notes.extend(sizes.note());
        Ok(scene)
    }

    /// Adds a mesh that moves with a link; its triangles get the next numbers.
    pub fn add(&mut self, link: u8, mesh: &Mesh) {
        if mesh.triangles.is_empty() {
            return;
        }
        let start = self.x.len();
        self.x.extend(mesh.positions.iter().map(|position| position[0]));
        self.y.extend(mesh.positions.iter().map(|position| position[1]));
        self.z.extend(mesh.positions.iter().map(|position| position[2]));
        self.triangles.extend(
            mesh.triangles
                .iter()
                .map(|triangle| triangle.map(|corner| corner + start as u32)),
        );
        self.triangle_link.resize(self.triangles.len(), link);
        self.parts.push(Part {
            link,
            vertices: start..self.x.len(),
        });
    }

    /// Number of triangles.
    #[must_use]
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// Number of vertices.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.x.len()
    }

    /// Link id and corners of a triangle, in the link's frame.
    ///
    /// # Panics
    /// When there is no such triangle.
    #[must_use]
    pub fn triangle(&self, index: usize) -> (u8, [[f32; 3]; 3]) {
        let corner = |vertex: u32| {
            [
                self.x[vertex as usize],
                self.y[vertex as usize],
                self.z[vertex as usize],
            ]
        };
        (self.triangle_link[index], self.triangles[index].map(corner))
    }

    /// Draws the scene with the threads of the current rayon pool. `camera_from_link` is indexed by link id.
    ///
    /// # Errors
    /// When the camera is not valid, an image side exceeds [`MAX_SIDE`], or a link has no pose.
    pub fn render(
        &self,
        camera: &Pinhole,
        camera_from_link: &[Pose<Camera, Link>],
        options: &RenderOptions,
    ) -> Result<MeshImage> {
        Renderer::new(self).render(camera, camera_from_link, options, rayon::current_num_threads())
    }
}

/// Draws one scene many times and keeps its buffers in between.
#[derive(Debug)]
pub struct Renderer<'a> {
    scene: &'a MeshScene,
    screen: ScreenVertices,
    layers: Vec<Vec<u64>>,
}

impl<'a> Renderer<'a> {
    /// A renderer for a scene.
    #[must_use]
    pub fn new(scene: &'a MeshScene) -> Self {
        Self {
            scene,
            screen: ScreenVertices::default(),
            layers: Vec::new(),
        }
    }

    /// Draws with `threads` pieces of work; the picture is the same for any number.
    ///
    /// # Errors
    /// As [`MeshScene::render`].
    pub fn render(
        &mut self,
        camera: &Pinhole,
        camera_from_link: &[Pose<Camera, Link>],
        options: &RenderOptions,
        threads: usize,
    ) -> Result<MeshImage> {
        let scene = self.scene;
        check(camera, options)?;
        let highest = scene.parts.iter().map(|part| part.link as usize).max().unwrap_or(0);
        if highest >= camera_from_link.len() {
            return Err(Error::Raster {
                what: format!("link {highest} has no pose, {} are given", camera_from_link.len()),
            });
        }
        let pieces = threads.clamp(1, 64);
        self.screen
            .project(scene, camera, camera_from_link, options, pieces > 1);
        let area = (camera.width * camera.height) as usize;
        self.layers.resize_with(pieces.max(self.layers.len()), Vec::new);
        let context = draw::Context {
            scene,
            screen: &self.screen,
            camera,
            camera_from_link,
            options,
        };
        // Pieces take the next batch when they are done with one; who draws what does not matter to the result.
        let next = AtomicUsize::new(0);
        let fill = |layer: &mut Vec<u64>| {
            layer.clear();
            layer.resize(area, EMPTY);
            loop {
                let first = next.fetch_add(BATCH, Ordering::Relaxed);
                if first >= scene.triangles.len() {
                    break;
                }
                context.draw(first..(first + BATCH).min(scene.triangles.len()), layer);
            }
        };
        let layers = &mut self.layers[..pieces];
        if pieces == 1 {
            fill(&mut layers[0]);
        } else {
            layers.par_iter_mut().for_each(fill);
        }
        Ok(resolve(scene, camera, layers))
    }
}

fn check(camera: &Pinhole, options: &RenderOptions) -> Result<()> {
    if !camera.is_valid() {
        return Err(Error::Raster {
            what: format!("the camera {camera:?} is not valid"),
        });
    }
    if camera.width > MAX_SIDE || camera.height > MAX_SIDE {
        return Err(Error::Raster {
            what: format!(
                "an image of {}x{} exceeds {MAX_SIDE} a side",
                camera.width, camera.height
            ),
        });
    }
    if !(options.near_m.is_finite() && options.near_m > 0.0) {
        return Err(Error::Raster {
            what: format!("the near plane lies at {} m", options.near_m),
        });
    }
    Ok(())
}

/// Takes the nearest surface of all layers and splits its key into depth, link and triangle.
fn resolve(scene: &MeshScene, camera: &Pinhole, layers: &[Vec<u64>]) -> MeshImage {
    let area = (camera.width * camera.height) as usize;
    let mut image = MeshImage {
        width: camera.width,
        height: camera.height,
        depth_m: vec![0.0; area],
        link: vec![NO_LINK; area],
        triangle: vec![NO_TRIANGLE; area],
    };
    let planes = Planes {
        first: 0,
        depth_m: &mut image.depth_m,
        link: &mut image.link,
        triangle: &mut image.triangle,
    };
    if layers.len() == 1 {
        planes.fill(scene, layers);
    } else {
        planes
            .split(RESOLVE_CHUNK)
            .into_par_iter()
            .for_each(|chunk| chunk.fill(scene, layers));
    }
    image
}

/// A run of pixels of an image.
struct Planes<'a> {
    first: usize,
    depth_m: &'a mut [f32],
    link: &'a mut [u8],
    triangle: &'a mut [u32],
}

impl<'a> Planes<'a> {
    fn split(self, size: usize) -> Vec<Planes<'a>> {
        let Self {
            depth_m,
            link,
            triangle,
            ..
        } = self;
        let chunks = depth_m
            .chunks_mut(size)
            .zip(link.chunks_mut(size))
            .zip(triangle.chunks_mut(size));
        let chunk = |(index, ((depth_m, link), triangle))| Planes {
            first: index * size,
            depth_m,
            link,
            triangle,
        };
        chunks.enumerate().map(chunk).collect()
    }

    fn fill(self, scene: &MeshScene, layers: &[Vec<u64>]) {
        for pixel in 0..self.depth_m.len() {
            let nearest = layers
                .iter()
                .map(|layer| layer[self.first + pixel])
                .min()
                .unwrap_or(EMPTY);
            if nearest != EMPTY {
                let number = nearest as u32;
                self.depth_m[pixel] = f32::from_bits((nearest >> 32) as u32);
                self.link[pixel] = scene.triangle_link[number as usize];
                self.triangle[pixel] = number;
            }
        }
    }
}
