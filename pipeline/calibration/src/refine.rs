//! From a camera that is off by some to the one that fits (`docs/spec/calibration.md` section 4).

use rogs_agreement::Why;
use rogs_agreement::audit::Mount;
use rogs_geometry::Pinhole;

use crate::correction::{Correction, Prior, UNKNOWNS, Vector};
use crate::edges::{Edge, Level, Look};
use crate::epipolar::Pairs;
use crate::outline::Mixing;
use crate::solve::{Solved, minimise, weighted_median};
use crate::take::{Take, chosen_frames};
use crate::{Error, Result};

/// Offsets are judged within this distance of the drawn contour, pixels of 320 image columns.
const JUDGED_PX: f64 = 12.0;
/// Fewest edges that a pose is solved from.
const FEWEST_EDGES: usize = 40;
/// Fewest matches that tell something of a camera on the hand.
const FEWEST_MATCHES: usize = 60;
/// A camera that overlays less than this is sought from other starts too.
const SURE: f64 = 0.5;
/// Images are looked at with no more columns than this.
const FINEST: u32 = 640;
/// Along the path of a hand's camera, points keep so near to their epipolar lines, pixels of 320 image columns.
const ALONG_PX: f64 = 1.0;
/// A refined camera that overlays less than this has not been found.
const FOUND: f64 = 0.12;

/// How a camera is refined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// What is free, and how far it is likely to be off.
    pub prior: Prior,
    /// Most frames that are looked at, over all clips.
    pub frames: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            prior: Prior::POSE,
            frames: 32,
        }
    }
}

/// How well a camera fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Median distance of the images' edges from the drawn contours, within 12 pixels of 320 columns.
    pub edge_px: f64,
    /// Share of the silhouette with its edge at the predicted place, beyond chance (`docs/spec/agreement.md` section 3).
    pub overlay: f64,
    /// Median distance of tracked points from their epipolar lines, pixels; cameras on the hand only.
    pub epipolar_px: Option<f64>,
}

/// A calibrated camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Refined {
    /// Difference from the given camera.
    pub correction: Correction,
    /// Standard deviations of the unknowns, in the camera's own frame as it stands now; 0 for those as given.
    pub sigma: Vector,
    /// Their covariance.
    pub covariance: [[f64; UNKNOWNS]; UNKNOWNS],
    /// The lens.
    pub lens: Pinhole,
    /// The pose.
    pub mount: Mount,
    /// How the given camera fits.
    pub before: Fit,
    /// How this one does.
    pub after: Fit,
    /// Frames looked at.
    pub frames: usize,
    /// Pairs of places of tracked points that it was solved from; 0 for fixed cameras.
    pub matches: usize,
}

