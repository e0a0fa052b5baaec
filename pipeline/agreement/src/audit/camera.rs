//! One camera: what is supposed about it, and the verdict.

use rayon::prelude::*;
use rogs_geometry::Pinhole;
use rogs_robot::raster::Renderer;
use rogs_schemas::Intrinsics;

use super::footage::{Filmed, Footage, Mount};
use super::mistake::Mistake;
use super::states;
use super::trial::{Picture, Supposed, Trials};
use super::{CameraAudit, FITS, GAIN, SUSPECT_PX, Tried, Verdict};
use crate::Result;
use crate::agreement::{BLANK, FEWEST_PIXELS, Why, median};
use crate::measure::Settings;

/// Stereo baselines of the cameras that robots mostly carry, metres: ZED Mini and ZED 2.
const BASELINES_M: [f64; 2] = [0.063, 0.12];
/// Frames that images and states may be apart.
const LONGEST_DELAY: i64 = 5;
/// A pose off by less than both of these is suspect, not wrong: metres, radians.
const SMALL: [f64; 2] = [0.015, 0.02];
/// A simple mistake is preferred to a pose that is off by any amount when its overlay is less by no more than this.
const SIMPLER: f64 = 0.05;

/// The camera as the files say.
pub(super) fn given(camera: &Filmed<'_>) -> Supposed {
    Supposed {
        lens: camera.lens,
        mount: camera.mount.clone(),
        picture: Picture::AsIs,
        states: 0,
        delay: 0,
        drift: None,
    }
}

/// `count` frames, evenly from the first to the last.
pub(super) fn all_frames(frames: usize, count: usize) -> Vec<usize> {
    let count = count.clamp(1, frames.max(1));
    let mut chosen: Vec<usize> = (0..count)
        .map(|i| i * (frames.saturating_sub(1)) / (count - 1).max(1))
        .collect();
    chosen.dedup();
    chosen
}

/// What may be wrong with a camera of a clip, and the camera without it.
pub(super) fn suppositions_of(
    footage: &Footage<'_>,
    given: &[Supposed],
    index: usize,
    readings: &[Mistake],
) -> Vec<(usize, Mistake, Supposed)> {
    let own = &given[index];
    let mut out: Vec<(Mistake, Supposed)> = Vec::new();
    let with_mount = |mount: Mount| Supposed { mount, ..own.clone() };
    let inverted = match &own.mount {
        Mount::Fixed(pose) => Mount::Fixed(pose.inverse().relabelled()),
        Mount::Path(poses) => Mount::Path(poses.iter().map(|pose| pose.inverse().relabelled()).collect()),
        Mount::Hand { link, link_from_camera } => Mount::Hand {
            link: *link,
            link_from_camera: link_from_camera.inverse().relabelled(),
        },
    };
    out.push((Mistake::InvertedPose, with_mount(inverted)));
    let on_hand = matches!(own.mount, Mount::Hand { .. });
    for (other, camera) in given.iter().enumerate() {
        if other != index && !on_hand && !matches!(camera.mount, Mount::Hand { .. }) {
            let camera_name = footage.cameras[other].name.to_owned();
            out.push((
                Mistake::SwappedWith { camera: camera_name },
                with_mount(camera.mount.clone()),
            ));
        }
    }
    for right_m in BASELINES_M.into_iter().flat_map(|baseline| [baseline, -baseline]) {
        out.push((Mistake::OtherEye { right_m }, with_mount(beside(&own.mount, right_m))));
    }
    for (mistake, intrinsics) in other_intrinsics(&own.lens) {
        let lens = Pinhole { intrinsics, ..own.lens };
        out.push((mistake, Supposed { lens, ..own.clone() }));
    }
    let pictures = [
        (Mistake::Mirrored, Picture::Mirrored),
        (Mistake::UpsideDown, Picture::UpsideDown),
    ];
    let distorted = [-0.3, -0.2, -0.1, 0.1, 0.2, 0.3].map(|k1| (Mistake::Distortion { k1 }, Picture::Distorted(k1)));
    for (mistake, picture) in pictures.into_iter().chain(distorted) {
        out.push((mistake, Supposed { picture, ..own.clone() }));
    }
    if !on_hand {
        let of_readings = readings.iter().enumerate().map(|(reading, mistake)| {
            let states = reading + 1;
            (mistake.clone(), Supposed { states, ..own.clone() })
        });
        out.extend(of_readings);
    }
    out.into_iter()
        .map(|(mistake, supposed)| (index, mistake, supposed))
        .collect()
}

