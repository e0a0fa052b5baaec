//! Procedural cameras started from where they do not stand, and where they end.
#![allow(dead_code, reason = "each target uses a part")]

use std::fmt::Write as _;
use std::ops::Range;
use std::time::Instant;

use glam::DVec3;
use rogs_agreement::audit::Mount;
use rogs_calibration::{Settings, Take, refine};
use rogs_geometry::{Base, Camera, Pose, rotation_about_axis};

use crate::clips::Clip;
use crate::common::Machine;

/// The gate: millimetres and degrees.
pub(crate) const GATE: [f64; 2] = [3.0, 0.3];

/// Which frames of an episode are looked at.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Frames {
    /// All, as `rogs calibrate` does.
    Whole,
    /// The 17 of a clip.
    Clip,
}

/// Where a camera ended.
pub(crate) struct End {
    /// Distance from the truth, mm and degrees; infinite when it was given up.
    pub(crate) off: [f64; 2],
    /// Errors of turn and shift over their standard deviations.
    pub(crate) standardised: [f64; 6],
    /// Its own standard deviations, mm and degrees.
    pub(crate) sigma: [f64; 2],
    /// How long it took, seconds.
    pub(crate) seconds: f64,
}

impl End {
    pub(crate) fn within_gate(&self) -> bool {
        self.off[0] < GATE[0] && self.off[1] < GATE[1]
    }

    /// Whether the images hold the pose so closely by its own covariance.
    pub(crate) fn held(&self) -> bool {
        self.sigma[0] < GATE[0] && self.sigma[1] < GATE[1]
    }
}

/// A pose so far away, metres and degrees, in a direction that depends on the seed.
pub(crate) fn off(seed: u64, metres: f64, degrees: f64) -> Pose<Camera, Camera> {
    let angle = seed as f64 * 2.4;
    let direction = DVec3::new(angle.cos(), angle.sin(), (seed as f64 * 1.3).sin()).normalize();
    let axis = DVec3::new((seed as f64 * 1.7).cos(), (seed as f64 * 1.7).sin(), 0.5).normalize();
    Pose::new(rotation_about_axis(axis, degrees.to_radians()), direction * metres)
}

/// Millimetres and degrees between two poses.
pub(crate) fn apart(a: &Pose<Base, Camera>, b: &Pose<Base, Camera>) -> [f64; 2] {
    let turn = (a.inverse() * *b).quaternion().to_scaled_axis().length();
    [1000.0 * (a.translation - b.translation).length(), turn.to_degrees()]
}

/// Cameras that start 3 cm and 3 degrees off, two an episode; a line of each is printed.
#[allow(clippy::print_stdout)]
pub(crate) fn three_off(machine: &Machine, numbers: Range<usize>, frames: Frames) -> Vec<End> {
    numbers
        .map(|number| {
            let (seed, index) = (500 + number as u64 / 2, 1 + number % 2);
            let mut clip = match frames {
                Frames::Whole => Clip::whole(machine, seed),
                Frames::Clip => Clip::of(machine, seed),
            };
            let Mount::Fixed(truth) = clip.mounts[index] else {
                unreachable!()
            };
            clip.mounts[index] = Mount::Fixed(truth * off(number as u64, 0.03, 3.0));
            let footage = clip.footage(machine);
            let take = Take {
                footage: &footage,
                camera: index,
            };
            let started = Instant::now();
            let refined = refine(&[take], &Settings::default());
            let seconds = started.elapsed().as_secs_f64();
            let refined = match refined {
                Ok(refined) => refined,
                Err(error) => {
                    println!("{number:3}: {error}");
                    return End {
                        off: [f64::INFINITY; 2],
                        standardised: [0.0; 6],
                        sigma: [f64::INFINITY; 2],
                        seconds,
                    };
                }
            };
            let Mount::Fixed(found) = refined.mount else {
                unreachable!()
            };
            let left = found.inverse() * truth;
            let turn = left.quaternion().to_scaled_axis();
            let end = End {
                off: apart(&truth, &found),
                standardised: std::array::from_fn(|i| {
                    let value = if i < 3 { turn[i] } else { left.translation[i - 3] };
                    value / refined.sigma[i]
                }),
                sigma: [
                    1000.0 * DVec3::from_slice(&refined.sigma[3..6]).length(),
                    DVec3::from_slice(&refined.sigma[..3]).length().to_degrees(),
                ],
                seconds,
            };
            println!(
                "{number:3}: {:5.2} mm {:.3} deg, sigma {:.2} mm {:.3} deg, z {}, edges {:.2} -> {:.2} px, overlay {:.2} -> {:.2}, \
                 {seconds:.1} s",
                end.off[0],
                end.off[1],
                end.sigma[0],
                end.sigma[1],
                end.standardised.map(|z| format!("{z:.1}")).join(" "),
                refined.before.edge_px,
                refined.after.edge_px,
                refined.before.overlay,
                refined.after.overlay,
            );
            end
        })
        .collect()
}

/// Share within the gate, quantiles, and whether standard deviations are right.
pub(crate) fn summary(ends: &[End]) -> String {
    let count = ends.len();
    let good = ends.iter().filter(|end| end.within_gate()).count();
    let quantile = |share: f64, of: &dyn Fn(&End) -> f64| {
        let mut values: Vec<f64> = ends.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values[((count - 1) as f64 * share).round() as usize]
    };
    let mut text = format!("{good} of {count} within {} mm and {} degrees", GATE[0], GATE[1]);
    let held = || ends.iter().filter(|end| end.held());
    let _ = write!(
        text,
        "; {} of the {} whose own standard deviations are",
        held().filter(|end| end.within_gate()).count(),
        held().count()
    );
    for share in [0.5, 0.9, 0.95, 1.0] {
        let (mm, degrees) = (quantile(share, &|end| end.off[0]), quantile(share, &|end| end.off[1]));
        let _ = write!(
            text,
            "\n{:3.0} % within {mm:.2} mm, {degrees:.3} degrees",
            100.0 * share
        );
    }
    let all: Vec<f64> = ends
        .iter()
        .filter(|end| end.off[0].is_finite())
        .flat_map(|end| end.standardised)
        .collect();
    let root = f64::sqrt(all.iter().map(|z| z * z).sum::<f64>() / all.len() as f64);
    let within = |size: f64| 100.0 * all.iter().filter(|z| z.abs() < size).count() as f64 / all.len() as f64;
    let _ = write!(
        text,
        "\nerrors over standard deviations: root mean square {root:.2}; {:.0} % below 1 (68 of a normal one), {:.0} % below 2 (95)",
        within(1.0),
        within(2.0)
    );
    let _ = write!(
        text,
        "\n{:.1} s a camera",
        ends.iter().map(|end| end.seconds).sum::<f64>() / count as f64
    );
    text
}
