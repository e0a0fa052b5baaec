//! What the readers of plain and of compressed PLY give.

use rogs_splat::Gaussians;

/// What a PLY file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct PlyScene {
    /// The Gaussians, in the unit and frame of the file (metres and the reconstruction frame for our own files).
    pub gaussians: Gaussians,
    /// Comment lines of the header.
    pub comments: Vec<String>,
}