fn beside(mount: &Mount, right_m: f64) -> Mount {
    mount.moved(rogs_geometry::Pose::from_translation(glam::DVec3::X * right_m))
}

fn other_intrinsics(lens: &Pinhole) -> Vec<(Mistake, Intrinsics)> {
    let Intrinsics { fx, fy, cx, cy } = lens.intrinsics;
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let mut out = vec![(
        Mistake::TransposedIntrinsics,
        Intrinsics {
            fx: fy,
            fy: fx,
            cx: cy,
            cy: cx,
        },
    )];
    // The principal point lies near the middle of the images that the intrinsics belong to.
    let (sx, sy) = (0.5 * width / cx, 0.5 * height / cy);
    let off = |factor: f64| !(0.85..=1.18).contains(&factor);
    if sx.is_finite() && sy.is_finite() && sx > 0.0 && sy > 0.0 && (off(sx) || off(sy)) {
        let scaled = Intrinsics {
            fx: fx * sx,
            fy: fy * sy,
            cx: cx * sx,
            cy: cy * sy,
        };
        out.push((Mistake::UnscaledIntrinsics { width: width / sx }, scaled));
    }
    for factor in [0.5, 0.7, 0.85, 1.18, 1.42, 2.0] {
        let scaled = Intrinsics {
            fx: fx * factor,
            fy: fy * factor,
            cx,
            cy,
        };
        out.push((Mistake::FocalLength { factor }, scaled));
    }
    out
}

/// What is known of a camera so far.
pub(super) struct Found {
    name: String,
    on_hand: bool,
    overlay: f64,
    offset: Option<[f64; 3]>,
    /// Largest offset of any frame, pixels.
    worst_px: f64,
    why: Option<Why>,
    pub tried: Vec<Tried>,
    /// Overlays over the frames that delays are judged by: from `-reach` to `reach`.
    delays: Vec<f64>,
}

impl Found {
    /// Looks at the camera as the files say.
    pub(super) fn of_given(trials: &Trials<'_>, index: usize, given: &Supposed, frames: &[usize]) -> Self {
        let footage = trials.footage;
        let camera = &footage.cameras[index];
        let count = footage.frames();
        let mut renderer = Renderer::new(footage.scene);
        let settings = Settings::default();
        let (mut visible, mut blank) = (0, 0);
        for &frame in frames {
            if let Some(seen) = trials.look(&mut renderer, index, given, frame, &settings) {
                visible += usize::from(seen.measured.robot_pixels >= FEWEST_PIXELS);
                blank += usize::from(seen.measured.contrast < BLANK);
            }
        }
        let why = if 2 * blank > frames.len() {
            Some(Why::BlankImage)
        } else if 2 * visible < frames.len() {
            Some(Why::HardlyVisible)
        } else {
            None
        };
        let on_hand = matches!(camera.mount, Mount::Hand { .. });
        let reach = if on_hand {
            0
        } else {
            LONGEST_DELAY.min((count as i64 - 1) / 3)
        };
        let inner: Vec<usize> = (reach as usize..count.saturating_sub(reach as usize)).collect();
        let inner: Vec<usize> = all_frames(inner.len(), 6)
            .into_iter()
            .filter_map(|i| inner.get(i).copied())
            .collect();
        let delays = if why == Some(Why::BlankImage) || reach == 0 {
            Vec::new()
        } else {
            let delayed = |delay: i64| Supposed { delay, ..given.clone() };
            let all: Vec<(usize, Supposed)> = (-reach..=reach).map(|delay| (index, delayed(delay))).collect();
            all.par_iter()
                .map(|(camera, supposed)| trials.overlay(*camera, supposed, &inner, None))
                .collect()
        };
        let offsets: Vec<[f64; 3]> = trials
            .offsets(index, given, &all_frames(count, 7))
            .into_iter()
            .flatten()
            .collect();
        let middle = |i: usize| median(&mut offsets.iter().map(|offset| offset[i]).collect::<Vec<f64>>());
        Self {
            name: camera.name.to_owned(),
            on_hand,
            overlay: trials.overlay(index, given, frames, None),
            offset: (!offsets.is_empty()).then(|| [middle(0), middle(1), middle(2)]),
            worst_px: offsets.iter().map(|offset| offset[0]).fold(0.0, f64::max),
            why,
            tried: Vec::new(),
            delays,
        }
    }

