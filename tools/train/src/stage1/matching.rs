//! What the plane sweep of the stem should find: the depth of every cell, and of those that another camera of the same
//! moment sees too, by similarity alone.

use burn::tensor::Tensor;
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_stage1::sweep::{CELL_PIXELS, SweepDepths};
use rogs_tensors::parameters::{from_host, to_host};

use super::forward::SweepTerms;
use super::terms::{EPSILON, Sum};
use crate::config::LossWeights;
use crate::error::Result;
use crate::sample::Sample;

/// Another camera sees a point when its reference depth there differs by less than this share.
const SAME_SURFACE: f64 = 0.05;

/// Adds the losses of what the sweep found in a clip.
pub(super) fn add_terms(sum: &mut Sum, sample: &Sample, found: &SweepTerms, weights: &LossWeights) -> Result<()> {
    let (shape, device) = (found.depths.dims(), found.depths.device());
    let [views, _, rows, columns] = shape;
    let target = Target::of(sample, &found.scale, shape);
    let map = |values: Vec<f32>| from_host::<4>(values, [views, 1, rows, columns], &device);
    let (known, seen) = (map(target.known), map(target.seen));
    if weights.sweep > 0.0 {
        let depths = from_host::<4>(target.depths, shape, &device);
        let entropy = |likely: &Tensor<4>, mask: Tensor<4>| {
            let sum = (likely.clone() * depths.clone()).sum_dim(1) * mask.clone();
            -sum.sum() / (mask.sum() + EPSILON)
        };
        let loss = entropy(&found.matches, seen) + entropy(&found.depths, known.clone());
        sum.add("sweep", weights.sweep, 1.0, loss)?;
    }
    if weights.sweep_depth > 0.0 {
        let error = (found.log_depth_m.clone() - map(target.log_depth_m)).abs() * known.clone();
        let loss = error.sum() / (known.sum() + EPSILON);
        sum.add("sweep_depth", weights.sweep_depth, 1.0, loss)?;
    }
    Ok(())
}

/// Absolute errors of the sweep's expected depth as shares of the reference, of all cells that have one.
pub(super) fn relative_errors(sample: &Sample, found: &SweepTerms) -> Result<Vec<f64>> {
    let target = Target::of(sample, &found.scale, found.depths.dims());
    let expected = to_host(found.log_depth_m.clone())?;
    let cells = expected.iter().zip(&target.log_depth_m).zip(&target.known);
    let known = cells.filter(|(_, known)| **known > 0.0);
    Ok(known
        .map(|((expected, reference), _)| (libm::exp(f64::from(expected - reference)) - 1.0).abs())
        .collect())
}

/// References of the cells of a sweep.
struct Target {
    /// Shares of the two depths around the reference; zeros where there is none. `[S, D, h, w]`
    depths: Vec<f32>,
    /// Logarithm of the reference in metres. `[S, h, w]`
    log_depth_m: Vec<f32>,
    /// 1 where the cell's centre has a reference between the depths, else 0. `[S, h, w]`
    known: Vec<f32>,
    /// 1 where another camera sees it as well. `[S, h, w]`
    seen: Vec<f32>,
}

impl Target {
    /// The references of a clip. `shape`: `[S, D, h, w]`
    fn of(sample: &Sample, scale: &SweepDepths, shape: [usize; 4]) -> Self {
        let [views, depths, rows, columns] = shape;
        let ([height, width], cells) = (sample.size, rows * columns);
        let mut target = Self {
            depths: vec![0.0; views * depths * cells],
            log_depth_m: vec![0.0; views * cells],
            known: vec![0.0; views * cells],
            seen: vec![0.0; views * cells],
        };
        for view in 0..views {
            for cell in 0..cells {
                // The pixel after the centre of the cell.
                let [row, column] = [cell / columns, cell % columns].map(|index| CELL_PIXELS * index + CELL_PIXELS / 2);
                if row >= height || column >= width {
                    continue;
                }
                let pixel = (view * height + row) * width + column;
                let depth_iu = f64::from(sample.depth_iu[pixel]);
                let place = scale.place(depth_iu);
                let low = libm::floor(place);
                if sample.valid[pixel] <= 0.0 || low < 0.0 || low + 1.0 >= depths as f64 {
                    continue;
                }
                let (share, index) = ((place - low) as f32, view * cells + cell);
                let first = (view * depths + low as usize) * cells + cell;
                target.depths[first] = 1.0 - share;
                target.depths[first + cells] = share;
                target.log_depth_m[index] = libm::log(depth_iu / UNITS_PER_METRE) as f32;
                target.known[index] = 1.0;
                let (u, v) = ((column as f64 + 0.5) / width as f64, (row as f64 + 0.5) / height as f64);
                let point = sample.cameras[view].point(u, v, depth_iu);
                target.seen[index] = f32::from(seen_elsewhere(sample, view, point));
            }
        }
        target
    }
}

