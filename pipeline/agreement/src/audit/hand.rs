//! Cameras on the hand: a search over poses, and a pose followed from frame to frame.

use glam::DVec3;
use rayon::prelude::*;
use rogs_geometry::{Camera, Pose};
use rogs_robot::raster::Renderer;

use super::footage::evenly;
use super::trial::{Supposed, Trials, moved, twist};
use crate::measure::Settings;

/// Step and number of steps to each side of the turns that are tried, radians.
const STEP: f64 = 0.07;
const STEPS: i32 = 6;
/// So many of them are refined.
const REFINED: usize = 4;

/// A camera that was found elsewhere.
pub(super) struct Elsewhere {
    /// How far it has turned, rotation vector, radians, and gone, metres.
    pub by: [DVec3; 2],
    /// Overlay there.
    pub overlay: f64,
}

/// Turns a camera about its x and y by up to 24 degrees, which from so near looks as a step does, and refines the best
/// places. `steady` and `half` hold its steady image, at full and at half size.
pub(super) fn search(steady: &Trials<'_>, half: &Trials<'_>, camera: usize, given: &Supposed) -> Option<Elsewhere> {
    let frames = evenly(steady.footage.frames(), 2);
    let turned = |turn: DVec3| Supposed {
        mount: given.mount.moved(moved(turn, DVec3::ZERO)),
        ..given.clone()
    };
    let places: Vec<DVec3> = (-STEPS..=STEPS)
        .flat_map(|x| (-STEPS..=STEPS).map(move |y| DVec3::new(f64::from(x), f64::from(y), 0.0) * STEP))
        .collect();
    let mut rated: Vec<(f64, DVec3)> = places
        .par_iter()
        .map(|&turn| (half.overlay(camera, &turned(turn), &frames[..1], None), turn))
        .collect();
    rated.sort_by(|a, b| b.0.total_cmp(&a.0));
    let refined = rated[..REFINED.min(rated.len())].iter().map(|&(_, turn)| {
        let (found, [more, step]) = steady.refine(camera, &turned(turn), &frames);
        let total: Pose<Camera, Camera> = moved(turn, DVec3::ZERO) * moved(more, step);
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
