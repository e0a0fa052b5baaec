//! A pose for a fixed camera of which nothing is known but its lens, about (`docs/spec/calibration.md` section 6).

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use rogs_agreement::audit::Mount;
use rogs_geometry::{Base, Camera, Link, Pinhole, Pose, rotation_about_axis};
use rogs_robot::RenderOptions;
use rogs_robot::raster::Renderer;
use rogs_schemas::records::robot::NO_LINK;

use crate::correction::{Correction, Prior};
use crate::edges::Level;
use crate::refine::{check, converge, factor, judging, near};
use crate::scaled::{Grey, shrunk, shrunk_lens};
use crate::take::{Take, chosen_frames};
use crate::{Error, Result};

/// Columns of the images in which poses are sought.
const COLUMNS: u32 = 96;
/// Directions around the robot, from the level upwards, and distances from its middle, metres.
const AZIMUTHS: usize = 24;
const ELEVATIONS_DEG: [f64; 5] = [-5.0, 12.0, 29.0, 46.0, 63.0];
const DISTANCES_M: [f64; 6] = [0.45, 0.65, 0.9, 1.25, 1.7, 2.3];
/// Pixels between the shifts of the image that are tried.
const SHIFT_STEP: i32 = 4;
/// How many go on from one look to the next.
const KEPT: [usize; 3] = [240, 32, 6];
/// The images must change by this much somewhere, grey values.
const CHANGE: f32 = 12.0;
/// A pixel of the robot that changes its depth by this much changes, metres.
const MOVED_M: f32 = 0.01;

/// A pose that was found without a start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// The pose.
    pub base_from_camera: Pose<Base, Camera>,
    /// Its overlay (`docs/spec/agreement.md` section 3).
    pub overlay: f64,
    /// The overlay of the best pose that is clearly another (by 10 cm or 10 degrees), where there is one.
    pub other: Option<f64>,
}

/// Searches the pose of a fixed camera. The takes' own poses of it do not count; their lens does.
///
/// # Errors
/// When the robot or the image stands still, when no pose fits, or what is given does not fit together.
pub fn search(takes: &[Take<'_>]) -> Result<Found> {
    check(takes)?;
    let filmed = takes[0].filmed();
    if !matches!(filmed.mount, Mount::Fixed(_)) {
        let what = "a search needs a camera that stands still".to_owned();
        return Err(Error::Input { what });
    }
    let frames = chosen_frames(takes, 4);
    if frames.len() < 2 {
        return Err(Error::TooFewFrames { frames: frames.len() });
    }
    let moments = Moments::new(takes, &frames)?;
    let mut rough = moments.rough();
    rough.truncate(KEPT[0]);
    // One level of small images serves all: a pose is a correction of the given one.
    let given = given_pose(&filmed.mount);
    let correction = |pose: &Pose<Base, Camera>| Correction {
        moved: (given.inverse() * *pose).relabelled(),
        ..Correction::NONE
    };
    let small = Level::new(takes, &frames, factor(&filmed.lens, COLUMNS));
    let rate = |level: &Level<'_>, correction: &Correction, range: f64| -> f64 {
        let settings = rogs_agreement::Settings {
            most_samples: 150,
            inner: false,
            ..rogs_agreement::Settings::of_range(range)
        };
        level.look(correction, &settings).map_or(f64::NEG_INFINITY, |look| {
            look.overlay * (look.visible as f64 / look.frames.max(1) as f64)
        })
    };
    let mut looked: Vec<(f64, Correction)> = rough
        .par_iter()
        .map(|(likeness, pose)| {
            let correction = correction(pose);
            (rate(&small, &correction, 8.0) + 0.5 * likeness, correction)
        })
        .collect();
    best_first(&mut looked);
    let mut kept = apart(&looked, KEPT[1], 0.04, 0.06);
    kept = kept
        .into_par_iter()
        .filter_map(|(_, start)| near(&small, &Prior::NOTHING, start).ok())
        .map(|near| (rate(&small, &near, 6.0), near))
        .collect();
    best_first(&mut kept);
    let frames = chosen_frames(takes, 12);
    let full = Level::new(takes, &frames, factor(&filmed.lens, 360));
    let settings = judging(&full);
    let mut last: Vec<(f64, Correction)> = apart(&kept, KEPT[2], 0.04, 0.06)
        .into_iter()
        .filter_map(|(_, start)| {
            // The prior must not pull to where nothing is known to be.
            let solved = converge(takes, &frames, &full, &Prior::NOTHING, start).ok()?;
            let look = full.look(&solved.correction, &settings).ok()?;
            Some((look.overlay, solved.correction))
        })
        .collect();
    best_first(&mut last);
    let distinct = apart(&last, 2, 0.1, 0.17);
    let Some((overlay, best)) = distinct.first().copied().filter(|(overlay, _)| *overlay >= FITS) else {
        let overlay = distinct.first().map_or(0.0, |(overlay, _)| *overlay);
        return Err(Error::NotFound { overlay });
    };
    Ok(Found {
        base_from_camera: given * best.moved.relabelled(),
        overlay,
        other: distinct.get(1).map(|(overlay, _)| *overlay),
    })
}

