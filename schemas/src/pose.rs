//! Rigid transforms as they lie on disk.

use serde::{Deserialize, Serialize};

/// A rigid transform `a_from_b`: it maps points given in frame `b` to frame `a`, `p_a = R p_b + t`.
///
/// The frames are named by the field that holds the pose (`base_from_camera`, `recon_from_base`, ...). Lengths are
/// metres. `rogs_geometry::Pose` is the typed version with composition and inversion; this one only carries numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct RigidPose {
    /// Rotation matrix, row-major 3x3.
    pub rotation: [f64; 9],
    /// Translation in metres.
    pub translation: [f64; 3],
}

impl RigidPose {
    /// The identity transform.
    pub const IDENTITY: Self = Self {
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        translation: [0.0, 0.0, 0.0],
    };
}

/// Pinhole intrinsics in pixels of the stored image; pixel `(column, row)` has its centre at `(column + 0.5, row + 0.5)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Intrinsics {
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
}
