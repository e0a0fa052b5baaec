//! Where things stand and how cameras see them: poses, similarities and pinhole cameras.
//!
//! Poses are named and typed `a_from_b` ([`Pose`]); a composition that does not chain does not compile. A [`PosedCamera`]
//! is a [`Pinhole`] and its pose: the rasteriser and the networks each make their own form of it, and nobody writes one by
//! hand. Rotations are `f64` matrices; what other representations the files and networks need is beside them.
//!
//! Lengths are metres unless a name or a [`LengthUnit`](rogs_schemas::units::LengthUnit) says otherwise, angles radians,
//! camera axes those of OpenCV (x right, y down, z forward), pixel centres at `+ 0.5`.
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

mod actions;
mod camera_path;
mod error;
mod links;
mod pinhole;
mod pose;
mod posed;
mod rotation;
mod scale;
mod similarity;

pub use actions::{Action, actions, follow, tool_pose};
pub use camera_path::CameraPath;
pub use error::{Error, Result};
pub use links::{LinkMotions, LinkPoses};
pub use pinhole::{Pinhole, pixel_centre};
pub use pose::{Base, Camera, Frame, Link, Pose, RIGIDITY_TOLERANCE, Recon};
pub use posed::PosedCamera;
pub use rotation::{
    euler_xyz_from_rotation, largest_component_quaternion, non_negative, quaternion, quaternion_product,
    rotation_about_axis, rotation_from_euler_xyz, wxyz_f32,
};
pub use scale::{UnitFactor, unit_factor};
pub use similarity::Similarity;
