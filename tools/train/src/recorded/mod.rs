//! Training on what was recorded: clips of a run, and posed RGB-D frames of rooms. Both are mixed with procedural clips by
//! share.

mod clip;
mod cut;
mod frames;
mod picture;
mod tracks;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rogs_random::Pcg64;
use serde::{Deserialize, Serialize};

use crate::config::DataSettings;
use crate::error::{Error, Result};
use crate::sample::Sample;
use clip::RecordedClips;
use frames::PosedFrames;

/// Ingested clips of a run of `rogs`: records `clip` and `robot` of every clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedSettings {
    /// Folder of the run; its clips lie in `clips`.
    pub run: PathBuf,
    /// Share of training clips that come from it.
    pub share: f64,
    /// Share of its clips, the last ones by name, that are scored and never trained on.
    #[serde(default = "tenth")]
    pub held_out: f64,
}

/// Frames of a camera that moved through a room where nothing moves, with poses and a sensor's depth: `frames.json`, `images`
/// and `depth` (docs/training.md). Three of them that see the same are a clip of three cameras, without a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FramesSettings {
    /// The folder.
    pub folder: PathBuf,
    /// Share of training clips that come from it.
    pub share: f64,
    /// Last share of the recording's time, which is scored and never trained on.
    #[serde(default = "third")]
    pub held_out: f64,
    /// Metres of a clip for a metre of the room.
    #[serde(default = "scales")]
    pub scale: [f64; 2],
    /// From the base of the robot to the first camera, metres of the clip.
    #[serde(default = "distances")]
    pub base_distance_m: [f64; 2],
    /// Height of the base above the floor, metres of the clip; every other base stands on the floor.
    #[serde(default = "heights")]
    pub base_height_m: [f64; 2],
}

fn tenth() -> f64 {
    0.1
}

fn third() -> f64 {
    1.0 / 3.0
}

fn scales() -> [f64; 2] {
    [0.4, 1.0]
}

fn distances() -> [f64; 2] {
    [1.0, 6.0]
}

fn heights() -> [f64; 2] {
    [0.0, 0.9]
}

/// Checks shares and ranges.
///
/// # Errors
/// The first setting that is out of its range.
pub(crate) fn check_settings(data: &DataSettings) -> Result<()> {
    let wrong = |what, value: String, rule| Err(Error::Setting { what, value, rule });
    let mut sum = 0.0;
    let recorded = data
        .recorded
        .iter()
        .map(|own| ("data.recorded", own.share, own.held_out));
    let frames = data.frames.iter().map(|own| ("data.frames", own.share, own.held_out));
    for (what, share, held_out) in recorded.chain(frames) {
        if !(0.0..=1.0).contains(&share) || !(0.0..1.0).contains(&held_out) {
            let rule = "`share` from 0 to 1, `held_out` from 0 to below 1";
            return wrong(what, format!("share {share}, held_out {held_out}"), rule);
        }
        sum += share;
    }
    if sum > 1.0 + 1e-9 {
        return wrong(
            "data.recorded and data.frames",
            format!("shares of {sum} together"),
            "shares of at most 1 together; the rest are procedural clips",
        );
    }
    for own in &data.frames {
        for (what, [low, high], [least, most], rule) in [
            ("data.frames.scale", own.scale, [0.1, 4.0], "ascending, from 0.1 to 4"),
            (
                "data.frames.base_distance_m",
                own.base_distance_m,
                [0.0, 20.0],
                "ascending, from 0 to 20",
            ),
            (
                "data.frames.base_height_m",
                own.base_height_m,
                [0.0, 3.0],
                "ascending, from 0 to 3",
            ),
        ] {
            if !(least..=most).contains(&low) || !(low..=most).contains(&high) {
                return wrong(what, format!("{low} to {high}"), rule);
            }
        }
    }
    Ok(())
}

/// What clips of recordings are made from.
#[derive(Debug, Clone, Default)]
pub struct Recordings {
    sources: Vec<(f64, Source)>,
}

#[derive(Debug, Clone)]
enum Source {
    Clips(Arc<RecordedClips>),
    Frames(Arc<PosedFrames>),
}

impl Recordings {
    /// Finds what the settings name.
    ///
    /// # Errors
    /// When a folder cannot be read or holds too little; the message names it.
    pub fn open(data: &DataSettings) -> Result<Self> {
        let mut sources = Vec::new();
        for settings in &data.recorded {
            let clips = RecordedClips::find(settings)?;
            sources.push((settings.share, Source::Clips(Arc::new(clips))));
        }
        for settings in &data.frames {
            let frames = PosedFrames::open(settings)?;
            sources.push((settings.share, Source::Frames(Arc::new(frames))));
        }
        Ok(Self { sources })
    }

    /// Reads everything once, so that what cannot be trained on is told before the first update.
    ///
    /// # Errors
    /// What is wrong, with file and clip.
    pub fn check(&self, patch: usize) -> Result<()> {
        for (_, source) in &self.sources {
            match source {
                Source::Clips(clips) => clips.check(patch)?,
                Source::Frames(frames) => frames.check()?,
            }
        }
        Ok(())
    }

    /// The clip of a number that comes from a recording; `None` for one that is procedural. `size` is that of clips that are
    /// cut from frames; recorded clips have their own.
    ///
    /// # Errors
    /// When a file cannot be read or used.
    pub fn clip(
        &self,
        data: &DataSettings,
        (seed, index): (u64, u64),
        (size, times): ([u32; 2], u32),
        with_targets: bool,
    ) -> Result<Option<Sample>> {
        if self.sources.is_empty() {
            return Ok(None);
        }
        let mut random = Pcg64::from_seeds(&[seed, 4, index]);
        let mut left = random.next_double();
        for (share, source) in &self.sources {
            if left < *share {
                return match source {
                    Source::Clips(clips) => clips.draw(data, times, with_targets, &mut random).map(Some),
                    Source::Frames(frames) => frames.draw(size, with_targets, &mut random).map(Some),
                };
            }
            left -= share;
        }
        Ok(None)
    }

    /// Clips that are scored: at most `most` of each kind, with a name for their scores.
    ///
    /// # Errors
    /// When a file cannot be read or used.
    pub fn held_out(&self, data: &DataSettings, most: u64) -> Result<Vec<(&'static str, Sample)>> {
        let mut samples = Vec::new();
        for (_, source) in &self.sources {
            match source {
                Source::Clips(clips) => {
                    for sample in clips.held_out(data, most)? {
                        samples.push(("recorded", sample));
                    }
                }
                Source::Frames(frames) => {
                    for sample in frames.held_out(data.size, most)? {
                        samples.push(("frames", sample));
                    }
                }
            }
        }
        Ok(samples)
    }
}

/// A file or folder that cannot be trained on.
pub(crate) fn unusable(path: &Path, reason: impl Into<String>) -> Error {
    Error::Folder {
        path: path.to_owned(),
        reason: reason.into(),
    }
}
