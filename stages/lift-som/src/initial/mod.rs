//! What the optimisation of a camera begins with (`docs/spec/baseline-som.md` section 4).

mod background;
mod foreground;

use rogs_random::Pcg64;
use rogs_worker::StageResult;

use crate::observed::Observed;
use crate::params::LiftSomParams;
use crate::scene::{Cloud, Scene, logit};

pub(crate) use foreground::Followed;

/// Opacity of every Gaussian.
const OPACITY: f64 = 0.7;
/// Neighbours that give a Gaussian its size.
const NEIGHBOURS: usize = 3;
/// Points that coincide, as exact tracks of what stands still do, are taken to be this far apart, metres.
const LEAST_M: f64 = 1e-3;
/// Sizes are kept between these quantiles of all.
const SIZES: [f64; 2] = [0.05, 0.95];

/// Draws of one purpose.
pub(crate) fn draw(params: &LiftSomParams, purpose: &[u64]) -> Pcg64 {
    let seeds: Vec<u64> = std::iter::once(params.seed).chain(purpose.iter().copied()).collect();
    Pcg64::from_seeds(&seeds)
}

/// Purposes of draws.
pub(crate) mod purpose {
    pub(crate) const TRACKS: u64 = 1;
    pub(crate) const ROTATIONS: u64 = 2;
    pub(crate) const BACKGROUND: u64 = 3;
    pub(crate) const BATCH: u64 = 4;
}

/// Points with colours become Gaussians of one opacity, as large as their neighbours are far.
fn cloud(points: &[glam::DVec3], colours: &[[f32; 3]], quats: Vec<f32>) -> Cloud {
    let distances = rogs_optimise::neighbours::mean_distances(points, NEIGHBOURS);
    let logs: Vec<f64> = distances
        .iter()
        .map(|&distance| libm::log(distance.max(LEAST_M)))
        .collect();
    let limit = |share: f64| rogs_optimise::statistics::quantile(&logs, share).unwrap_or(0.0);
    let [least, most] = SIZES.map(limit);
    Cloud {
        means: points.iter().flat_map(|point| point.as_vec3().to_array()).collect(),
        quats,
        scales: logs.iter().flat_map(|log| [log.clamp(least, most) as f32; 3]).collect(),
        opacities: vec![logit(OPACITY); points.len()],
        colours: colours.iter().flatten().map(|&value| logit(f64::from(value))).collect(),
    }
}

/// The scene before the first update, and the tracks that its motion is fitted to. `camera` numbers the draws.
///
/// # Errors
/// When no track is left, no cluster of tracks is large enough, or there is no background; with the camera's name.
pub(crate) fn scene(observed: &Observed, params: &LiftSomParams, camera: u64) -> StageResult<(Scene, Followed)> {
    let followed = Followed::of(observed, params, camera)?;
    let (coefficients, bases) = followed.motion(observed, params)?;
    let background = background::background(observed, params, camera)?;
    let scene = Scene {
        foreground: followed.cloud(params, camera),
        coefficients,
        background,
        bases,
    };
    Ok((scene, followed))
}
