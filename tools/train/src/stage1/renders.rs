//! Losses of rendered views and of composited motion, through [`rogs_tensors::render`].

use burn::tensor::{Bool, Tensor};
use rogs_schemas::units::m_from_iu;
use rogs_splat::{RasterCamera, RasterConfig};
use rogs_tensors::parameters::from_host;
use rogs_tensors::render::render_views;

use super::forward::{Lifted, LiftedQuery, attributes, gaussians};
use super::terms::{EPSILON, Losses, Sum};
use crate::config::LossWeights;
use crate::error::Result;
use crate::sample::{Query, Sample, Target};

/// Adds the rendered terms of one query, each times `share`.
///
/// # Errors
/// When the rasteriser or the device fails.
pub(super) fn add_terms(
    sum: &mut Sum,
    (sample, query): (&Sample, &Query),
    (lifted, outputs): (&Lifted, &LiftedQuery),
    losses: Losses<'_>,
    tracks: &[i32],
    share: f64,
) -> Result<()> {
    let weights = losses.weights;
    if weights.renders_views() {
        views(sum, (sample, query), (lifted, outputs), losses, share)?;
    }
    if weights.renders_motion() {
        motion(sum, (sample, query), (lifted, outputs), weights, tracks, share)?;
    }
    Ok(())
}

/// Colour, depth and coverage of the field at a query time, seen by all cameras.
fn views(
    sum: &mut Sum,
    (sample, query): (&Sample, &Query),
    (lifted, outputs): (&Lifted, &LiftedQuery),
    Losses { weights, perceptual }: Losses<'_>,
    share: f64,
) -> Result<()> {
    let device = lifted.depth.device();
    let [height, width] = sample.size;
    let cameras: Vec<RasterCamera> = query.targets.iter().map(|target| target.camera).collect();
    let field = gaussians(
        lifted.position.clone() + outputs.displacement.clone(),
        attributes(outputs.raw.clone(), sample),
        None,
    );
    let rendered = render_views(&field, &cameras, None, &RasterConfig::default())?;
    let colours = query.targets.iter().flat_map(|target| target.rgb.clone()).collect();
    let seen = from_host(colours, [cameras.len(), height, width, 3], &device);
    if weights.movies_mse > 0.0 {
        let error = (rendered.rgb.clone() - seen.clone()).powi_scalar(2).mean();
        sum.add("movies_mse", weights.movies_mse, share, error)?;
    }
    if let Some(network) = perceptual.filter(|_| weights.movies_lpips > 0.0) {
        let planar = |images: Tensor<4>| images.permute([0, 3, 1, 2]);
        let distance = network.distance(planar(rendered.rgb), planar(seen)).mean();
        sum.add("movies_lpips", weights.movies_lpips, share, distance)?;
    }
    let of_targets = |targets: &[Target], values: fn(&Target) -> &Vec<f32>| {
        let all = targets.iter().flat_map(|target| values(target).clone()).collect();
        from_host(all, [targets.len(), height * width], &device)
    };
    if weights.metric_share > 0.0 {
        let all = |values: fn(&Target) -> &Vec<f32>| of_targets(&query.targets, values);
        let flat = |values: Tensor<3>| values.reshape([query.targets.len(), height * width]);
        let hit = all(|target| &target.valid) * flat(rendered.alpha.clone()).greater_elem(0.0).float();
        let reference = all(|target| &target.depth_iu);
        let error = (flat(rendered.depth.clone()) - reference.clone()).abs() / (reference + EPSILON);
        sum.add(
            "metric_share",
            weights.metric_share,
            share,
            mean_of_views(error * hit.clone(), hit),
        )?;
    }
    // Source cameras come first, their right eyes after them.
    let sources = query.targets.iter().filter(|target| !target.right).count();
    let robot = if sample.anchored { weights.metric_robot } else { 0.0 };
    for (first, targets, metrics, coverage) in [
        (
            0,
            &query.targets[..sources],
            [("metric_final", weights.metric_final), ("metric_robot", robot)],
            ("coverage", weights.coverage),
        ),
        (
            sources,
            &query.targets[sources..],
            [("metric_right", weights.metric_right), ("metric_robot", 0.0)],
            ("coverage_right", weights.coverage_right),
        ),
    ] {
        if targets.is_empty() {
            continue;
        }
        let of_side = |values: &Tensor<3>| {
            let values = values.clone().narrow(0, first, targets.len());
            values.reshape([targets.len(), height * width])
        };
        let map = |values: fn(&Target) -> &Vec<f32>| of_targets(targets, values);
        let (alpha, valid) = (of_side(&rendered.alpha), map(|target| &target.valid));
        let [everywhere, robot] = metrics;
        if everywhere.1 > 0.0 || robot.1 > 0.0 {
            // Where there is a reference and something was hit.
            let hit = valid.clone() * alpha.clone().greater_elem(0.0).float();
            let millimetres = f64::from(m_from_iu(1.0)) * 1000.0;
            let error = (of_side(&rendered.depth) - map(|target| &target.depth_iu)).abs() * millimetres;
            if robot.1 > 0.0 {
                let supported = hit.clone() * map(|target| &target.support);
                sum.add(robot.0, robot.1, share, mean_of_views(error.clone(), supported))?;
            }
            if everywhere.1 > 0.0 {
                sum.add(everywhere.0, everywhere.1, share, mean_of_views(error, hit))?;
            }
        }
        if coverage.1 > 0.0 {
            sum.add(coverage.0, coverage.1, share, mean_of_views(alpha * -1.0 + 1.0, valid))?;
        }
    }
    Ok(())
}