/// Whether another camera at the time of a view has a point of the reconstruction frame on the surface that it sees.
fn seen_elsewhere(sample: &Sample, view: usize, point_iu: [f64; 3]) -> bool {
    let [height, width] = sample.size;
    let (camera, time) = sample.views[view];
    sample.views.iter().enumerate().any(|(other, &(its, when))| {
        if its == camera || when != time {
            return false;
        }
        let ([u, v], depth) = sample.cameras[other].project(point_iu);
        if depth <= 0.0 || !(0.0..1.0).contains(&u) || !(0.0..1.0).contains(&v) {
            return false;
        }
        let pixel = (v * height as f64) as usize * width + (u * width as f64) as usize;
        let seen = f64::from(sample.depth_iu[other * height * width + pixel]);
        (seen - depth).abs() < SAME_SURFACE * depth
    })
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};
    use rogs_geometry::Pose;
    use rogs_schemas::CameraIndex;
    use rogs_stage1::{NetworkCamera, Stage1Config};

    use super::*;

    const SIZE: [usize; 2] = [8, 16];
    const DEPTHS: usize = 48;

    fn scale() -> SweepDepths {
        SweepDepths::of(&Stage1Config {
            sweep_depths: DEPTHS,
            ..Stage1Config::compact_sweep()
        })
    }

    /// Cameras side by side that look at a wall; the third looks away, the fourth is the first at another time.
    fn before_a_wall(distance_iu: f32) -> Sample {
        let camera = |x: f64, away: bool| {
            let turn = if away { -1.0 } else { 1.0 };
            NetworkCamera {
                world_from_camera_iu: Pose::new(DMat3::from_diagonal(DVec3::new(turn, 1.0, turn)), DVec3::X * x),
                focal_centre: [0.5, 1.0, 0.5, 0.5],
            }
        };
        let pixels = 4 * SIZE[0] * SIZE[1];
        Sample {
            origin: String::new(),
            size: SIZE,
            images: vec![0.5; 3 * pixels],
            cameras: vec![
                camera(0.0, false),
                camera(1.0, false),
                camera(0.0, true),
                camera(0.0, false),
            ],
            recon_from_base_iu: Pose::IDENTITY,
            raster_cameras: Vec::new(),
            views: [(0, 0.0), (1, 0.0), (2, 0.0), (0, 1.0)]
                .map(|(camera, time)| (CameraIndex(camera), time))
                .to_vec(),
            depth_iu: vec![distance_iu; pixels],
            valid: vec![1.0; pixels],
            mesh_depth_iu: vec![0.0; pixels],
            anchored: true,
            support: vec![0.0; pixels],
            scale_cap_iu: vec![0.0; pixels],
            robot: vec![0.0; pixels],
            trackable: vec![0.0; pixels],
            still: true,
            near_tool: vec![0.0; pixels],
            queries: Vec::new(),
        }
    }

    #[test]
    fn cells_have_their_depth_as_target_and_are_seen_where_another_camera_looks() {
        let target = Target::of(&before_a_wall(2.0), &scale(), [4, DEPTHS, 2, 4]);
        // At this distance a point lies 0.5 * 1 / 2 of the width further left in the second image: one cell.
        let seen: Vec<Vec<usize>> = (0..4)
            .map(|view| (0..8).filter(|&cell| target.seen[view * 8 + cell] > 0.0).collect())
            .collect();
        assert_eq!(seen, [vec![1, 2, 3, 5, 6, 7], vec![0, 1, 2, 4, 5, 6], vec![], vec![]]);
        assert!(target.known.iter().all(|&known| known == 1.0));
        let expected = libm::log(2.0 / UNITS_PER_METRE) as f32;
        assert!(target.log_depth_m.iter().all(|&found| (found - expected).abs() < 1e-6));
        for view in 0..4 {
            for cell in 0..8 {
                let of = |depth: usize| f64::from(target.depths[(view * DEPTHS + depth) * 8 + cell]);
                let shares: Vec<f64> = (0..DEPTHS).map(of).collect();
                let mean: f64 = shares
                    .iter()
                    .enumerate()
                    .map(|(depth, share)| depth as f64 * share)
                    .sum();
                assert!((mean - scale().place(2.0)).abs() < 1e-5);
                assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-6);
                assert_eq!(shares.iter().filter(|&&share| share > 0.0).count(), 2);
            }
        }
    }

    #[test]
    fn hidden_cells_are_not_seen_and_depths_outside_the_sweep_not_known() {
        let pixels = SIZE[0] * SIZE[1];
        let mut sample = before_a_wall(2.0);
        // Something stands in front of the second camera.
        sample.depth_iu[pixels..2 * pixels].fill(1.0);
        let hidden = Target::of(&sample, &scale(), [4, DEPTHS, 2, 4]);
        assert!(hidden.seen[..8].iter().all(|&seen| seen == 0.0));
        assert!(hidden.known.iter().all(|&known| known == 1.0));
        let far = Target::of(&before_a_wall(20.0), &scale(), [4, DEPTHS, 2, 4]);
        let numbers = [&far.depths, &far.known, &far.seen].into_iter().flatten();
        assert!(numbers.into_iter().all(|&number| number == 0.0));
    }
}
