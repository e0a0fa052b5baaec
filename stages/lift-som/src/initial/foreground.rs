//! Tracks in space, and the rigid motions of their clusters.

use glam::{DMat3, DVec3};
use rogs_geometry::Pinhole;
use rogs_optimise::clusters::{k_means, point_weights};
use rogs_optimise::procrustes::rigid_motion;
use rogs_optimise::statistics::{lower_median, quantile};
use rogs_optimise::tracks::{Sight, TrackedFrame, lift_tracks};
use rogs_optimise::{MotionBases, six};
use rogs_worker::{StageError, StageResult};

use super::{cloud, draw, purpose};
use crate::internal;
use crate::observed::Observed;
use crate::params::LiftSomParams;
use crate::scene::Cloud;

/// Tracks farther from the middle than this quantile are left out.
const NEAR: f64 = 0.95;
/// Logit of a cluster at its own centre.
const OWN: f64 = 10.0;
/// A frame needs this much weight per frame of the clip, or it takes the motion of the frame before.
const LEAST_WEIGHT: f64 = 0.1;

/// Points on the robot with their places over time.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Followed {
    /// Frame in which the points are canonical.
    pub(crate) canonical: usize,
    /// Frames.
    pub(crate) frames: usize,
    /// Base frame, metres. `[N, T]`
    pub(crate) positions_m: Vec<DVec3>,
    /// `[N, T]`
    pub(crate) sights: Vec<Sight>,
    /// `[N]`
    pub(crate) colours: Vec<[f32; 3]>,
}

impl Followed {
    /// Lifts the tracks of every query frame, of each at most its share, and keeps those near the middle.
    pub(crate) fn of(observed: &Observed, params: &LiftSomParams, camera: u64) -> StageResult<Self> {
        let frames = observed.len();
        let most = (params.tracks as usize).div_ceil(frames);
        let lens: &Pinhole = &observed.lens;
        let tracked: Vec<TrackedFrame<'_>> = (observed.frames.iter())
            .map(|frame| TrackedFrame {
                camera: lens,
                base_from_camera: &frame.base_from_camera,
                depth: &frame.depth_m,
                mask: &frame.mask,
            })
            .collect();
        let mut all = Self {
            frames,
            ..Self::default()
        };
        for (query, tracks) in observed.tracks.iter().enumerate() {
            let count = tracks.len() / (4 * frames);
            let rows = draw(params, &[camera, purpose::TRACKS, query as u64]).sorted_sample(count as u32, most);
            let drawn: Vec<f32> = (rows.iter())
                .flat_map(|&row| &tracks[4 * frames * row as usize..4 * frames * (row as usize + 1)])
                .copied()
                .collect();
            let image = &observed.frames[query].image;
            let (height, width) = (observed.height, observed.width);
            let lifted = lift_tracks(&drawn, &tracked, query, image, height, width).map_err(internal)?;
            all.positions_m.extend(lifted.positions_m);
            all.sights.extend(lifted.sights);
            all.colours.extend(lifted.colours);
        }
        let visible = |frame: usize| {
            (0..all.colours.len())
                .filter(|n| all.sights[n * frames + frame].visible)
                .count()
        };
        let counts: Vec<usize> = (0..frames).map(visible).collect();
        all.canonical = (1..frames).fold(0, |best, frame| if counts[frame] > counts[best] { frame } else { best });
        let kept = all.near();
        if kept.is_empty() {
            return Err(StageError::bad_input(format!(
                "no track of camera `{}` lies inside its foreground mask",
                observed.id
            ))
            .with_hint("do the tracks belong to the images of this clip? the clip counts as failed"));
        }
        Ok(all.only(&kept))
    }

    /// Tracks that are seen at some frame and are not among those farthest from the middle.
    fn near(&self) -> Vec<usize> {
        let places: Vec<DVec3> = self.at(self.canonical).collect();
        let middle = median(places.iter().copied());
        let distances: Vec<f64> = places.iter().map(|place| place.distance(middle)).collect();
        let limit = quantile(&distances, NEAR).unwrap_or(0.0);
        let seen = |n: &usize| {
            self.sights[n * self.frames..(n + 1) * self.frames]
                .iter()
                .any(|sight| sight.visible)
        };
        (0..places.len())
            .filter(|&n| distances[n] <= limit)
            .filter(seen)
            .collect()
    }

