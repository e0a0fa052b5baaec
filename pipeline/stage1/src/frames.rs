//! The source frames of a clip, as every part of the network takes them.

use burn::tensor::Tensor;
use rogs_geometry::{Base, Pose, Recon};
use rogs_tensors::parameters::from_host;

use super::config::{RGB_MEAN, RGB_STD};
use super::geometry::NetworkCamera;

/// Which tokens a token of a global block sees.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Attention {
    /// All tokens of the clip.
    Joint,
    /// Those of frames of its own camera (the cross-camera ablation); one camera index per frame. `[S]`
    WithinCamera(Vec<u32>),
}

/// The source frames of one clip in token order: camera-major, wrist first, times ascending.
pub struct SourceFrames {
    /// RGB in [0, 1]. `[S, 3, H, W]`
    pub images: Tensor<4>,
    /// Camera of each frame. `[S]`
    pub cameras: Vec<NetworkCamera>,
    /// Where the base of the robot stands, internal units. Only a plane sweep reads it.
    pub recon_from_base_iu: Pose<Recon, Base>,
    /// Normalised time of each frame. `[S]`
    pub times: Vec<f32>,
    /// What global blocks see.
    pub attention: Attention,
}

/// RGB in [0, 1] less the mean, divided by the standard deviation of each colour. `[S, 3, H, W]`
pub(crate) fn normalised(images: Tensor<4>) -> Tensor<4> {
    let device = images.device();
    let channel = |values: [f32; 3]| from_host::<4>(values.to_vec(), [1, 3, 1, 1], &device);
    (images - channel(RGB_MEAN)) / channel(RGB_STD)
}
