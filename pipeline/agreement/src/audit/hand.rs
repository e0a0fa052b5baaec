//! Cameras on the hand: a search over poses, and a pose followed from frame to frame.

use glam::DVec3;
use rayon::prelude::*;
use rogs_geometry::{Camera, Pose};
use rogs_robot::raster::Renderer;

use super::footage::evenly;
use super::trial::{Supposed, Trials, moved, twist};
use crate::measure::Settings;

/// Places along x and y are this far apart, metres: 15 cm before the gripper, a search of 12 px reaches that far.
const STEP_M: f64 = 0.0125;
/// Steps to each side.
const STEPS: i32 = 5;
/// Places along the axis, metres.
const ALONG_M: [f64; 3] = [-0.03, 0.0, 0.03];
/// So many places are refined.
const REFINED: usize = 5;

/// A camera that was found elsewhere.
pub(super) struct Elsewhere {
    /// How far it has turned, rotation vector, radians, and gone, metres.
    pub by: [DVec3; 2],
    /// Overlay there.
    pub overlay: f64,
}

/// Moves a camera along its x and y by up to 6 cm, which turns it enough, too, so near to the gripper, and along its axis;
/// refines the best places. `steady` and `half` hold its steady image, at full and at half size.
pub(super) fn search(steady: &Trials<'_>, half: &Trials<'_>, camera: usize, given: &Supposed) -> Option<Elsewhere> {
    let frames = evenly(steady.footage.frames(), 2);
    let gone = |step: DVec3| Supposed {
        mount: given.mount.moved(moved(DVec3::ZERO, step)),
        ..given.clone()
    };
    let across = (-STEPS..=STEPS).flat_map(|x| (-STEPS..=STEPS).map(move |y| [x, y].map(f64::from)));
    let places: Vec<DVec3> = across
        .flat_map(|[x, y]| ALONG_M.map(|z| DVec3::new(x * STEP_M, y * STEP_M, z)))
        .collect();
    let mut rated: Vec<(f64, DVec3)> = places
        .par_iter()
        .map(|&step| (half.overlay(camera, &gone(step), &frames[..1], None), step))
        .collect();
    rated.sort_by(|a, b| b.0.total_cmp(&a.0));
    let refined = rated[..REFINED.min(rated.len())].iter().map(|&(_, step)| {
        let (found, [turn, more]) = steady.refine(camera, &gone(step), &frames);
        let total: Pose<Camera, Camera> = moved(DVec3::ZERO, step) * moved(turn, more);
        Elsewhere {
            by: [total.quaternion().to_scaled_axis(), total.translation],
            overlay: steady.overlay(camera, &found, &frames, None),
        }
    });
    refined.max_by(|a, b| a.overlay.total_cmp(&b.overlay))
}

/// Follows the pose of a camera against the hand from the first frame to the last; where it ends, with the mean overlay
/// over the frames less that of the given pose.
pub(super) fn followed(trials: &Trials<'_>, camera: usize, given: &Supposed) -> Elsewhere {
    let settings = Settings {
        most_samples: 200,
        ..Settings::of_range(8.0)
    };
    let mut renderer = Renderer::new(trials.footage.scene);
    let mut total: Pose<Camera, Camera> = Pose::IDENTITY;
    let frames: Vec<usize> = evenly(trials.footage.frames(), 33);
    let mut gain = 0.0;
    for &frame in &frames {
        let mut own = Supposed {
            mount: given.mount.moved(total),
            ..given.clone()
        };
        for _ in 0..2 {
            let Some(seen) = trials.look(&mut renderer, camera, &own, frame, &settings) else {
                break;
            };
            let Some([turn, step]) = twist(&[seen], settings.range_px) else {
                break;
            };
            total = total * moved(turn, step);
            own.mount = given.mount.moved(total);
        }
        gain += trials.overlay(camera, &own, &[frame], None) - trials.overlay(camera, given, &[frame], None);
    }
    Elsewhere {
        by: [total.quaternion().to_scaled_axis(), total.translation],
        overlay: gain / frames.len().max(1) as f64,
    }
}
