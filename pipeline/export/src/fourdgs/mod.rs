//! `.4dgs`, the open container of moving Gaussians, with the temporal model `keyframe-delta` (`docs/exports.md`).
//!
//! A file is records (opcode, u64 length, content) between two magics. Every time that is written is a state chunk, valid
//! until the next one: now and then a keyframe with all Gaussians, otherwise the differences to the chunk before it. Each
//! Gaussian has the velocity that brings it to where it is at the next time, so a reader sees centres move on straight lines
//! between the times, and all else hold. Numbers are bins of fixed grids (`bins.rs`); a difference is one of bins, so errors
//! do not add up.

mod bins;
mod records;

use rogs_field::Axes;
use rogs_schemas::units::LengthUnit;
use rogs_splat::Gaussians;

use crate::error::{Error, Result};
use crate::splats::Splats;
use bins::{ATTRIBUTES, Bins, Grids};
use records::{Bytes, stream};

const MAGIC: [u8; 8] = [0x89, b'4', b'D', b'G', b'S', b'1', b'\r', b'\n'];
/// Times from a keyframe to the next.
const KEYFRAME_EVERY: usize = 8;
/// Visibility under which a Gaussian of other temporal models is left out; ours never fade.
const CUTOFF: f64 = 0.05;
/// The attribute that names a Gaussian.
const GAUSSIAN_ID: u8 = 13;

mod opcode {
    pub(super) const HEADER: u8 = 0x01;
    pub(super) const FOOTER: u8 = 0x02;
    pub(super) const QUANTIZATION: u8 = 0x03;
    pub(super) const WINDOWS: u8 = 0x04;
    pub(super) const CHUNK: u8 = 0x05;
    pub(super) const HARMONICS: u8 = 0x07;
    pub(super) const INDEX: u8 = 0x08;
    pub(super) const STATISTICS: u8 = 0x0c;
    pub(super) const DELTA: u8 = 0x10;
    pub(super) const FRAME: u8 = 0x20;
}

/// Where a state chunk and its harmonics lie.
struct Entry {
    interval: [f64; 2],
    offset: usize,
    length: usize,
    /// Gaussians that the record speaks of.
    count: usize,
    /// Band, offset, length.
    bands: Vec<(u8, usize, usize)>,
    /// Offset of the chunk that it changes; none for a keyframe.
    reference: Option<usize>,
    keyframe: usize,
    depth: usize,
}

/// A time whose velocities wait for the next one.
struct Pending {
    seconds: f64,
    gaussians: Gaussians,
}

/// Takes the times of a scene one by one.
pub struct FourDgs {
    out: Bytes,
    axes: Axes,
    unit: LengthUnit,
    duration: f64,
    grids: Grids,
    pending: Option<Pending>,
    /// What a reader has put together so far.
    state: Option<Bins>,
    degree: usize,
    entries: Vec<Entry>,
    /// Least and largest coordinates, metres.
    bounds: [f64; 6],
    /// Where the box of the header lies.
    box_at: usize,
}

impl FourDgs {
    /// Begins a file; lengths of the Gaussians are in `unit`, their frame is `axes`, and the scene lasts so many seconds.
    ///
    /// # Errors
    /// When the duration is not above 0.
    pub fn new(axes: Axes, unit: LengthUnit, duration: f64) -> Result<Self> {
        if !(duration.is_finite() && duration > 0.0) {
            return Err(Error::Unfit {
                what: format!("a scene of {duration} s has no duration"),
            });
        }
        Ok(Self {
            out: Bytes::default(),
            axes,
            unit,
            duration,
            grids: Grids::new(duration),
            pending: None,
            state: None,
            degree: 0,
            entries: Vec::new(),
            bounds: [
                f64::INFINITY,
                f64::INFINITY,
                f64::INFINITY,
                f64::NEG_INFINITY,
                f64::NEG_INFINITY,
                f64::NEG_INFINITY,
            ],
            box_at: 0,
        })
    }

