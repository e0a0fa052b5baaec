//! Wrist cameras of procedural episodes, started from another rig's hand-eye pose.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod clips;
#[path = "../../agreement/tests/common/mod.rs"]
mod common;

use clips::Clip;
use common::Machine;
use glam::DVec3;
use rogs_agreement::audit::Mount;
use rogs_calibration::{Prior, Settings, Take, refine};
use rogs_geometry::{Pose, rotation_about_axis};

#[test]
fn a_hand_eye_three_degrees_off_is_found_along_its_path() {
    let machine = Machine::new();
    let count = std::env::var("ROGS_CALIBRATION_CAMERAS").map_or(3, |count| count.parse().unwrap());
    let (mut turned, mut distances) = (Vec::new(), Vec::new());
    for number in 0..count {
        let mut clip = Clip::of(&machine, 700 + number as u64);
        let Mount::Hand { link, link_from_camera } = clip.mounts[0] else {
            unreachable!()
        };
        let angle = number as f64 * 2.4;
        let axis = DVec3::new(angle.cos(), angle.sin(), 0.3).normalize();
        let wrong = Pose::new(
            rotation_about_axis(axis, 3f64.to_radians()),
            DVec3::new(angle.sin(), angle.cos(), 0.0) * 0.008,
        );
        clip.mounts[0] = Mount::Hand {
            link,
            link_from_camera: link_from_camera * wrong,
        };
        let footage = clip.footage(&machine);
        let settings = Settings {
            prior: Prior::HAND_EYE,
            ..Settings::default()
        };
        let take = Take {
            footage: &footage,
            camera: 0,
        };
        let refined = match refine(&[take], &settings) {
            Ok(refined) => refined,
            Err(error) => {
                println!("{number}: {error}");
                turned.push(f64::INFINITY);
                continue;
            }
        };
        let Mount::Hand {
            link_from_camera: found,
            ..
        } = refined.mount
        else {
            unreachable!()
        };
        let off = link_from_camera.inverse() * found;
        let degrees = off.quaternion().to_scaled_axis().length().to_degrees();
        println!(
            "{number}: {degrees:.2} deg, {:.1} mm; epipolar {:?} -> {:?} px of {} matches, edges {:.2} -> {:.2} px",
            1000.0 * off.translation.length(),
            refined.before.epipolar_px,
            refined.after.epipolar_px,
            refined.matches,
            refined.before.edge_px,
            refined.after.edge_px
        );
        turned.push(degrees);
        // Of fewer matches the distance is that of the wrong ones.
        if refined.matches >= 30 {
            distances.extend(refined.after.epipolar_px);
        }
    }
    turned.sort_by(f64::total_cmp);
    assert!(turned[turned.len() / 2] < 0.3, "{turned:?}");
    assert!(!distances.is_empty(), "no clip has 30 matches");
    assert!(distances.iter().all(|&distance| distance < 0.5), "{distances:?}");
}
