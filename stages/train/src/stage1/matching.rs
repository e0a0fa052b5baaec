//! What the plane sweep of the stem should find: the depth of every cell that another camera of the same moment sees too.

use rogs_networks::stage1::sweep::{CELL_PIXELS, place};

use crate::sample::Sample;

/// Another camera sees a point when its reference depth there differs by less than this share.
const SAME_SURFACE: f64 = 0.05;

/// Shares of the two depths of the sweep around the reference, of every cell whose centre another camera sees; zeros
/// elsewhere. `[S, D, h, w]`
pub(super) fn target(sample: &Sample, [views, depths, rows, columns]: [usize; 4]) -> Vec<f32> {
    let ([height, width], cells) = (sample.size, rows * columns);
    let mut target = vec![0.0f32; views * depths * cells];
    for view in 0..views {
        let depths_iu = &sample.depth_iu[view * height * width..][..height * width];
        let points = sample.cameras[view].unproject(depths_iu, height, width);
        for cell in 0..cells {
            // The pixel after the centre of the cell.
            let [row, column] = [cell / columns, cell % columns].map(|index| CELL_PIXELS * index + CELL_PIXELS / 2);
            if row >= height || column >= width {
                continue;
            }
            let pixel = row * width + column;
            let index = view * height * width + pixel;
            let place = place(f64::from(sample.depth_iu[index]), depths);
            let low = libm::floor(place);
            let inside = sample.valid[index] > 0.0 && low >= 0.0 && low + 1.0 < depths as f64;
            if !inside
                || !seen_elsewhere(
                    sample,
                    view,
                    std::array::from_fn(|axis| f64::from(points[3 * pixel + axis])),
                )
            {
                continue;
            }
            let share = (place - low) as f32;
            let first = (view * depths + low as usize) * cells + cell;
            target[first] = 1.0 - share;
            target[first + cells] = share;
        }
    }
    target
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
    use rogs_networks::stage1::Camera;

    use super::*;

    const SIZE: [usize; 2] = [8, 16];
    const DEPTHS: usize = 48;

    /// Cameras side by side that look at a wall; the third looks away, the fourth is the first at another time.
    fn before_a_wall(distance_iu: f32) -> Sample {
        let camera = |x: f64, away: bool| {
            let turn = if away { -1.0 } else { 1.0 };
            Camera {
                rotation: [turn, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, turn],
                translation_iu: [x, 0.0, 0.0],
                focal_centre: [0.5, 1.0, 0.5, 0.5],
            }
        };
        let pixels = 4 * SIZE[0] * SIZE[1];
        Sample {
            seed: 0,
            size: SIZE,
            images: vec![0.5; 3 * pixels],
            cameras: vec![
                camera(0.0, false),
                camera(1.0, false),
                camera(0.0, true),
                camera(0.0, false),
            ],
            raster_cameras: Vec::new(),
            views: vec![(0, 0.0), (1, 0.0), (2, 0.0), (0, 1.0)],
            depth_iu: vec![distance_iu; pixels],
            valid: vec![1.0; pixels],
            mesh_depth_iu: vec![0.0; pixels],
            support: vec![0.0; pixels],
            scale_cap_iu: vec![0.0; pixels],
            robot: vec![0.0; pixels],
            trackable: vec![0.0; pixels],
            queries: Vec::new(),
        }
    }

    #[test]
    fn cells_that_another_camera_sees_have_their_depth_as_target() {
        let sample = before_a_wall(2.0);
        let target = target(&sample, [4, DEPTHS, 2, 4]);
        // At this distance a point lies 0.5 * 1 / 2 of the width further left in the second image: one cell.
        let at = |view: usize, cell: usize| -> Vec<f64> {
            let of = |depth: usize| f64::from(target[(view * DEPTHS + depth) * 8 + cell]);
            (0..DEPTHS).map(of).collect()
        };
        let sees = |view: usize, cell: usize| (at(view, cell).iter().sum::<f64>() - 1.0).abs() < 1e-6;
        let seen: Vec<Vec<usize>> = (0..4)
            .map(|view| (0..8).filter(|&cell| sees(view, cell)).collect())
            .collect();
        assert_eq!(seen, [vec![1, 2, 3, 5, 6, 7], vec![0, 1, 2, 4, 5, 6], vec![], vec![]]);
        let mean: f64 = at(0, 1)
            .iter()
            .enumerate()
            .map(|(depth, share)| depth as f64 * share)
            .sum();
        assert!((mean - place(2.0, DEPTHS)).abs() < 1e-5);
        assert_eq!(at(0, 1).iter().filter(|&&share| share > 0.0).count(), 2);
    }

    #[test]
    fn hidden_cells_and_depths_outside_the_sweep_have_none() {
        let pixels = SIZE[0] * SIZE[1];
        let mut sample = before_a_wall(2.0);
        // Something stands in front of the second camera.
        sample.depth_iu[pixels..2 * pixels].fill(1.0);
        assert!(
            target(&sample, [4, DEPTHS, 2, 4])[..DEPTHS * 8]
                .iter()
                .all(|&share| share == 0.0)
        );
        let far = before_a_wall(20.0);
        assert!(target(&far, [4, DEPTHS, 2, 4]).iter().all(|&share| share == 0.0));
    }
}