    /// Adds the Gaussians at a time, seconds from the beginning of the file; the first time is 0. Row `n` is the same
    /// Gaussian every time.
    ///
    /// # Errors
    /// When times do not ascend from 0 to the duration, Gaussians or their harmonics are not as many as before, or a number
    /// is not finite.
    pub fn push(&mut self, seconds: f64, gaussians: Gaussians) -> Result<()> {
        let splats = Splats::new(&gaussians, self.unit)?;
        let unfit = |what: String| Err(Error::Unfit { what });
        let last = self.pending.as_ref().map(|pending| pending.seconds);
        let follows = last.map_or(seconds == 0.0, |last| seconds > last);
        if !follows || seconds >= self.duration {
            return unfit(format!(
                "times must ascend from 0 to less than {} s, {seconds} s does not follow",
                self.duration
            ));
        }
        match &self.pending {
            None => {
                self.degree = splats.degree();
                self.header(splats.len());
            }
            Some(pending) => {
                if (pending.gaussians.len(), self.degree) != (gaussians.len(), splats.degree()) {
                    return unfit("the times have other numbers of Gaussians or harmonics".to_owned());
                }
            }
        }
        if let Some(pending) = self.pending.take() {
            self.write(&pending, Some((seconds, &gaussians)))?;
        }
        self.pending = Some(Pending { seconds, gaussians });
        Ok(())
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// When no time was added, or a number does not fit its grid.
    pub fn finish(mut self) -> Result<Vec<u8>> {
        let Some(pending) = self.pending.take() else {
            return Err(Error::Unfit {
                what: "no time was given".to_owned(),
            });
        };
        self.write(&pending, None)?;
        self.out
            .overwrite(self.box_at, &self.bounds.map(f64::to_le_bytes).concat());
        let summary = self.out.len();
        for entry in std::mem::take(&mut self.entries) {
            self.out
                .record(opcode::INDEX, |out| index(out, &entry, pending.gaussians.len()));
            self.entries.push(entry);
        }
        let (count, chunks, duration, bounds) = (
            pending.gaussians.len() as u64,
            self.entries.len() as u32,
            self.duration,
            self.bounds,
        );
        self.out.record(opcode::STATISTICS, |out| {
            out.u64(count).u32(chunks).f64(duration);
            bounds.iter().for_each(|value| {
                out.f64(*value);
            });
        });
        let sum = crc32fast::hash(&self.out.bytes()[summary..]);
        self.out.record(opcode::FOOTER, |out| {
            out.u64(summary as u64).u64(0).u32(sum);
        });
        self.out.put(&MAGIC);
        Ok(self.out.into_bytes())
    }

    fn header(&mut self, count: usize) {
        let (duration, degree, axes) = (self.duration, self.degree, self.axes);
        self.out.put(&MAGIC);
        // The box comes after the last time and is filled in then.
        let mut box_at = 0;
        let start = self.out.record(opcode::HEADER, |out| {
            out.text("").text("rogs").f64(duration).u64(count as u64).f64(CUTOFF);
            out.text("keyframe-delta");
            box_at = out.len();
            out.put(&[0; 48]).u8(degree as u8).u8(0);
            out.map(&[("visibility_profile", "box")]);
        });
        self.box_at = start + box_at;
        let grids = &self.grids;
        self.out.record(opcode::QUANTIZATION, |out| grids.declare(out));
        self.out.record(opcode::WINDOWS, |out| {
            out.u32(1).f64(0.0).f64(duration);
        });
        // Right-handed; up +z and forward +x of the base, up -y and forward +z of a camera; metres.
        let [up, forward] = match axes {
            Axes::Base => [2, 0],
            Axes::Recon => [4, 2],
        };
        self.out.record(opcode::FRAME, |out| {
            out.text("").u8(1).u8(up).u8(forward).u8(1).f64(1.0);
        });
    }

    /// Writes a state chunk.
    fn write(&mut self, now: &Pending, next: Option<(f64, &Gaussians)>) -> Result<()> {
        let splats = Splats::new(&now.gaussians, self.unit)?;
        let next = match next {
            Some((seconds, gaussians)) => Some((seconds, Splats::new(gaussians, self.unit)?)),
            None => None,
        };
        let end = next.as_ref().map_or(self.duration, |(seconds, _)| *seconds);
        let bins = self.grids.bins(&splats, now.seconds, next)?;
        self.grids.widen(&bins, &mut self.bounds);
        let interval = [now.seconds, end];
        let before = self.entries.last();
        let keyframe = self.entries.len().is_multiple_of(KEYFRAME_EVERY);
        let chained = before
            .filter(|_| !keyframe)
            .map(|before| (before.offset, before.keyframe, before.depth));
        let state = self.state.take();
        let (entry, state) = match (chained, state) {
            (Some(chained), Some(state)) => self.delta(interval, chained, state, &bins),
            _ => (self.keyframe(interval, &splats, &bins), bins),
        };
        self.entries.push(entry);
        self.state = Some(state);
        Ok(())
    }

    fn keyframe(&mut self, interval: [f64; 2], splats: &Splats<'_>, bins: &Bins) -> Entry {
        let n = splats.len();
        let offset = self.out.len();
        let ids: Vec<i32> = (0..n as i32).collect();
        let streams = bins.streams(&ids, None);
        self.out.record(opcode::CHUNK, |out| {
            out.f64(interval[0]).f64(interval[1]).u32(0).u32(n as u32).text("");
            out.u64(streams.len() as u64).blob(&streams);
        });
        let length = self.out.len() - offset;
        let bands = (1..=self.degree)
            .map(|band| {
                let at = self.out.len();
                let values = bins::harmonics(splats, band);
                self.out.record(opcode::HARMONICS, |out| {
                    out.u8(band as u8);
                    out.put(&stream(opcode::HARMONICS, &values, 3 * (2 * band + 1)));
                });
                (band as u8, at, self.out.len() - at)
            })
            .collect();
        Entry {
            interval,
            offset,
            length,
            count: n,
            bands,
            reference: None,
            keyframe: offset,
            depth: 0,
        }
    }

    /// Differences to the chunk before, and what a reader has then.
    fn delta(
        &mut self,
        interval: [f64; 2],
        (reference, keyframe, depth): (usize, usize, usize),
        mut state: Bins,
        bins: &Bins,
    ) -> (Entry, Bins) {
        let changed = state.changed(bins);
        let offset = self.out.len();
        let updates = if changed.is_empty() {
            Vec::new()
        } else {
            bins.streams(&changed, Some(&state))
        };
        let mut records = Bytes::default();
        // Nothing is born, nothing dies.
        records.blob(&updates).blob(&[]).blob(&[]);
        let depth = depth + 1;
        self.out.record(opcode::DELTA, |out| {
            out.f64(interval[0]).f64(interval[1]).u32(0).u8(1);
            out.u64(reference as u64).u64(keyframe as u64).u16(depth as u16);
            out.u32(changed.len() as u32).u32(0).u32(0).text("");
            out.u64(records.len() as u64).blob(records.bytes());
        });
        state.take(bins, &changed);
        let entry = Entry {
            interval,
            offset,
            length: self.out.len() - offset,
            count: changed.len(),
            bands: Vec::new(),
            reference: Some(reference),
            keyframe,
            depth,
        };
        (entry, state)
    }
}

/// An entry of the index.
fn index(out: &mut Bytes, entry: &Entry, live: usize) {
    out.f64(entry.interval[0]).f64(entry.interval[1]);
    out.u64(entry.offset as u64).u64(entry.length as u64);
    out.u32(entry.count as u32).u32(entry.bands.len() as u32);
    for &(band, offset, length) in &entry.bands {
        out.u8(band).u64(offset as u64).u64(length as u64);
    }
    let delta = u8::from(entry.reference.is_some());
    out.u8(delta).u8(delta).u64(entry.reference.unwrap_or(0) as u64);
    out.u64(entry.keyframe as u64).u16(entry.depth as u16).u64(live as u64);
}

const _: () = assert!(ATTRIBUTES.len() == 11, "the attributes that every chunk must have");

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splats::tests::scene;

