//! Rigid transforms, cameras, kinematics, meshes and the mesh rasteriser.
//!
//! Poses are named and typed `a_from_b` ([`Pose`]); a composition that does not chain does not compile. A robot is read
//! with [`RobotModel::load`], which trusts nothing in the file and never leaves the robot's folder; forward kinematics of
//! one state is [`RobotModel::fk`], of a cohort of states [`batch::BatchFk`]. [`MeshScene`] collects the meshes that the
//! anchor consists of and [`MeshScene::render`] draws depth (camera z), link id and triangle id, sampled at pixel centres.
//!
//! Lengths are metres, angles radians, images row-major with pixel centres at `+ 0.5`.
//!
//! ```
//! use rogs_geometry::{Base, Camera, Link, Pose};
//!
//! let base_from_link: Pose<Base, Link> = Pose::from_xyz_euler([0.3, 0.0, 0.5], [0.0, 0.1, 0.0]);
//! let link_from_camera: Pose<Link, Camera> = Pose::from_xyz_euler([0.0, 0.05, 0.0], [0.0, 0.0, 1.5]);
//! let base_from_camera: Pose<Base, Camera> = base_from_link * link_from_camera;
//! let identity = base_from_camera * base_from_camera.inverse();
//! assert!(identity.translation.length() < 1e-15);
//! ```

pub mod batch;
pub mod camera;
pub mod error;
pub mod fk_json;
pub mod mesh;
pub mod names;
pub mod outline;
pub mod raster;
pub mod robot;
pub mod transform;

pub use camera::Pinhole;
pub use error::{Error, Result};
pub use mesh::Mesh;
pub use raster::{MeshImage, MeshScene, RenderOptions};
pub use robot::{JointState, RobotModel};
pub use transform::{Base, Camera, Frame, Link, Pose, Recon};