/// Refines a camera that all takes have in common: one lens, one pose, one clock.
///
/// # Errors
/// What the images cannot tell, or what does not fit together.
pub fn refine(takes: &[Take<'_>], settings: &Settings) -> Result<Refined> {
    check(takes)?;
    let frames = chosen_frames(takes, settings.frames);
    let full = Level::new(takes, &frames, factor(&takes[0].filmed().lens, FINEST));
    let given = full.look(&Correction::NONE, &judging(&full))?;
    if given.frames < 2 {
        return Err(Error::TooFewFrames { frames: given.frames });
    }
    if 2 * given.blank > given.frames {
        return Err(Error::CannotTell { why: Why::BlankImage });
    }
    if matches!(takes[0].filmed().mount, Mount::Hand { .. }) {
        return refine_on_hand(takes, &frames, &full, &given, &settings.prior);
    }
    if 4 * given.visible < given.frames || given.visible < 2 {
        return Err(Error::CannotTell {
            why: Why::HardlyVisible,
        });
    }
    let mut starts = vec![Correction::NONE];
    let mut best: Option<(Solved, Look)> = None;
    while let Some(start) = starts.pop() {
        if let Ok(solved) = converge(takes, &frames, &full, &settings.prior, start) {
            let found = full.look(&solved.correction, &judging(&full))?;
            if best.as_ref().is_none_or(|(_, best)| found.overlay > best.overlay) {
                best = Some((solved, found));
            }
        }
        let sure = best.as_ref().is_some_and(|(_, best)| best.overlay >= SURE);
        if start == Correction::NONE && !sure {
            starts = around(takes, &frames, &settings.prior)?;
        }
    }
    match best {
        Some((solved, found)) if found.overlay >= FOUND => Ok(summed_up(takes, solved, &given, &found)),
        Some((_, found)) => Err(Error::NotFound { overlay: found.overlay }),
        None => Err(Error::CannotTell { why: Why::TooFewEdges }),
    }
}

/// Starts around the given one, turned by about the prior's standard deviation, solved on small images: the best three.
fn around(takes: &[Take<'_>], frames: &[(usize, usize)], prior: &Prior) -> Result<Vec<Correction>> {
    let few: Vec<(usize, usize)> = frames.iter().step_by(frames.len().div_ceil(6)).copied().collect();
    let small = Level::new(takes, &few, factor(&takes[0].filmed().lens, 180));
    let settings = rogs_agreement::Settings {
        inner: false,
        ..rogs_agreement::Settings::of_range(8.0)
    };
    let pose = Prior {
        focal: None,
        principal: None,
        lag_frames: None,
        ..*prior
    };
    let mut rated: Vec<(f64, Correction)> = Vec::new();
    for number in 0..27 {
        let part = |divisor: i32| 0.7 * prior.turn * f64::from(number / divisor % 3 - 1);
        let mut step = [0.0; UNKNOWNS];
        step[..3].copy_from_slice(&[part(1), part(3), part(9)]);
        let start = Correction::NONE.stepped(&step);
        if let Ok(near) = near(&small, &pose, start) {
            rated.push((small.look(&near, &settings)?.overlay, near));
        }
    }
    rated.sort_by(|a, b| b.0.total_cmp(&a.0));
    Ok(rated.into_iter().take(3).map(|(_, correction)| correction).collect())
}

/// A camera on the hand: points of the scene along its path, and the edges of the gripper, which look the same in all
/// images and so count as one image together.
fn refine_on_hand(
    takes: &[Take<'_>],
    frames: &[(usize, usize)],
    full: &Level<'_>,
    given: &Look,
    prior: &Prior,
) -> Result<Refined> {
    let pairs = Pairs::new(takes, factor(&takes[0].filmed().lens, FINEST), prior.turn)?;
    if pairs.len() < FEWEST_MATCHES && 4 * given.visible < given.frames {
        return Err(Error::CannotTell {
            why: Why::HardlyVisible,
        });
    }
    let path = Path {
        pairs: &pairs,
        free: prior.sigmas().map(|sigma| sigma.is_some()),
        share: 1.0 / given.visible.max(1) as f64,
    };
    let solve = |start: Correction| -> Result<(Solved, Look)> {
        let start = Solved {
            correction: start,
            covariance: [[0.0; UNKNOWNS]; UNKNOWNS],
        };
        let near = rounds(full, &[16.0, 12.0, 8.0, 6.0, 4.0], prior, start, Some(&path))?;
        let best = outlines(full, prior, near, Some(&path))?;
        let found = full.look(&best.correction, &judging(full))?;
        Ok((best, found))
    };
    let epipolar = |correction: &Correction| {
        let distances = pairs.distances(correction);
        let mut sizes: Vec<(f64, f64)> = distances.into_iter().map(|distance| (distance.abs(), 1.0)).collect();
        (!sizes.is_empty()).then(|| weighted_median(&mut sizes))
    };
    // Where the gripper does not lie on the images, points along the path alone can tell.
    let keeps = ALONG_PX * f64::from(full.lens.width) / 320.0;
    let lost = |solved: &Solved, look: &Look| {
        let along = pairs.len() >= FEWEST_MATCHES && epipolar(&solved.correction).is_some_and(|px| px < keeps);
        look.overlay < FOUND && !along
    };
    let (mut best, mut found) = solve(Correction::NONE)?;
    if lost(&best, &found) && 4 * given.visible >= given.frames {
        for start in around(takes, frames, prior)? {
            let (other, look) = solve(start)?;
            if look.overlay > found.overlay {
                (best, found) = (other, look);
            }
        }
    }
    if lost(&best, &found) {
        return Err(Error::NotFound { overlay: found.overlay });
    }
    let after = epipolar(&best.correction);
    let mut refined = summed_up(takes, best, given, &found);
    refined.before.epipolar_px = epipolar(&Correction::NONE);
    refined.after.epipolar_px = after;
    refined.matches = pairs.len();
    Ok(refined)
}

/// What counts beside the edges of a camera on the hand.
struct Path<'a> {
    /// Points along its path.
    pairs: &'a Pairs,
    /// Which unknowns are free.
    free: [bool; UNKNOWNS],
    /// Share of their weight with which edges count.
    share: f64,
}

/// Solves for these edges, and for what counts beside them.
fn solved(
    level: &Level<'_>,
    edges: &[Edge],
    range: f64,
    prior: &Prior,
    start: Correction,
    path: Option<&Path<'_>>,
) -> Option<Solved> {
    minimise(start, prior, range / 3.0, 12, |correction| {
        let mut rows = level.rows(edges, correction, path.map_or(1.0, |path| path.share))?;
        if let Some(path) = path {
            rows.extend(path.pairs.rows(correction, &path.free));
        }
        Some(rows)
    })
}

/// Whether the takes are of one camera.
pub(crate) fn check(takes: &[Take<'_>]) -> Result<()> {
    let wrong = |what: &str| Err(Error::Input { what: what.to_owned() });
    let Some(first) = takes.first() else {
        return wrong("expected at least one clip");
    };
    for take in takes {
        take.footage.check()?;
        let Some(filmed) = take.footage.cameras.get(take.camera) else {
            return wrong("a clip lacks the camera");
        };
        if matches!(filmed.mount, Mount::Path(_)) {
            return Err(Error::PoseOfEveryFrame);
        }
        if filmed.lens != first.filmed().lens || filmed.mount != first.filmed().mount {
            return wrong("the clips start from different cameras");
        }
    }
    Ok(())
}

/// The factor by which images shrink to at most `columns` columns.
pub(crate) fn factor(lens: &Pinhole, columns: u32) -> u32 {
    lens.width.div_ceil(columns).max(1)
}

/// The search that fits are judged by.
pub(crate) fn judging(level: &Level<'_>) -> rogs_agreement::Settings {
    rogs_agreement::Settings::of_range(JUDGED_PX * (f64::from(level.lens.width) / 320.0).max(0.75))
}

/// Solves from coarse images and wide searches to fine and narrow ones.
pub(crate) fn converge(
    takes: &[Take<'_>],
    frames: &[(usize, usize)],
    full: &Level<'_>,
    prior: &Prior,
    start: Correction,
) -> Result<Solved> {
    let lens = takes[0].filmed().lens;
    let coarse = factor(&lens, 180);
    let middle = factor(&lens, 360);
    // Not all frames are needed to come near.
    let few: Vec<(usize, usize)> = frames.iter().step_by(frames.len().div_ceil(10)).copied().collect();
    let pose = Prior {
        focal: None,
        principal: None,
        lag_frames: None,
        ..*prior
    };
    let mut best = Solved {
        correction: start,
        covariance: [[0.0; UNKNOWNS]; UNKNOWNS],
    };
    let small = Level::new(takes, &few, coarse);
    best = rounds(&small, &[24.0, 24.0, 16.0, 12.0, 8.0], &pose, best, None)?;
    if middle < coarse {
        let level = Level::new(takes, &few, middle);
        best = rounds(&level, &[12.0, 8.0], &pose, best, None)?;
    }
    best = rounds(full, &[12.0, 8.0, 6.0, 4.0], prior, best, None)?;
    outlines(full, prior, best, None)
}

/// Solves by the silhouettes alone, to a small part of a pixel.
fn outlines(level: &Level<'_>, prior: &Prior, start: Solved, path: Option<&Path<'_>>) -> Result<Solved> {
    let mut best = start;
    let mut mixing = Mixing::Light;
    for (round, range) in [3.0, 2.0, 1.5, 1.0, 1.0].into_iter().enumerate() {
        if round == 2 {
            mixing = level.mixing(&best.correction, range)?;
        }
        let edges = level.outline(&best.correction, mixing, range)?;
        if edges.len() < FEWEST_EDGES {
            // Too small or too blurred: the edges have to do.
            return rounds(level, &[4.0, 4.0], prior, best, path);
        }
        if let Some(solved) = solved(level, &edges, range, prior, best.correction, path) {
            best = solved;
        }
    }
    Ok(best)
}

/// Comes near from a rough start, on one level of small images.
pub(crate) fn near(level: &Level<'_>, prior: &Prior, start: Correction) -> Result<Correction> {
    let start = Solved {
        correction: start,
        covariance: [[0.0; UNKNOWNS]; UNKNOWNS],
    };
    Ok(rounds(level, &[16.0, 12.0, 12.0, 8.0, 6.0], prior, start, None)?.correction)
}

fn rounds(level: &Level<'_>, ranges: &[f64], prior: &Prior, start: Solved, path: Option<&Path<'_>>) -> Result<Solved> {
    let mut best = start;
    for &range in ranges {
        let settings = rogs_agreement::Settings::of_range(range);
        let Look { edges, .. } = level.look(&best.correction, &settings)?;
        if edges.len() + path.map_or(0, |path| path.pairs.len()) < FEWEST_EDGES {
            return Err(Error::CannotTell { why: Why::TooFewEdges });
        }
        if let Some(solved) = solved(level, &edges, range, prior, best.correction, path) {
            best = solved;
        }
    }
    Ok(best)
}

fn fit(look: &Look) -> Fit {
    Fit {
        edge_px: weighted_median(&mut look.offsets.clone()),
        overlay: look.overlay,
        epipolar_px: None,
    }
}

fn summed_up(takes: &[Take<'_>], solved: Solved, given: &Look, found: &Look) -> Refined {
    let filmed = takes[0].filmed();
    let covariance = solved.covariance;
    Refined {
        sigma: std::array::from_fn(|i| covariance[i][i].max(0.0).sqrt()),
        covariance,
        lens: solved.correction.lens(&filmed.lens),
        mount: filmed.mount.moved(solved.correction.moved),
        before: fit(given),
        after: fit(found),
        frames: given.frames,
        matches: 0,
        correction: solved.correction,
    }
}