/// A pose that was searched must overlay at least this much.
const FITS: f64 = 0.3;

fn given_pose(mount: &Mount) -> Pose<Base, Camera> {
    match mount {
        Mount::Fixed(pose) => *pose,
        Mount::Hand { .. } | Mount::Path(_) => Pose::IDENTITY,
    }
}

fn best_first(rated: &mut [(f64, Correction)]) {
    rated.sort_by(|a, b| b.0.total_cmp(&a.0));
}

/// The best that differ from each other by a shift (metres) or a turn (radians).
fn apart(rated: &[(f64, Correction)], most: usize, shift: f64, turn: f64) -> Vec<(f64, Correction)> {
    let mut kept: Vec<(f64, Correction)> = Vec::new();
    for &(rating, candidate) in rated {
        let differs = |(_, other): &(f64, Correction)| {
            let between: Pose<Camera, Camera> = other.moved.inverse() * candidate.moved;
            between.translation.length() > shift || between.quaternion().to_scaled_axis().length() > turn
        };
        if kept.len() < most && rating.is_finite() && kept.iter().all(differs) {
            kept.push((rating, candidate));
        }
    }
    kept
}

/// Some moments of the clips, small, and what changes between them.
struct Moments<'a> {
    takes: &'a [Take<'a>],
    /// The camera of the small images.
    lens: Pinhole,
    /// The same with half an image more on every side.
    wide: Pinhole,
    /// Link poses at the moments.
    links: Vec<Vec<Pose<Base, Link>>>,
    /// Pairs of moments, and how much images change between them, less the mean and scaled to length 1. `[H, W]`
    changes: Vec<([usize; 2], Vec<f32>)>,
    /// The middle of what moves, base frame, metres.
    middle: DVec3,
}

