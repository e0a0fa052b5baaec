//! Training on what was recorded: clips of a run, and posed RGB-D frames of rooms. Both are mixed with procedural clips by
//! share.

mod clip;
mod cut;
mod frames;
mod picture;
mod tracks;

use std::path::Path;
use std::sync::Arc;

use rogs_random::Pcg64;

use crate::config::DataSettings;
use crate::error::{Error, Result};
use crate::sample::Sample;
use clip::RecordedClips;
use frames::PosedFrames;

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
