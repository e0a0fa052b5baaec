//! The metrics of the paper's evaluation, each a plain function of arrays (`docs/spec/scoring.md` sections 4 to 8).
//!
//! Arithmetic is f64 throughout and every sum has a fixed order, so that a score is the same for any number of threads.

mod bootstrap;
mod depth;
mod image;
mod robot;
mod ssim;
mod stats;

pub use bootstrap::{BOOTSTRAP_RESAMPLES, BOOTSTRAP_SEED, Interval, bootstrap_interval, bootstrap_means};
pub use depth::{DepthScores, FAR_RANGE_M, depth_scores, depth_support, far_support, median_scale};
pub use image::{MetricError, PSNR_CEILING_DB, Pixels, RgbView, mse, psnr};
pub use robot::{DisplacementMap, MIN_BLEND_WEIGHT, TrackSample, robot_core, robot_depth_error, track_error_m};
pub use ssim::{SsimVariant, ssim};
pub use stats::{mean, median, pairwise_sum};
