//! Weights of losses.

use rogs_train::config::LossWeights;

/// No loss at all.
pub(crate) const NONE: LossWeights = LossWeights {
    movies_mse: 0.0,
    movies_lpips: 0.0,
    depth_head: 0.0,
    stereo: 0.0,
    stereo_robot: 0.0,
    sweep: 0.0,
    sweep_depth: 0.0,
    track_head: 0.0,
    track_final: 0.0,
    held: 0.0,
    fk_head: 0.0,
    fk_final: 0.0,
    metric_final: 0.0,
    metric_right: 0.0,
    metric_share: 0.0,
    metric_robot: 0.0,
    coverage: 0.0,
    coverage_right: 0.0,
};
