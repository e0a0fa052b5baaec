//! Robots: their description files, kinematics, meshes and the mesh rasteriser.
//!
//! A robot is read with [`RobotModel::load`], which trusts nothing in the file and never leaves the robot's folder; forward
//! kinematics of one state is [`RobotModel::fk`], of a cohort of states [`batch::BatchFk`]. [`MeshScene`] collects the meshes
//! that the anchor consists of and [`MeshScene::render`] draws depth (camera z), link id and triangle id, sampled at pixel
//! centres.
//!
//! Lengths are metres, angles radians, images row-major with pixel centres at `+ 0.5`. Poses and cameras are those of
//! `rogs-geometry`.

pub mod batch;
pub mod error;
pub mod fk_json;
pub mod limits;
pub mod mesh;
pub mod model;
pub mod names;
pub mod outline;
pub mod raster;

pub use error::{Error, Result};
pub use mesh::{Mesh, MeshFile};
pub use model::{JointState, RobotModel};
pub use raster::{MeshImage, MeshScene, RenderOptions};