impl<'a> Moments<'a> {
    fn new(takes: &'a [Take<'a>], frames: &[(usize, usize)]) -> Result<Self> {
        let given = takes[0].filmed().lens;
        let factor = factor(&given, COLUMNS);
        let lens = shrunk_lens(&given, factor);
        let (width, height) = (lens.width as usize, lens.height as usize);
        let (mut links, mut greys) = (Vec::new(), Vec::new());
        for &(clip, frame) in frames {
            links.push(takes[clip].links(frame as f64)?.unwrap_or_default());
            let image = takes[clip].filmed().images[frame];
            let small = shrunk(image, given.width as usize, given.height as usize, factor as usize);
            greys.push(Grey::of_rgb(&small, width, height));
        }
        let pairs = (0..frames.len()).flat_map(|a| (a + 1..frames.len()).map(move |b| [a, b]));
        let mut changes = Vec::new();
        for [a, b] in pairs {
            let values = greys[a].values.iter().zip(&greys[b].values);
            let mut change: Vec<f32> = values.map(|(a, b)| ((a - b).abs()).min(60.0)).collect();
            let strong = change.iter().filter(|value| **value > CHANGE).count();
            if strong * 200 > change.len() {
                normalise(&mut change);
                changes.push(([a, b], change));
            }
        }
        let middle = moving_middle(takes[0], &links);
        let (Some(middle), false) = (middle, changes.is_empty()) else {
            return Err(Error::StandsStill);
        };
        let (half_width, half_height) = (lens.width as i32 / 2, lens.height as i32 / 2);
        Ok(Self {
            takes,
            wide: lens.cropped(
                -half_width,
                -half_height,
                lens.width + 2 * half_width as u32,
                lens.height + 2 * half_height as u32,
            ),
            lens,
            links,
            changes,
            middle,
        })
    }

    /// Poses all around the robot, each turned so that what should change in the images lies on what does, the likeliest
    /// first, with the correlation.
    fn rough(&self) -> Vec<(f64, Pose<Base, Camera>)> {
        let mut places = Vec::new();
        for azimuth in 0..AZIMUTHS {
            for elevation in ELEVATIONS_DEG {
                for distance in DISTANCES_M {
                    let (sin_a, cos_a) = libm::sincos(azimuth as f64 * std::f64::consts::TAU / AZIMUTHS as f64);
                    let (sin_e, cos_e) = libm::sincos(elevation.to_radians());
                    let eye = self.middle + distance * DVec3::new(cos_e * cos_a, cos_e * sin_a, sin_e);
                    places.extend(Pose::looking_at(eye, self.middle, DVec3::Z));
                }
            }
        }
        let mut rated: Vec<(f64, Pose<Base, Camera>)> = places
            .par_iter()
            .map_init(
                || Renderer::new(self.takes[0].footage.scene),
                |renderer, pose| self.shifted(renderer, pose),
            )
            .flatten()
            .collect();
        rated.sort_by(|a, b| b.0.total_cmp(&a.0));
        rated
    }

    /// The two best turns of a pose.
    fn shifted(&self, renderer: &mut Renderer<'_>, pose: &Pose<Base, Camera>) -> Vec<(f64, Pose<Base, Camera>)> {
        let camera_from_base = pose.inverse();
        let mut drawn = Vec::new();
        for links in &self.links {
            let camera_from_link: Vec<Pose<Camera, Link>> = links.iter().map(|&link| camera_from_base * link).collect();
            match renderer.render(&self.wide, &camera_from_link, &RenderOptions::default(), 1) {
                Ok(image) => drawn.push(image),
                Err(_) => return Vec::new(),
            }
        }
        let moved: Vec<Vec<f32>> = self
            .changes
            .iter()
            .map(|([a, b], _)| {
                let (a, b) = (&drawn[*a], &drawn[*b]);
                (0..a.link.len())
                    .map(|i| {
                        let both = a.link[i] != NO_LINK && b.link[i] != NO_LINK;
                        let differs = if both {
                            (a.depth_m[i] - b.depth_m[i]).abs() > MOVED_M
                        } else {
                            a.link[i] != b.link[i]
                        };
                        f32::from(u8::from(differs))
                    })
                    .collect()
            })
            .collect();
        let (width, height) = (self.lens.width as i32, self.lens.height as i32);
        let mut best: Vec<(f64, [i32; 2])> = Vec::new();
        let (right, bottom) = (self.wide.width as i32 - width, self.wide.height as i32 - height);
        for top in (0..=bottom).step_by(SHIFT_STEP as usize) {
            for left in (0..=right).step_by(SHIFT_STEP as usize) {
                let likeness = self.likeness(&moved, left, top);
                best.push((likeness, [left, top]));
            }
        }
        best.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let Some(&first) = best.first() else { return Vec::new() };
        let away = |other: &&(f64, [i32; 2])| {
            (other.1[0] - first.1[0]).abs() + (other.1[1] - first.1[1]).abs() > 3 * SHIFT_STEP
        };
        let second = best.iter().find(away).copied();
        [Some(first), second]
            .into_iter()
            .flatten()
            .map(|(likeness, [left, top])| {
                // What the wide image shows at the middle of the window goes to the middle of the image.
                let at = DVec2::new(f64::from(left + width / 2), f64::from(top + height / 2));
                let middle = DVec2::new(f64::from(width) / 2.0, f64::from(height) / 2.0);
                let from = self.wide.unproject(at, 1.0).normalize();
                let to = self.lens.unproject(middle, 1.0).normalize();
                // The turn that carries the direction `to` of the new camera to `from` of the old one.
                let turn: Pose<Camera, Camera> = Pose::new(carrying(to, from), DVec3::ZERO);
                (likeness, *pose * turn)
            })
            .collect()
    }

    /// Mean correlation of what should change with what does, the image being the window of the wide one at this place.
    fn likeness(&self, moved: &[Vec<f32>], left: i32, top: i32) -> f64 {
        let (width, height) = (self.lens.width as usize, self.lens.height as usize);
        let wide = self.wide.width as usize;
        let mut sum = 0.0;
        for (moved, (_, change)) in moved.iter().zip(&self.changes) {
            let (mut product, mut count) = (0.0f32, 0.0f32);
            for row in 0..height {
                let start = (row + top as usize) * wide + left as usize;
                let line = &moved[start..start + width];
                for (a, b) in line.iter().zip(&change[row * width..(row + 1) * width]) {
                    product += a * b;
                    count += a;
                }
            }
            // The change has mean 0 and length 1; of the mask with n ones of N its length less the mean is n - n^2 / N.
            let length = count - count * count / (width * height) as f32;
            if length > 4.0 {
                sum += f64::from(product / length.sqrt());
            }
        }
        sum / self.changes.len() as f64
    }
}

