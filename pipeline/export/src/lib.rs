//! Files of other programs, written and read; what they hold and where they differ from ours is in `docs/exports.md`.
//!
//! | module | what |
//! |---|---|
//! | [`nerfstudio`] | camera paths of its viewer, read |
//! | [`spz`] | SPZ: Gaussians at a time |
//! | [`fourdgs`] | `.4dgs`: Gaussians over time |
//! | [`gltf`] | glTF: Gaussians, links and cameras over time |
//! | [`dataset`] | images, poses, masks, depth and points of a clip for nerfstudio and COLMAP |
//! | [`splats`] | frames whose y points up; which Gaussians can be written |
//! | [`scene`] | the Gaussians of a field over time, for the viewer in the browser (`docs/spec/scene.md`) |

pub mod dataset;
mod error;
pub mod fourdgs;
pub mod gltf;
pub mod nerfstudio;
pub mod scene;
pub mod splats;
pub mod spz;

pub use error::{Error, Result};
pub use fourdgs::FourDgs;
pub use gltf::{Gltf, LinkMesh};
pub use spz::spz_bytes;
