//! Many views of one scene: rendered with tapes, and differentiated into one set of gradients.

use crate::backward::{Gradients, RenderGradient, Tape, render_with_tape, run};
use crate::camera::{Camera, RasterConfig};
use crate::error::{Result, SplatError};
use crate::gaussians::Gaussians;
use crate::render::Render;

/// Gradient of a loss with respect to the pose of one camera (`p_camera = R p_world + t`).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseGradient {
    /// With respect to the nine numbers of R, row-major, as if they were free.
    pub rotation: [f64; 9],
    /// With respect to t.
    pub translation: [f64; 3],
}

/// Renders several views of one scene and keeps what [`backward_views`] needs of each, in the order of the cameras.
///
/// # Errors
/// As [`crate::render()`]; the first view with an error.
pub fn render_views_with_tape(
    gaussians: &Gaussians,
    cameras: &[Camera],
    config: &RasterConfig,
) -> Result<(Vec<Render>, Vec<Tape>)> {
    cameras
        .iter()
        .map(|camera| render_with_tape(gaussians, camera, config))
        .collect::<Result<Vec<_>>>()
        .map(|views| views.into_iter().unzip())
}

/// Gradients of a loss on several views: summed over the views in their order, the poses' each for itself (their sum is in
/// the camera fields of [`Gradients`]). `gaussians` and `config` must be those of the forward pass.
///
/// # Errors
/// When there is not one gradient image per view, and as [`crate::backward()`].
pub fn backward_views(
    gaussians: &Gaussians,
    config: &RasterConfig,
    tapes: &[Tape],
    gradients: &[RenderGradient<'_>],
) -> Result<(Gradients, Vec<PoseGradient>)> {
    SplatError::check("gradient images", gradients.len(), tapes.len(), "one per view")?;
    let mut sum = Gradients::zeros(gaussians);
    let mut poses = Vec::with_capacity(tapes.len());
    let (mut rotation, mut translation) = ([0.0; 9], [0.0; 3]);
    for (index, (tape, gradient)) in tapes.iter().zip(gradients).enumerate() {
        (sum.camera_rotation, sum.camera_translation) = ([0.0; 9], [0.0; 3]);
        run(gaussians, config, tape, gradient, index == 0, &mut sum)?;
        poses.push(PoseGradient {
            rotation: sum.camera_rotation,
            translation: sum.camera_translation,
        });
        for (sum, part) in rotation.iter_mut().zip(sum.camera_rotation) {
            *sum += part;
        }
        for (sum, part) in translation.iter_mut().zip(sum.camera_translation) {
            *sum += part;
        }
    }
    (sum.camera_rotation, sum.camera_translation) = (rotation, translation);
    Ok((sum, poses))
}
