//! Numbers of Gaussians as bins of grids. Errors are half a pitch; the pitches stand in the file.

use rayon::prelude::*;

use super::records::{Bytes, stream};
use super::{CUTOFF, GAUSSIAN_ID};
use crate::error::{Error, Result};
use crate::splats::Splats;

/// Pitch of centres, metres.
const POSITION: f64 = 1e-4;
/// Pitch of logarithms of scales.
const SCALE: f64 = 0.01;
/// Pitch of the three smaller parts of a quaternion.
const ROTATION: f64 = 1.0 / 2048.0;
/// Pitch of colours and opacities.
const COLOUR: f64 = 1.0 / 1023.0;
/// Pitch of velocities of Gaussians that are there for half a second, metres a second: an error of half a pitch of a centre
/// in that time. Others have a multiple ([`Grids::new`]).
const MOTION: f64 = 2.0 * POSITION;
/// Pitch of times, seconds.
const TIME: f64 = 1e-6;
/// Harmonics are bytes in plus and minus this.
const HARMONICS: f32 = 4.0;
/// Bit of the flags: the Gaussian never fades.
const NEVER_FADES: i32 = 1;

/// Attributes of every chunk: id, channels, and where its bins begin in a row of [`Bins`].
pub(super) const ATTRIBUTES: [(u8, usize, usize); 11] = [
    (0, 3, 0),
    (1, 3, 3),
    (2, 1, 6),
    (3, 3, 7),
    (4, 3, 10),
    (5, 1, 13),
    (6, 3, 14),
    (7, 1, 17),
    (8, 1, 18),
    (9, 1, 19),
    (10, 1, 20),
];
/// Bins of a Gaussian.
const ROW: usize = 21;
/// Where the bins of motion, time and of what an update may not change begin.
const MOTION_AT: usize = 14;
const TIME_AT: usize = 17;
const FIXED_AT: usize = 18;

/// The grids of a file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grids {
    /// Pitch of velocities, metres a second.
    motion: f64,
}

impl Grids {
    /// Those of a scene of so many seconds: velocities are finer where they act longer.
    pub(super) fn new(duration: f64) -> Self {
        let life = duration.clamp(0.02, 2.0);
        let class = libm::ceil(libm::log2(life / 0.5)).clamp(-4.0, 2.0);
        Self {
            motion: MOTION * libm::exp2(-class),
        }
    }

    /// The content of the record that declares them.
    pub(super) fn declare(&self, out: &mut Bytes) {
        out.text("uniform-v1").f64(0.0).f64(0.0).f64(0.0);
        for pitch in [POSITION, SCALE, ROTATION, COLOUR, COLOUR, MOTION, TIME, SCALE] {
            out.f64(pitch);
        }
        out.u8(1);
        let half = |pitch: f64| format!("{:?}", pitch / 2.0);
        let relative = format!("{:?}", libm::expm1(SCALE / 2.0));
        let bounds = [
            ("pos", half(POSITION)),
            ("scale_rel", relative.clone()),
            // The part that is left out is not smaller than each of the others: its error is at most that of all three.
            ("rot", half(3.0 * ROTATION)),
            ("rgb", half(COLOUR)),
            ("alpha", half(COLOUR)),
            ("motion", half(MOTION)),
            ("time", half(TIME)),
            ("sigma_rel", relative),
            ("sh", "0".to_owned()),
        ];
        let pairs: Vec<(&str, &str)> = bounds.iter().map(|(key, value)| (*key, value.as_str())).collect();
        out.map(&pairs);
    }

