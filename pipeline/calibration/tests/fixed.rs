//! Cameras of procedural episodes, started from where they do not stand.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod clips;
#[path = "../../agreement/tests/common/mod.rs"]
mod common;
mod starts;

use clips::{Clip, FRAMES};
use common::Machine;
use rogs_agreement::Why;
use rogs_agreement::audit::Mount;
use rogs_calibration::{Error, Prior, Refined, Settings, Take, refine, search};
use rogs_geometry::Pose;
use starts::{Frames, apart, off, summary, three_off};

fn count(default: usize) -> usize {
    std::env::var("ROGS_CALIBRATION_CAMERAS").map_or(default, |count| count.parse().unwrap())
}

#[test]
fn cameras_three_centimetres_and_degrees_off_come_near() {
    let ends = three_off(&Machine::new(), 0..count(4), Frames::Clip);
    println!("{}", summary(&ends));
    let good = ends.iter().filter(|end| end.within_gate()).count();
    assert!(10 * good >= 7 * ends.len(), "{good} of {}", ends.len());
    for (number, end) in ends.iter().enumerate() {
        let [mm, degrees] = end.off;
        assert!(mm < 8.0 && degrees < 0.5, "{number}: {mm} mm, {degrees} degrees");
        // A deviation that is told holds.
        let worst = end.standardised.iter().fold(0.0, |most: f64, z| most.max(z.abs()));
        assert!(worst < 6.0, "{number}: {worst} standard deviations");
    }
}

#[ignore = "not reached: some 91 % of cameras where 95 % are wanted (docs/calibration.md)"]
#[test]
fn cameras_three_centimetres_and_degrees_off_are_found() {
    let ends = three_off(&Machine::new(), 0..count(100), Frames::Whole);
    println!("{}", summary(&ends));
    let good = ends.iter().filter(|end| end.within_gate()).count();
    assert!(20 * good >= 19 * ends.len(), "{good} of {}", ends.len());
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