    fn only(&self, kept: &[usize]) -> Self {
        let rows = |n: &usize| n * self.frames..(n + 1) * self.frames;
        Self {
            canonical: self.canonical,
            frames: self.frames,
            positions_m: kept
                .iter()
                .flat_map(|n| self.positions_m[rows(n)].iter().copied())
                .collect(),
            sights: kept.iter().flat_map(|n| self.sights[rows(n)].iter().copied()).collect(),
            colours: kept.iter().map(|&n| self.colours[n]).collect(),
        }
    }

    /// Number of points.
    pub(crate) fn len(&self) -> usize {
        self.colours.len()
    }

    fn at(&self, frame: usize) -> impl Iterator<Item = DVec3> {
        self.positions_m.iter().skip(frame).step_by(self.frames).copied()
    }

    /// Gaussians at the canonical places, turned at random.
    pub(crate) fn cloud(&self, params: &LiftSomParams, camera: u64) -> Cloud {
        let mut random = draw(params, &[camera, purpose::ROTATIONS]);
        let points: Vec<DVec3> = self.at(self.canonical).collect();
        let quats = (0..4 * points.len()).map(|_| random.next_double() as f32).collect();
        cloud(&points, &self.colours, quats)
    }

    /// Logits of the mixture and the rigid motions: one for every cluster of points that move alike.
    pub(crate) fn motion(&self, observed: &Observed, params: &LiftSomParams) -> StageResult<(Vec<f32>, MotionBases)> {
        let width = 3 * self.frames.saturating_sub(1);
        let rows: Vec<f32> = (0..self.len()).flat_map(|n| self.directions(n)).collect();
        let labels = if width == 0 {
            vec![0; self.len()]
        } else {
            k_means(&rows, width, params.clusters as usize).0
        };
        let members = |label: u32| -> Vec<usize> { (0..self.len()).filter(|&n| labels[n] == label).collect() };
        let clusters: Vec<Vec<usize>> = (0..params.clusters)
            .map(members)
            .filter(|members| !members.is_empty() && members.len() > params.smallest_cluster as usize)
            .collect();
        if clusters.is_empty() {
            return Err(StageError::bad_input(format!(
                "no cluster of the {} tracks of camera `{}` has more than {} points",
                self.len(),
                observed.id,
                params.smallest_cluster
            ))
            .with_hint("the robot is small or hardly followed in this camera; the clip counts as failed"));
        }
        let canonical: Vec<DVec3> = self.at(self.canonical).collect();
        let centres: Vec<DVec3> = (clusters.iter())
            .map(|members| median(members.iter().map(|&n| canonical[n])))
            .collect();
        let logit = |place: &DVec3, centre: &DVec3| (OWN * libm::exp(-place.distance(*centre))) as f32;
        let coefficients = canonical
            .iter()
            .flat_map(|place| centres.iter().map(move |centre| logit(place, centre)))
            .collect();
        let mut bases = MotionBases {
            frames: self.frames,
            ..MotionBases::default()
        };
        for members in &clusters {
            for (turn, shift) in self.rigid(members) {
                bases.rotations.extend(six::six(&turn).map(|value| value as f32));
                bases.translations.extend(shift.as_vec3().to_array());
            }
        }
        Ok((coefficients, bases))
    }

    /// Directions of the steps of a point from frame to frame, places in between filled in where it is not seen. `[3 (T - 1)]`
    fn directions(&self, n: usize) -> Vec<f32> {
        let rows = n * self.frames..(n + 1) * self.frames;
        let places = filled(&self.positions_m[rows.clone()], &self.sights[rows]);
        let steps = places.windows(2).map(|pair| pair[1] - pair[0]);
        steps
            .flat_map(|step| (step / (step.length() + 1e-5)).as_vec3().to_array())
            .collect()
    }