    /// The bins of all Gaussians at a time, with the velocities that bring them to the next one.
    pub(super) fn bins(&self, splats: &Splats<'_>, seconds: f64, next: Option<(f64, Splats<'_>)>) -> Result<Bins> {
        let mut rows = vec![0; ROW * splats.len()];
        let time = bin(seconds / TIME)?;
        let fill = |(n, row): (usize, &mut [i32])| -> Result<()> {
            let centre = splats.centre_m(n).map(f64::from);
            let scale = splats.scale_m(n);
            let (largest, smaller) = smallest_three(splats.rotation(n));
            let [r, g, b] = splats
                .colour(n)
                .map(|value| libm::round(f64::from(value.clamp(0.0, 1.0)) / COLOUR) as i32);
            for k in 0..3 {
                row[k] = bin(centre[k] / POSITION)?;
                row[3 + k] = bin(f64::from(libm::logf(scale[k])) / SCALE)?;
                row[7 + k] = bin(smaller[k] / ROTATION)?;
            }
            row[6] = largest;
            row[10..13].copy_from_slice(&[g, r - g, b - g]);
            row[13] = bin(f64::from(splats.opacity(n)) / COLOUR)?;
            if let Some((then, next)) = &next {
                let to = next.centre_m(n).map(f64::from);
                for k in 0..3 {
                    // From bin to bin, so that what moves less than a pitch rests.
                    let way = f64::from(bin(to[k] / POSITION)? - row[k]) * POSITION;
                    row[MOTION_AT + k] = bin(way / (then - seconds) / self.motion)?;
                }
            }
            row[TIME_AT] = time;
            row[FIXED_AT + 1] = NEVER_FADES;
            Ok(())
        };
        rows.par_chunks_mut(ROW).enumerate().try_for_each(fill)?;
        Ok(Bins { rows })
    }

    /// Widens a box (least x, y, z, largest x, y, z, metres) by the centres.
    pub(super) fn widen(&self, bins: &Bins, bounds: &mut [f64; 6]) {
        for row in bins.rows.chunks_exact(ROW) {
            for k in 0..3 {
                let value = f64::from(row[k]) * POSITION;
                bounds[k] = bounds[k].min(value);
                bounds[3 + k] = bounds[3 + k].max(value);
            }
        }
    }
}

fn bin(value: f64) -> Result<i32> {
    let rounded = libm::round(value);
    if rounded.abs() > f64::from(i32::MAX / 2) {
        return Err(Error::Unfit {
            what: "a Gaussian lies or moves farther than `.4dgs` can say; leave it out (`--min-opacity`)".to_owned(),
        });
    }
    Ok(rounded as i32)
}

