//! What the rasteriser of a view tells the shader.

use glam::DVec3;

/// A triangle that may be seen: its plane in the camera's frame and where it comes from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    /// n and n.a: points of the plane have n.p = d.
    pub normal: DVec3,
    pub distance: f64,
    pub body: u16,
    pub face: u32,
    /// Body and smooth surface: samples of one surface are shaded once.
    pub surface: u32,
}
