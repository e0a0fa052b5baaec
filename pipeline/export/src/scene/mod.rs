//! Scenes of the viewer in the browser: the Gaussians of a field over time in a small file (`docs/spec/scene.md`).
//!
//! Attributes are stored once, in steps that cannot be seen; every stored time adds how far each Gaussian has moved since
//! the first one, and the attributes of those that look different at that time. [`SceneWriter`] makes a file,
//! [`Scene::parse`] reads one back. Metres, reconstruction frame.

mod looks;
mod planes;
mod quantised;
mod read;
mod write;

use serde::{Deserialize, Serialize};

pub use quantised::{COLOUR_STEP, POSITION_STEP_M, ROTATION_STEP, SCALE_STEP, SMALLEST_SCALE_M};
pub use read::{Scene, ScenePlane};
pub use write::{Moment, Moments, SceneWriter};

/// First bytes of a scene file.
pub const SCENE_MAGIC: [u8; 8] = *b"ROGS4D\x1a\n";
/// Version of the form.
pub const SCENE_VERSION: u32 = 1;
/// Step of the vertices of meshes, metres.
pub const MESH_STEP_M: f32 = 0.000_1;
/// Most stored times of a scene.
pub const MOST_TIMES: usize = 4096;

/// What a scene is, in words and numbers, all but its arrays.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneHead {
    /// What it is called; shown as text.
    pub title: String,
    /// What made it, e.g. `Stage 1`.
    pub name: String,
    /// Normalised times of the planes, ascending. `[T]`
    pub times: Vec<f64>,
    /// Seconds from time 0 to time 1.
    pub seconds: f64,
    /// Where the robot's base stands, 4x4 row-major, metres.
    pub recon_from_base: Matrix,
    /// Cameras of the clip.
    pub cameras: Vec<SceneCamera>,
    /// Names of the robot's links; the link ids of Gaussians and meshes are indices into it.
    pub links: Vec<String>,
    /// Pose of every link at every time, 4x4 row-major, metres; empty without robot. `[T, L]`
    pub recon_from_link: Vec<Vec<Matrix>>,
}

/// A 4x4 matrix, row-major.
pub type Matrix = [f64; 16];

/// A camera of the clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneCamera {
    /// Its name.
    pub id: String,
    /// Whether reconstruction did not see it.
    pub held_out: bool,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal lengths and principal point, pixels, centres at + 0.5.
    pub fx: f64,
    /// Vertical focal length.
    pub fy: f64,
    /// Horizontal principal point.
    pub cx: f64,
    /// Vertical principal point.
    pub cy: f64,
    /// Its pose at every time, OpenCV axes, 4x4 row-major, metres. `[T]`
    pub recon_from_camera: Vec<Matrix>,
}

/// The mesh of a link, in its frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LinkMesh {
    /// Index into the links of the head.
    pub link: usize,
    /// Vertices, metres.
    pub positions: Vec<[f32; 3]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// What a camera recorded at a time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScenePicture {
    /// Index into the cameras of the head.
    pub camera: usize,
    /// Index into the times of the head.
    pub time: usize,
    /// A JPEG file.
    pub jpeg: Vec<u8>,
}

/// Where an array lies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Section {
    /// What it is, e.g. `moved/3`.
    name: String,
    /// From the end of the header, bytes.
    offset: u64,
    /// Stored length, bytes.
    bytes: u64,
    /// Rows of integers; 0 for pictures.
    rows: u32,
    /// Bytes that each channel takes; empty for pictures, which are stored as they are.
    widths: Vec<u8>,
}

/// The header of the file.
#[derive(Debug, Serialize, Deserialize)]
struct Header {
    head: SceneHead,
    /// Number of Gaussians.
    gaussians: u32,
    /// Degree of the harmonics.
    degree: u32,
    sections: Vec<Section>,
}