/// Which part of a unit quaternion is largest, and the others, in ascending order, of the sign that makes it positive.
fn smallest_three(quat: [f64; 4]) -> (i32, [f64; 3]) {
    let mut largest = 0;
    for part in 1..4 {
        if quat[part].abs() > quat[largest].abs() {
            largest = part;
        }
    }
    let sign = if quat[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut others = (0..4).filter(|part| *part != largest).map(|part| sign * quat[part]);
    (largest as i32, std::array::from_fn(|_| others.next().unwrap_or(0.0)))
}

/// The harmonics of a band as bytes: all of red, then of green, then of blue.
pub(super) fn harmonics(splats: &Splats<'_>, band: usize) -> Vec<i32> {
    let places = band * band - 1..(band + 1) * (band + 1) - 1;
    let byte = |value: f32| libm::roundf((value + HARMONICS) / (2.0 * HARMONICS) * 255.0).clamp(0.0, 255.0) as i32;
    let mut out = Vec::with_capacity(splats.len() * 3 * places.len());
    for n in 0..splats.len() {
        let rest = splats.rest(n);
        for channel in 0..3 {
            out.extend(places.clone().map(|place| byte(rest[3 * place + channel])));
        }
    }
    out
}

/// The bins of all Gaussians. `[N, 21]`
#[derive(Debug)]
pub(super) struct Bins {
    rows: Vec<i32>,
}

impl Bins {
    fn row(&self, n: i32) -> &[i32] {
        &self.rows[ROW * n as usize..ROW * (n as usize + 1)]
    }

    /// The streams of some Gaussians: as they are, or as differences to a state without what an update may not change.
    pub(super) fn streams(&self, ids: &[i32], since: Option<&Self>) -> Vec<u8> {
        let mut parts = vec![(GAUSSIAN_ID, 1, None)];
        let kept = if since.is_some() { 8 } else { ATTRIBUTES.len() };
        parts.extend(
            ATTRIBUTES[..kept]
                .iter()
                .map(|&(id, channels, at)| (id, channels, Some(at))),
        );
        let encode = |&(id, channels, at): &(u8, usize, Option<usize>)| {
            let Some(at) = at else {
                return stream(id, ids, 1);
            };
            // Rotations are stated anew: which part is left out may be another one.
            let since = since.filter(|_| !(2..=3).contains(&id));
            let mut values = Vec::with_capacity(channels * ids.len());
            for &n in ids {
                let own = &self.row(n)[at..at + channels];
                match since {
                    None => values.extend_from_slice(own),
                    Some(since) => values.extend(own.iter().zip(&since.row(n)[at..]).map(|(now, then)| now - then)),
                }
            }
            stream(id, &values, channels)
        };
        let encoded: Vec<Vec<u8>> = parts.par_iter().map(encode).collect();
        encoded.concat()
    }

    /// Gaussians of which a reader of this state would not know where or what they are then: one that rests may keep the
    /// time at which it was stated.
    pub(super) fn changed(&self, then: &Self) -> Vec<i32> {
        let rests = |row: &[i32]| row[MOTION_AT..TIME_AT].iter().all(|bin| *bin == 0);
        let same = |n: &i32| {
            let (before, after) = (self.row(*n), then.row(*n));
            rests(before) && before[..TIME_AT] == after[..TIME_AT]
        };
        (0..(self.rows.len() / ROW) as i32).filter(|n| !same(n)).collect()
    }

    /// Takes over some Gaussians.
    pub(super) fn take(&mut self, from: &Self, ids: &[i32]) {
        for &n in ids {
            let range = ROW * n as usize..ROW * (n as usize + 1);
            self.rows[range.clone()].copy_from_slice(&from.rows[range]);
        }
    }
}

const _: () = assert!(CUTOFF > 0.0, "velocities of Gaussians that fade would depend on it");

#[cfg(test)]
mod tests {
    use rogs_schemas::units::LengthUnit;

    use super::*;
    use crate::splats::tests::scene;

    #[test]
    fn bins_are_within_half_a_pitch_and_ways_end_at_the_next_time() {
        let (first, mut second) = (scene(20, 1), scene(20, 1));
        second
            .means
            .iter_mut()
            .enumerate()
            .for_each(|(k, value)| *value += 0.003 * k as f32);
        let unit = LengthUnit::Metre;
        let splats = Splats::new(&first, unit).unwrap();
        let next = Splats::new(&second, unit).unwrap();
        let grids = Grids::new(1.6);
        assert_eq!(grids.motion, MOTION / 4.0);
        let bins = grids.bins(&splats, 0.25, Some((0.35, next))).unwrap();
        for n in 0..20 {
            let row = bins.row(n as i32);
            for k in 0..3 {
                let centre = f64::from(row[k]) * POSITION;
                assert!((centre - f64::from(first.means[3 * n + k])).abs() <= 0.5 * POSITION + 1e-9);
                let end = centre + 0.1 * f64::from(row[MOTION_AT + k]) * grids.motion;
                assert!(
                    (end - f64::from(second.means[3 * n + k])).abs() <= 0.5 * POSITION + 0.05 * grids.motion + 1e-9
                );
                let log = f64::from(row[3 + k]) * SCALE;
                assert!((log - f64::from(first.scales[3 * n + k].ln())).abs() <= 0.5 * SCALE + 1e-6);
            }
            let quat = splats.rotation(n);
            let others: Vec<f64> = (0..3).map(|k| f64::from(row[7 + k]) * ROTATION).collect();
            let left_out = (1.0 - others.iter().map(|value| value * value).sum::<f64>()).sqrt();
            let mut found = others.clone();
            found.insert(row[6] as usize, left_out);
            let dot: f64 = found.iter().zip(quat).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 1.0 - 1e-6, "{dot}");
            assert_eq!(f64::from(row[TIME_AT]) * TIME, 0.25);
        }
        assert_eq!(harmonics(&splats, 1).len(), 20 * 9);
    }

    #[test]
    fn what_rests_is_not_restated_and_what_moved_is() {
        let unit = LengthUnit::Metre;
        let first = scene(4, 0);
        let mut second = first.clone();
        second.means[3] += 1.0;
        second.opacities[2] = 1.0 - second.opacities[2];
        let of = |gaussians, seconds| {
            let splats = Splats::new(gaussians, unit).unwrap();
            Grids::new(1.0).bins(&splats, seconds, None).unwrap()
        };
        let (mut before, after) = (of(&first, 0.0), of(&second, 0.5));
        assert_eq!(before.changed(&after), [1, 2]);
        before.take(&after, &[1, 2]);
        assert!(before.changed(&after).is_empty());
        // The time of those that rest stays that of their last statement.
        assert_eq!((before.row(0)[TIME_AT], before.row(1)[TIME_AT]), (0, 500_000));
    }
}