/// The rotation that carries one unit vector to another on the shortest way.
fn carrying(from: DVec3, to: DVec3) -> DMat3 {
    let axis = from.cross(to);
    let sine = axis.length();
    if sine < 1e-12 {
        return DMat3::IDENTITY;
    }
    rotation_about_axis(axis / sine, libm::atan2(sine, from.dot(to)))
}

/// Less the mean, to length 1.
fn normalise(values: &mut [f32]) {
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    values.iter_mut().for_each(|value| *value -= mean);
    let length = values.iter().map(|value| value * value).sum::<f32>().sqrt().max(1e-9);
    values.iter_mut().for_each(|value| *value /= length);
}

/// The mean place of the links that move by 2 cm or more; `None` where none does.
fn moving_middle(take: Take<'_>, links: &[Vec<Pose<Base, Link>>]) -> Option<DVec3> {
    let count = take.footage.model.links.len();
    let (mut sum, mut moving) = (DVec3::ZERO, 0.0);
    for link in 0..count {
        let places: Vec<DVec3> = links
            .iter()
            .filter_map(|poses| Some(poses.get(link)?.translation))
            .collect();
        let first = *places.first()?;
        if places.iter().any(|place| (*place - first).length() > 0.02) {
            sum += places.iter().sum::<DVec3>() / places.len() as f64;
            moving += 1.0;
        }
    }
    (moving > 0.0).then(|| sum / moving)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_direction_is_carried_to_another() {
        let (from, to) = (
            DVec3::new(0.2, -0.1, 1.0).normalize(),
            DVec3::new(-0.3, 0.4, 1.0).normalize(),
        );
        assert!((carrying(from, to) * from - to).length() < 1e-12);
        assert_eq!(carrying(from, from), DMat3::IDENTITY);
    }

    #[test]
    fn the_best_that_differ_are_kept() {
        let at = |x: f64| Correction {
            moved: Pose::from_translation(DVec3::X * x),
            ..Correction::NONE
        };
        let rated = [(0.9, at(0.0)), (0.8, at(0.01)), (0.7, at(0.3)), (0.6, at(0.9))];
        let kept = apart(&rated, 2, 0.1, 0.1);
        assert_eq!(kept.iter().map(|(rating, _)| *rating).collect::<Vec<f64>>(), [0.9, 0.7]);
    }
}