    /// Motion of a cluster from the canonical frame to every frame.
    fn rigid(&self, members: &[usize]) -> Vec<(DMat3, DVec3)> {
        let of = |frame: usize| -> Vec<DVec3> {
            members
                .iter()
                .map(|n| self.positions_m[n * self.frames + frame])
                .collect()
        };
        let sights = |frame: usize| members.iter().map(move |n| self.sights[n * self.frames + frame]);
        let points: Vec<Vec<DVec3>> = (0..self.frames).map(of).collect();
        let visible: Vec<Vec<bool>> = (0..self.frames)
            .map(|frame| sights(frame).map(|sight| sight.visible).collect())
            .collect();
        let weights = point_weights(&points, &visible);
        let canonical = self.canonical;
        let mut motions = vec![(DMat3::IDENTITY, DVec3::ZERO); self.frames];
        let mut before = canonical;
        for frame in (0..canonical).rev().chain(canonical..self.frames) {
            let sure = sights(canonical).zip(sights(frame));
            let sure = sure.map(|(a, b)| (f64::from(a.confidence) + f64::from(b.confidence)) / 2.0);
            let pair: Vec<f64> = (weights[canonical].iter().zip(&weights[frame]).zip(sure))
                .map(|((a, b), sure)| a * b * sure)
                .collect();
            let enough = pair.iter().sum::<f64>() >= LEAST_WEIGHT * self.frames as f64;
            let found = if enough {
                rigid_motion(&points[canonical], &points[frame], &pair)
            } else {
                None
            };
            motions[frame] = found.unwrap_or(motions[before]);
            before = frame;
        }
        motions
    }
}

/// Medians of the coordinates, each the lower of two.
fn median(places: impl Iterator<Item = DVec3> + Clone) -> DVec3 {
    let axis = |axis: usize| {
        let values: Vec<f64> = places.clone().map(|place| place[axis]).collect();
        lower_median(&values).unwrap_or(0.0)
    };
    DVec3::new(axis(0), axis(1), axis(2))
}

/// Places with those at which a point is not seen put between its neighbours in time; before the first and after the last
/// they are these.
fn filled(places: &[DVec3], sights: &[Sight]) -> Vec<DVec3> {
    let seen: Vec<usize> = (0..places.len()).filter(|&frame| sights[frame].visible).collect();
    let place = |frame: usize| {
        let after = seen.partition_point(|&known| known < frame);
        match (after.checked_sub(1).map(|before| seen[before]), seen.get(after)) {
            (_, Some(&next)) if next == frame => places[frame],
            (Some(last), Some(&next)) => places[last].lerp(places[next], (frame - last) as f64 / (next - last) as f64),
            (Some(last), None) => places[last],
            (None, Some(&next)) => places[next],
            (None, None) => places[frame],
        }
    };
    (0..places.len()).map(place).collect()
}

#[cfg(test)]
mod tests {
    use rogs_geometry::rotation_about_axis;

    use super::*;

    const SEEN: Sight = Sight {
        visible: true,
        invisible: false,
        confidence: 0.9,
    };

    #[test]
    fn what_is_not_seen_lies_between_what_is() {
        let places: Vec<DVec3> = [9.0, 1.0, 9.0, 9.0, 4.0, 9.0].map(|x| DVec3::new(x, 0.0, 0.0)).to_vec();
        let sights: Vec<Sight> = [false, true, false, false, true, false]
            .map(|visible| Sight { visible, ..SEEN })
            .to_vec();
        let found: Vec<f64> = filled(&places, &sights).iter().map(|place| place.x).collect();
        assert_eq!(found, [1.0, 1.0, 2.0, 3.0, 4.0, 4.0]);
    }

    #[test]
    fn a_cluster_moves_as_its_points_do() {
        let frames = 5;
        let at = |frame: usize| {
            let turn = rotation_about_axis(DVec3::new(0.3, 1.0, 0.2).normalize(), 0.2 * (frame as f64 - 2.0));
            (turn, DVec3::new(0.1, -0.05, 0.02) * (frame as f64 - 2.0))
        };
        let point = |n: usize| {
            let number = |step: usize| (n * step % 101) as f64 / 101.0 - 0.5;
            DVec3::new(number(17), number(31), number(73))
        };
        let mut followed = Followed {
            canonical: 2,
            frames,
            colours: vec![[0.5; 3]; 60],
            ..Followed::default()
        };
        for n in 0..60 {
            for frame in 0..frames {
                let (turn, shift) = at(frame);
                followed.positions_m.push(turn * point(n) + shift);
                // Nobody is seen at the first frame: it takes the motion of the second.
                followed.sights.push(if frame == 0 { Sight::default() } else { SEEN });
            }
        }
        let found = followed.rigid(&(0..60).collect::<Vec<_>>());
        for (frame, (turn, shift)) in found.iter().enumerate() {
            let (expected, to) = at(frame.max(1));
            assert!(
                turn.abs_diff_eq(expected, 1e-9) && shift.abs_diff_eq(to, 1e-9),
                "{frame}"
            );
        }
    }
}