/// Mean over views of the mean where it counts, `[V, A]`.
fn mean_of_views(error: Tensor<2>, counts: Tensor<2>) -> Tensor<1> {
    let sums = (error * counts.clone()).sum_dim(1);
    (sums / (counts.sum_dim(1) + EPSILON)).mean()
}

/// Displacement composited at the source times: the Gaussians of one source time, seen by its cameras.
fn motion(
    sum: &mut Sum,
    (sample, query): (&Sample, &Query),
    (lifted, outputs): (&Lifted, &LiftedQuery),
    weights: &LossWeights,
    tracks: &[i32],
    share: f64,
) -> Result<()> {
    let device = lifted.depth.device();
    let [height, width] = sample.size;
    let (area, count) = (height * width, sample.views.len());
    let mut tracked = vec![0.0f32; count * area];
    tracks.iter().for_each(|&pixel| tracked[pixel as usize] = 1.0);
    let tracked = from_host(tracked, [count, height, width, 1], &device);
    let robot = from_host(sample.support.clone(), [count, height, width, 1], &device);
    let reference = from_host(query.displacement_iu.clone(), [count, 3, height, width], &device);
    let reference = reference.permute([0, 2, 3, 1]);
    let base = attributes(outputs.base_raw.clone(), sample);
    let mut times: Vec<f32> = sample.views.iter().map(|&(_, time)| time).collect();
    times.sort_unstable_by(f32::total_cmp);
    times.dedup();
    let [mut of_tracks, mut of_robot]: [Tensor<1>; 2] = std::array::from_fn(|_| Tensor::zeros([1], &device));
    for time in times {
        let views: Vec<usize> = (0..count).filter(|&view| sample.views[view].1 == time).collect();
        let at_time =
            |map: &Tensor<4>| Tensor::cat(views.iter().map(|&view| map.clone().narrow(0, view, 1)).collect(), 0);
        let field = gaussians(
            at_time(&lifted.position),
            at_time(&base),
            Some(at_time(&outputs.displacement)),
        );
        let cameras: Vec<RasterCamera> = views.iter().map(|&view| sample.raster_cameras[view]).collect();
        let rendered = render_views(&field, &cameras, None, &RasterConfig::default())?;
        let Some(moved) = rendered.extra else { continue };
        let hit: Tensor<4, Bool> = rendered.alpha.greater_elem(0.0).unsqueeze_dim(3);
        let error = (moved - at_time(&reference)).abs() * hit.float();
        of_tracks = of_tracks + (error.clone() * at_time(&tracked)).sum();
        of_robot = of_robot + (error * at_time(&robot)).sum();
    }
    let supported = sample.support.iter().filter(|&&robot| robot > 0.0).count() as f64;
    let of_tracks = of_tracks / (3.0 * tracks.len() as f64 + EPSILON);
    let of_robot = of_robot / (3.0 * supported + EPSILON);
    sum.add("track_final", weights.track_final, share, of_tracks)?;
    sum.add("fk_final", weights.fk_final, share, of_robot)
}
