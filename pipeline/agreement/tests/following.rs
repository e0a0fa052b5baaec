//! Lag and drift on procedural rollouts, whose distortions are known.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::{Machine, episode};
use rogs_agreement::{Agreement, Following, MovedView, Settings, Surface, View, agreement, follow, link_offsets};
use rogs_geometry::PosedCamera;
use rogs_robot::MeshImage;
use rogs_synth::{Distortions, Episode};

const FRAMES: usize = 17;
const FIRST: usize = 7;

/// What a camera of a rollout tells of lag and drift, and the median offset over its frames, pixels.
fn followed(machine: &Machine, episode: &Episode, camera: usize, distortions: &Distortions) -> (Following, f64) {
    let frames: Vec<usize> = (FIRST..FIRST + FRAMES).collect();
    let images: Vec<Vec<u8>> = (0..FRAMES)
        .map(|number| {
            let mut views = episode.render_rollout(FIRST, number, FRAMES, distortions);
            views.swap_remove(camera).rgb
        })
        .collect();
    let posed: Vec<PosedCamera<_>> = frames
        .iter()
        .map(|&frame| common::camera(episode, camera, frame))
        .collect();
    let links: Vec<_> = frames
        .iter()
        .map(|&frame| machine.links(&episode.states[frame]))
        .collect();
    let drawn: Vec<MeshImage> = (0..FRAMES)
        .map(|i| machine.draw(&posed[i].lens, &posed[i].world_from_camera, &links[i]))
        .collect();
    let views: Vec<View<'_>> = (0..FRAMES)
        .map(|i| View {
            rgb: &images[i],
            camera: posed[i],
            surface: Surface::from(&drawn[i]),
            base_from_link: &links[i],
            sensor_depth_m: None,
        })
        .collect();
    let told: Vec<Agreement> = views
        .iter()
        .map(|view| agreement(view, &Settings::default()).unwrap())
        .collect();
    let mut offsets = Vec::new();
    let moved: Vec<Option<MovedView<'_>>> = views
        .iter()
        .zip(&told)
        .map(|(view, told)| match told {
            Agreement::Measured(found) => {
                offsets.push(found.offset_px[0]);
                let some = (0..links[0].len())
                    .filter_map(|link| link_offsets(&found.samples, view.camera.lens.intrinsics.fx, link));
                assert!(some.count() > 0, "no link has edges");
                Some(MovedView {
                    view: *view,
                    samples: &found.samples,
                })
            }
            Agreement::CannotTell { .. } => None,
        })
        .collect();
    offsets.sort_by(f64::total_cmp);
    (
        follow(&moved).unwrap(),
        offsets.get(offsets.len() / 2).copied().unwrap_or(f64::NAN),
    )
}

#[test]
fn lag_and_drift_are_what_the_rollout_was_made_with() {
    let machine = Machine::new();
    let none = Distortions::default();
    let lagging = |lag_frames| Distortions { lag_frames, ..none };
    let mut errors = Vec::new();
    for seed in [3, 4] {
        let episode = episode(seed);
        for (name, distortions, lag, drift_m) in [
            ("recorded", none, 0.0, 0.0),
            ("lag 2", lagging(2), 2.0, 0.0),
            ("lag 4", lagging(4), 4.0, 0.0),
            ("drift", Distortions { drift_m: 0.05, ..none }, 0.0, 0.05),
            ("blur", Distortions { blur_px: 2.0, ..none }, 0.0, 0.0),
        ] {
            for camera in [1, 2] {
                let (found, offset_px) = followed(&machine, &episode, camera, &distortions);
                println!("seed {seed}, camera {camera}, {name}: {found:?}, median offset {offset_px:.2} px");
                // Only the first external camera drifts.
                let drift_m = if camera == 1 { drift_m } else { 0.0 };
                let drift = found.drift_m.unwrap();
                let wrong = (drift[0] - drift_m).abs() > 0.2 * drift_m + 0.006;
                assert!(!wrong, "seed {seed}, camera {camera}, {name}: drift {drift:?}");
                let Some([found_lag, sigma]) = found.lag_frames else {
                    continue;
                };
                assert!(sigma < 0.6);
                errors.push((found_lag - lag).abs());
                assert!(
                    (found_lag - lag).abs() < 0.5,
                    "seed {seed}, camera {camera}, {name}: lag {found_lag} +- {sigma}"
                );
            }
        }
    }
    assert!(errors.len() >= 10, "the lag is told in {} of 20 views", errors.len());
}

#[test]
fn larger_distortions_are_found_to_be_larger() {
    let machine = Machine::new();
    let episode = episode(5);
    let none = Distortions::default();
    let drifts = [0.0, 0.02, 0.04, 0.08].map(|drift_m| Distortions { drift_m, ..none });
    let found = drifts.map(|distortions| followed(&machine, &episode, 1, &distortions));
    for (distortions, (found, offset_px)) in drifts.iter().zip(&found) {
        let [drift, sigma] = found.drift_m.unwrap();
        println!(
            "drift {} m: {drift:.4} +- {sigma:.4} m, median offset {offset_px:.2} px",
            distortions.drift_m
        );
        assert!(
            (drift - distortions.drift_m).abs() < 0.2 * distortions.drift_m + 0.004,
            "{drift}"
        );
    }
    assert!(found.is_sorted_by(|(a, px_a), (b, px_b)| a.drift_m.unwrap()[0] < b.drift_m.unwrap()[0] && px_a < px_b));
    let lags = [0, 1, 2, 4].map(|lag_frames| Distortions { lag_frames, ..none });
    let found = lags.map(|distortions| followed(&machine, &episode, 2, &distortions));
    for (distortions, (found, offset_px)) in lags.iter().zip(&found) {
        let [lag, sigma] = found.lag_frames.unwrap();
        println!(
            "lag {}: {lag:.2} +- {sigma:.2} frames, median offset {offset_px:.2} px",
            distortions.lag_frames
        );
        assert!((lag - distortions.lag_frames as f64).abs() < 0.5, "{lag}");
    }
    assert!(found.is_sorted_by(|(_, px_a), (_, px_b)| px_a <= px_b));
}

#[test]
fn frames_that_do_not_tell_give_no_lag() {
    assert_eq!(follow(&[]).unwrap(), Following::default());
    assert_eq!(follow(&[None; 17]).unwrap(), Following::default());
}