    fn moved(gaussians: &Gaussians, by: f32) -> Gaussians {
        let mut moved = gaussians.clone();
        // Half of them stay where they are.
        let half = moved.means.len() / 2;
        moved.means[..half].iter_mut().for_each(|value| *value += by);
        moved
    }

    #[test]
    fn records_tile_the_file_and_the_index_finds_the_chunks() {
        let first = scene(50, 2);
        let mut file = FourDgs::new(Axes::Base, LengthUnit::Metre, 2.0).unwrap();
        for k in 0..10 {
            file.push(f64::from(k) * 0.2, moved(&first, 0.01 * k as f32)).unwrap();
        }
        let bytes = file.finish().unwrap();
        assert_eq!((&bytes[..8], &bytes[bytes.len() - 8..]), (&MAGIC[..], &MAGIC[..]));
        let (mut at, mut codes) = (8, Vec::new());
        while at < bytes.len() - 8 {
            let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
            codes.push((bytes[at], at, 9 + length));
            at += 9 + length;
        }
        assert_eq!(at, bytes.len() - 8);
        let of = |code: u8| codes.iter().filter(|(own, ..)| *own == code).count();
        assert_eq!((of(opcode::CHUNK), of(opcode::DELTA), of(opcode::HARMONICS)), (2, 8, 4));
        assert_eq!(of(opcode::INDEX), 10);
        let starts: Vec<u64> = (codes.iter().filter(|(code, ..)| *code == opcode::INDEX))
            .map(|(_, at, _)| u64::from_le_bytes(bytes[at + 9 + 16..at + 9 + 24].try_into().unwrap()))
            .collect();
        for (code, at, _) in codes
            .iter()
            .filter(|(code, ..)| [opcode::CHUNK, opcode::DELTA].contains(code))
        {
            assert!(starts.contains(&(*at as u64)), "{code}");
        }
        // Only the moving half is restated.
        let deltas = codes.iter().find(|(code, ..)| *code == opcode::DELTA).unwrap();
        let updates = u32::from_le_bytes(bytes[deltas.1 + 9 + 39..][..4].try_into().unwrap());
        assert_eq!(updates, 25);
    }

    #[test]
    fn what_does_not_follow_is_refused() {
        let first = scene(3, 0);
        let file = || FourDgs::new(Axes::Recon, LengthUnit::Metre, 1.0).unwrap();
        assert!(FourDgs::new(Axes::Recon, LengthUnit::Metre, 0.0).is_err());
        assert!(file().finish().is_err());
        let mut late = file();
        assert!(
            late.push(0.5, first.clone())
                .unwrap_err()
                .to_string()
                .contains("ascend")
        );
        late.push(0.0, first.clone()).unwrap();
        assert!(late.push(0.0, first.clone()).is_err());
        assert!(late.push(1.0, first.clone()).is_err());
        assert!(
            late.push(0.5, scene(4, 0))
                .unwrap_err()
                .to_string()
                .contains("other numbers")
        );
        assert!(late.push(0.5, scene(3, 1)).is_err());
    }
}