    /// Whether nothing can be tried, for want of images.
    pub(super) fn is_blank(&self) -> bool {
        self.why == Some(Why::BlankImage)
    }

    fn best(&self) -> Option<&Tried> {
        let best = self.tried.iter().max_by(|a, b| a.overlay.total_cmp(&b.overlay))?;
        // Of equals the one tried first.
        self.tried.iter().find(|tried| tried.overlay >= best.overlay - 1e-12)
    }

    fn explained(&self) -> bool {
        self.best()
            .is_some_and(|best| best.overlay - self.overlay > GAIN && best.overlay > FITS)
    }

    /// Looks for a better pose, and for one that changes during the clip, where the camera is not good as it is.
    pub(super) fn refine(&mut self, trials: &Trials<'_>, index: usize, given: &Supposed, frames: &[usize]) {
        let good = self.offset.is_some_and(|offset| offset[0] < 0.8) && self.worst_px < 2.0;
        let gripper = |tried: &Tried| matches!(tried.mistake, Mistake::GripperSense | Mistake::GripperRange { .. });
        if self.why.is_some() || good || (self.explained() && self.best().is_some_and(gripper)) {
            return;
        }
        let (refined, [turn, step]) = trials.refine(index, given, frames);
        let (gone_m, turned) = (step.length(), turn.length());
        let mistake = if self.on_hand {
            Mistake::WrongHandEye { gone_m, turned }
        } else {
            Mistake::WrongPose { gone_m, turned }
        };
        let simple = self.best().map_or(f64::NEG_INFINITY, |best| best.overlay);
        let overlay = trials.overlay(index, &refined, frames, None);
        if overlay > simple + SIMPLER || !self.explained() {
            self.tried.push(Tried { mistake, overlay });
        }
        self.look_for_motion(trials, index, given);
    }

    /// A pose for the first frames and another for the last ones, at once or evenly.
    fn look_for_motion(&mut self, trials: &Trials<'_>, index: usize, given: &Supposed) {
        let count = trials.footage.frames();
        if count < 4 {
            return;
        }
        let seven = all_frames(count, 7);
        let (first, _) = trials.refine(index, given, &seven[..2]);
        let (last, [turn, step]) = trials.refine(index, given, &seven[seven.len() - 2..]);
        let drifting = Supposed {
            drift: Some([turn, step]),
            ..given.clone()
        };
        let overlays: Vec<[f64; 4]> = seven
            .par_iter()
            .map(|&frame| [given, &first, &last, &drifting].map(|s| trials.overlay(index, s, &[frame], None)))
            .collect();
        let mean = |of: &dyn Fn(usize, &[f64; 4]) -> f64| {
            overlays.iter().enumerate().map(|(i, o)| of(i, o)).sum::<f64>() / overlays.len() as f64
        };
        // One step between two poses; the best place for it.
        let stepped = (1..overlays.len())
            .flat_map(|at| [0, 1].map(|before| mean(&|i, o| if i < at { o[before] } else { o[2] })))
            .fold(f64::NEG_INFINITY, f64::max);
        let overlay = stepped.max(mean(&|_, o| o[3]));
        let still = [0, 1, 2]
            .map(|which| mean(&|_, o| o[which]))
            .into_iter()
            .fold(f64::NEG_INFINITY, f64::max);
        let best = self.best().map_or(self.overlay, |best| best.overlay).max(still);
        if overlay > best + 0.08 {
            let mistake = if self.on_hand {
                Mistake::WristDrift
            } else {
                Mistake::CameraMoved
            };
            self.tried.push(Tried { mistake, overlay });
        }
    }

