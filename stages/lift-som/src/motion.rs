//! The foreground at some frames, and gradients through its motion.

use rayon::prelude::*;
use rogs_optimise::bases::{move_gaussians, move_gradient};
use rogs_optimise::{MotionGradient, Moved};
use rogs_worker::StageResult;

use crate::internal;
use crate::scene::{Scene, add};

/// Gradient of a loss with respect to the foreground at a frame.
pub(crate) struct At {
    pub(crate) frame: usize,
    /// `[G, 3]`
    pub(crate) means: Vec<f32>,
    /// `[G, 4]`
    pub(crate) quats: Vec<f32>,
}

/// The foreground at these frames, in their order.
pub(crate) fn moved(scene: &Scene, shares: &[f32], frames: &[usize]) -> StageResult<Vec<Moved>> {
    let fg = &scene.foreground;
    (frames.par_iter())
        .map(|&frame| {
            let bases = scene.bases.at(frame).map_err(internal)?;
            move_gaussians(&bases, shares, &fg.means, &fg.quats).map_err(internal)
        })
        .collect()
}

/// Carries gradients at frames to canonical centres and rotations, logits and bases; `moved` has the foreground at the same
/// frames.
pub(crate) fn add_gradient(
    scene: &Scene,
    shares: &[f32],
    moved: &[Moved],
    at: &[At],
    to: &mut Scene,
) -> StageResult<()> {
    let fg = &scene.foreground;
    let gradients: Vec<MotionGradient> = (at.par_iter().zip(moved))
        .map(|(at, moved)| {
            let bases = scene.bases.at(at.frame).map_err(internal)?;
            move_gradient(&bases, shares, &fg.means, &fg.quats, moved, &at.means, &at.quats).map_err(internal)
        })
        .collect::<StageResult<_>>()?;
    let frames = scene.bases.frames;
    for (at, gradient) in at.iter().zip(&gradients) {
        add(&mut to.foreground.means, 1.0, &gradient.means);
        add(&mut to.foreground.quats, 1.0, &gradient.quats);
        add(&mut to.coefficients, 1.0, &gradient.logits);
        for (base, own) in gradient.bases.iter().enumerate() {
            let row = base * frames + at.frame;
            for k in 0..6 {
                to.bases.rotations[6 * row + k] += own[k] as f32;
            }
            for k in 0..3 {
                to.bases.translations[3 * row + k] += own[6 + k] as f32;
            }
        }
    }
    Ok(())
}
