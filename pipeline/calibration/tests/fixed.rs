//! Cameras of procedural episodes, started from where they do not stand.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod clips;
#[path = "../../agreement/tests/common/mod.rs"]
mod common;

use clips::Clip;
use common::Machine;
use glam::DVec3;
use rogs_agreement::audit::Mount;
use rogs_calibration::{Settings, Take, refine};
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

#[test]
fn cameras_three_centimetres_and_degrees_off_are_found() {
    let machine = Machine::new();
    let mut errors = Vec::new();
    let mut standardised = Vec::new();
    let started = std::time::Instant::now();
    let cameras = count(4);
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
    assert!(20 * good >= 19 * cameras, "{good} of {cameras}");
}