    /// Sums up.
    pub(super) fn verdict(mut self) -> CameraAudit {
        let off = self
            .offset
            .filter(|offset| offset[0] > SUSPECT_PX && offset[0] > 3.0 * offset[1]);
        let best = self.best().cloned();
        let (verdict, mistake) = if self.why == Some(Why::BlankImage) {
            (Verdict::CannotTell, None)
        } else if self.explained() {
            let mistake = best.map(|best| best.mistake);
            let small = match &mistake {
                Some(Mistake::WrongPose { gone_m, turned } | Mistake::WrongHandEye { gone_m, turned }) => {
                    *gone_m < SMALL[0] && *turned < SMALL[1]
                }
                _ => false,
            };
            self.why = None;
            (if small { Verdict::Suspect } else { Verdict::Wrong }, mistake)
        } else if self.why.is_some() {
            (Verdict::CannotTell, None)
        } else if off.is_some() {
            let better = best.filter(|best| best.overlay > self.overlay + 0.04);
            (Verdict::Suspect, better.map(|best| best.mistake))
        } else if self.offset.is_none() || self.overlay < 0.05 {
            self.why = Some(Why::TooFewEdges);
            (Verdict::CannotTell, None)
        } else {
            (Verdict::Good, None)
        };
        self.tried.sort_by(|a, b| b.overlay.total_cmp(&a.overlay));
        self.tried.truncate(5);
        CameraAudit {
            camera: self.name,
            verdict,
            mistake,
            overlay: self.overlay,
            offset: self.offset,
            why: self.why.filter(|_| verdict == Verdict::CannotTell),
            tried: self.tried,
        }
    }
}

/// Suppositions about the states hold for all cameras that stand beside the robot, or for none.
pub(super) fn agree_on_states(found: &mut [Found]) {
    let beside: Vec<usize> = (0..found.len())
        .filter(|&i| !found[i].on_hand && !found[i].delays.is_empty())
        .collect();
    if let Some(&first) = beside.first() {
        let count = found[first].delays.len();
        let mean = |place: usize| beside.iter().map(|&i| found[i].delays[place]).sum::<f64>() / beside.len() as f64;
        let means: Vec<f64> = (0..count).map(mean).collect();
        let middle = count / 2;
        let best = (0..count)
            .max_by(|&a, &b| means[a].total_cmp(&means[b]))
            .unwrap_or(middle);
        if best != middle && means[best] - means[middle] > 0.5 * GAIN {
            // The parabola through the best place and its neighbours.
            let part = if best > 0 && best + 1 < count {
                let (a, b, c) = (means[best - 1], means[best], means[best + 1]);
                (0.5 * (a - c) / (a - 2.0 * b + c).min(-1e-9)).clamp(-0.5, 0.5)
            } else {
                0.0
            };
            let frames = best as f64 - middle as f64 + part;
            for &i in &beside {
                let overlay = found[i].overlay + found[i].delays[best] - found[i].delays[middle];
                found[i].tried.push(Tried {
                    mistake: Mistake::TimeOffset { frames },
                    overlay,
                });
            }
        }
    }

    let gain_of = |mistake: &Mistake| {
        let gains = found.iter().filter_map(|found| {
            let tried = found.tried.iter().find(|tried| tried.mistake == *mistake)?;
            Some(tried.overlay - found.overlay)
        });
        let gains: Vec<f64> = gains.collect();
        gains.iter().sum::<f64>() / gains.len().max(1) as f64
    };
    let of_states = |tried: &Tried| tried.mistake.is_of_states();
    let all: Vec<Mistake> = found
        .iter()
        .flat_map(|f| f.tried.iter().filter(|t| of_states(t)))
        .map(|t| t.mistake.clone())
        .collect();
    let refuted: Vec<Mistake> = all.into_iter().filter(|mistake| gain_of(mistake) < GAIN).collect();
    for found in found.iter_mut() {
        found.tried.retain(|tried| !refuted.contains(&tried.mistake));
    }
}

/// Looks at the fingers, in the cameras in which the robot lies on the images.
pub(super) fn look_at_gripper(footage: &Footage<'_>, given: &[Supposed], found: &mut [Found]) -> Result<()> {
    let (mistakes, tables) = states::grips(footage)?;
    let fingers = states::fingers(footage)?;
    if !fingers.contains(&true) {
        return Ok(());
    }
    let trials = Trials { footage, tables };
    let frames = all_frames(footage.frames(), 6);
    for (index, found) in found.iter_mut().enumerate() {
        if !found.on_hand || found.why.is_some() || found.best().is_some_and(|_| found.explained()) {
            continue;
        }
        let overlays: Vec<f64> = (0..trials.tables.len())
            .into_par_iter()
            .map(|states| {
                let supposed = Supposed {
                    states,
                    ..given[index].clone()
                };
                trials.overlay(index, &supposed, &frames, Some(&fingers))
            })
            .collect();
        for (mistake, overlay) in mistakes.iter().zip(&overlays[1..]) {
            found.tried.push(Tried {
                mistake: mistake.clone(),
                overlay: found.overlay + overlay - overlays[0],
            });
        }
    }
    Ok(())
}
