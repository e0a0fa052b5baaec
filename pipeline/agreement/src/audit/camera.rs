//! One camera: what is supposed about it, and the verdict.

use rayon::prelude::*;

use super::footage::{Filmed, Mount, evenly};
use super::hand;
use super::mistake::Mistake;
use super::trial::{Picture, Supposed, Trials};
use super::watch::Watched;
use super::{CameraAudit, FITS, GAIN, SUSPECT_PX, Tried, Verdict};
use crate::agreement::{Why, median};

/// A pose off by less than both of these is suspect, not wrong: metres, radians.
const SMALL: [f64; 2] = [0.015, 0.02];
/// A simple mistake is preferred to a pose that is off by any amount when its overlay is less by no more than this.
const SIMPLER: f64 = 0.05;
/// A hand-eye pose that a search over many found needs this overlay: the best of many is good by chance.
const FOUND: f64 = 0.35;
/// An overlay above this is that of a robot in its place.
const CLEAR: f64 = 0.6;
/// Below this the robot does not lie on the images, whatever the offset says.
const LEAST: f64 = 0.12;
/// A pose that moves against the hand by less is none: metres, radians.
const MOVES: [f64; 2] = [0.008, 0.02];
/// Smaller lags are not called a mistake, frames.
pub(super) const LAGS: f64 = 0.75;

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

/// What is known of a camera so far.
pub(super) struct Found {
    name: String,
    pub on_hand: bool,
    /// Overlay as the files say.
    pub overlay: f64,
    offset: Option<[f64; 3]>,
    /// The offset that 85 % of the frames stay below, pixels.
    worst_px: f64,
    edges_px: f64,
    pub why: Option<Why>,
    /// Lag and its standard deviation, frames.
    pub lag: Option<[f64; 2]>,
    /// Whether images and states are apart in time beyond doubt.
    pub late: bool,
    pub tried: Vec<Tried>,
}

impl Found {
    /// What watching the camera told; `overlay` is that as the files say.
    pub(super) fn new(camera: &Filmed<'_>, watched: Watched, overlay: f64) -> Self {
        let Watched {
            why,
            offsets,
            edges_px,
            following,
        } = watched;
        let middle = |i: usize| median(&mut offsets.iter().map(|offset| offset[i]).collect::<Vec<f64>>());
        let mut lengths: Vec<f64> = offsets.iter().map(|offset| offset[0]).collect();
        lengths.sort_by(f64::total_cmp);
        Self {
            name: camera.name.to_owned(),
            on_hand: matches!(camera.mount, Mount::Hand { .. }),
            overlay,
            offset: (!offsets.is_empty()).then(|| [middle(0), middle(1), middle(2)]),
            worst_px: lengths.get(lengths.len() * 17 / 20).copied().unwrap_or(0.0),
            edges_px,
            why,
            lag: following.lag_frames,
            late: false,
            tried: Vec::new(),
        }
    }

    /// Whether nothing can be tried, for want of images.
    pub(super) fn is_blank(&self) -> bool {
        self.why == Some(Why::BlankImage)
    }

    /// Whether the robot lies on the images so well that nothing need be tried.
    pub(super) fn is_good(&self) -> bool {
        let near = self.offset.is_some_and(|offset| offset[0] < 0.8);
        let in_time = self.lag.is_none_or(|[lag, sigma]| lag.abs() < LAGS.max(4.0 * sigma));
        self.why.is_none() && in_time && near && self.worst_px < 1.6 && self.edges_px < 0.8 && self.overlay > 0.3
    }

    pub(super) fn best(&self) -> Option<&Tried> {
        let best = self.tried.iter().max_by(|a, b| a.overlay.total_cmp(&b.overlay))?;
        // Of equals the one tried first.
        self.tried.iter().find(|tried| tried.overlay >= best.overlay - 1e-12)
    }

    pub(super) fn explained(&self) -> bool {
        self.best()
            .is_some_and(|best| best.overlay - self.overlay > GAIN && best.overlay > FITS)
    }

    /// Whether a supposition puts the robot so clearly on the images that no pose need be sought.
    pub(super) fn is_clear(&self) -> bool {
        (self.explained() || self.late) && self.best().is_some_and(|best| best.overlay > CLEAR)
    }

    /// Whether the best supposition is about the joint values.
    pub(super) fn best_is_of_joints(&self) -> bool {
        self.best().is_some_and(|best| best.mistake.is_of_joints())
    }

    /// Whether the best supposition is about the gripper.
    pub(super) fn best_is_of_gripper(&self) -> bool {
        let of_gripper = |mistake: &Mistake| matches!(mistake, Mistake::GripperSense | Mistake::GripperRange { .. });
        self.best().is_some_and(|best| of_gripper(&best.mistake))
    }

    /// Looks for a better pose, and for one that changes during the clip.
    pub(super) fn refine(&mut self, trials: &Trials<'_>, index: usize, given: &Supposed, frames: &[usize]) {
        let good = self.offset.is_some_and(|offset| offset[0] < 0.8) && self.worst_px < 2.0;
        if self.on_hand || self.why.is_some() || good {
            return;
        }
        let (refined, [turn, step]) = trials.refine(index, given, frames);
        let (gone_m, turned) = (step.length(), turn.length());
        let simple = self.best().map_or(f64::NEG_INFINITY, |best| best.overlay);
        let each: Vec<f64> = frames
            .par_iter()
            .map(|&frame| trials.overlay(index, &refined, &[frame], None))
            .collect();
        let overlay = each.iter().sum::<f64>() / each.len().max(1) as f64;
        if overlay > simple + SIMPLER || !self.explained() {
            self.tried.push(Tried {
                mistake: Mistake::WrongPose { gone_m, turned },
                overlay,
            });
        }
        // One pose that fits all frames alike leaves nothing to a motion.
        let [least, most] = [f64::min, f64::max].map(|of| each.iter().copied().reduce(of).unwrap_or(0.0));
        if least < 0.7 * most {
            self.look_for_motion(trials, index, given);
        }
    }

    /// A pose for the first frames and another for the last ones, at once or evenly.
    fn look_for_motion(&mut self, trials: &Trials<'_>, index: usize, given: &Supposed) {
        let count = trials.footage.frames();
        if count < 4 {
            return;
        }
        let seven = evenly(count, 7);
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
            self.tried.push(Tried {
                mistake: Mistake::CameraMoved,
                overlay,
            });
        }
    }

    /// Looks for another pose on the hand, and for one that moves against it. `steady` and `half` hold steady images.
    pub(super) fn look_at_hand(
        &mut self,
        trials: &Trials<'_>,
        steady: &Trials<'_>,
        half: &Trials<'_>,
        index: usize,
        given: &Supposed,
    ) {
        // A pose that is fitted to each frame fits better, also where the hand lies on its images.
        let near = self.offset.is_some_and(|offset| offset[0] < SUSPECT_PX);
        if !self.on_hand || self.is_blank() || (self.why.is_none() && near) {
            return;
        }
        let moving = hand::followed(trials, index, given);
        let [turn, step] = moving.by;
        let moves = step.length() > MOVES[0] || turn.length() > MOVES[1];
        let drifts = moves && moving.overlay > GAIN;
        if drifts {
            self.tried.push(Tried {
                mistake: Mistake::WristDrift,
                overlay: self.overlay + moving.overlay,
            });
        }
        let best = self.best().map_or(self.overlay, |best| best.overlay);
        if let Some(elsewhere) = hand::search(steady, half, index, given) {
            let [turn, step] = elsewhere.by;
            let (gone_m, turned) = (step.length(), turn.length());
            let far = gone_m > SMALL[0] || turned > SMALL[1];
            if (elsewhere.overlay > FOUND || !far) && elsewhere.overlay > best + SIMPLER {
                self.tried.push(Tried {
                    mistake: Mistake::WrongHandEye { gone_m, turned },
                    overlay: elsewhere.overlay,
                });
            }
        }
    }

    /// Sums up.
    pub(super) fn verdict(mut self) -> CameraAudit {
        let off = self
            .offset
            .filter(|offset| offset[0] > SUSPECT_PX && offset[0] > 3.0 * offset[1]);
        let best = self.best().cloned();
        let late = self
            .tried
            .iter()
            .find(|tried| matches!(tried.mistake, Mistake::TimeOffset { .. }));
        let late = late.filter(|_| self.late).cloned();
        let (verdict, mistake) = if self.why == Some(Why::BlankImage) {
            (Verdict::CannotTell, None)
        } else if self.explained() {
            // The offset in time is known from the motion itself: a pose must explain clearly more.
            let best = match (late, best) {
                (Some(late), Some(best)) if late.overlay > best.overlay - 2.0 * SIMPLER => Some(late),
                (_, best) => best,
            };
            let mistake = best.map(|best| best.mistake);
            let small = match &mistake {
                Some(Mistake::WrongPose { gone_m, turned } | Mistake::WrongHandEye { gone_m, turned }) => {
                    *gone_m < SMALL[0] && *turned < SMALL[1]
                }
                _ => false,
            };
            self.why = None;
            (if small { Verdict::Suspect } else { Verdict::Wrong }, mistake)
        } else if let Some(late) = late {
            self.why = None;
            (Verdict::Suspect, Some(late.mistake))
        } else if self.why.is_some() {
            (Verdict::CannotTell, None)
        } else if off.is_some() {
            let better = best.filter(|best| best.overlay > self.overlay + 0.04 && best.overlay > FITS);
            (Verdict::Suspect, better.map(|best| best.mistake))
        } else if self.offset.is_none() || self.overlay < LEAST {
            self.why = Some(Why::TooFewEdges);
            (Verdict::CannotTell, None)
        } else {
            (Verdict::Good, None)
        };
        self.tried.sort_by(|a, b| b.overlay.total_cmp(&a.overlay));
        self.tried.truncate(5);
        if let Some(mistake) = mistake
            .as_ref()
            .filter(|own| self.tried.iter().all(|tried| tried.mistake != **own))
        {
            let overlay = self.overlay;
            self.tried.push(Tried {
                mistake: mistake.clone(),
                overlay,
            });
        }
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
