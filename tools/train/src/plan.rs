//! Which frames of which procedural episode a training clip is cut from.

use rogs_random::Pcg64;
use rogs_schemas::{EpisodeFrame, FrameIndex};
use rogs_synth::{Episode, Resolution, SynthConfig, generate_episode_with};

use crate::config::DataSettings;
use crate::error::{Error, Result};
use crate::props::props;

/// Cameras whose images the network sees; their right eyes follow them in the episode.
pub(crate) const SOURCE_CAMERAS: usize = 3;
/// Frames of a procedural episode.
const EPISODE_FRAMES: u32 = 33;

/// Wrist and external cameras of an episode; their right eyes follow.
const FIRST_CAMERAS: [usize; SOURCE_CAMERAS] = [0, 1, 2];

/// Which frames of which episode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClipPlan {
    /// Seed of the episode.
    pub seed: u64,
    /// First episode frame of the clip.
    pub first: EpisodeFrame,
    /// Clip frames whose images the network sees, ascending.
    pub sources: Vec<FrameIndex>,
    /// Clip frames that are asked for, ascending.
    pub queries: Vec<FrameIndex>,
    /// Cameras of the episode whose images the network sees; the others are held out.
    pub cameras: Vec<usize>,
    /// Image height and width, pixels.
    pub size: [u32; 2],
}

impl ClipPlan {
    /// A plan with the given number of source times, drawn from `random`: half of the plans spread them evenly, as
    /// evaluation does.
    #[must_use]
    pub fn draw(seed: u64, sources: u32, data: &DataSettings, random: &mut Pcg64) -> Self {
        let frames = data.clip_frames;
        let latest = EPISODE_FRAMES.saturating_sub(frames);
        let first = (random.next_double() * f64::from(latest + 1)) as u32;
        let even = random.next_double() < 0.5;
        Self {
            seed,
            first: EpisodeFrame(first.min(latest)),
            sources: if even {
                spread(frames, sources)
            } else {
                choose(frames, sources, random)
            },
            queries: choose(frames, data.queries, random),
            cameras: FIRST_CAMERAS.to_vec(),
            size: data.size,
        }
    }

    /// The same with this many source cameras: one or two of the first three, or these and a right eye.
    #[must_use]
    pub fn with_cameras(mut self, count: u32, random: &mut Pcg64) -> Self {
        let mut pick = |from: usize| ((random.next_double() * from as f64) as usize).min(from - 1);
        let eye = FIRST_CAMERAS.len() + pick(FIRST_CAMERAS.len());
        match count as usize {
            more if more > FIRST_CAMERAS.len() => self.cameras.push(eye),
            count => {
                while self.cameras.len() > count.max(1) {
                    let left = self.cameras.len();
                    self.cameras.remove(pick(left));
                }
            }
        }
        self
    }

    /// The clip that evaluation cuts: the paper's interval, evenly spread sources, queries between them.
    #[must_use]
    pub fn evaluation(seed: u64, data: &DataSettings) -> Self {
        let frames = data.clip_frames;
        Self {
            seed,
            first: EpisodeFrame(7.min(EPISODE_FRAMES.saturating_sub(frames))),
            sources: spread(frames, data.source_times[1]),
            queries: spread(frames, 3.min(frames))
                .into_iter()
                .map(|frame| FrameIndex(frame.0.saturating_sub(2)))
                .collect(),
            cameras: FIRST_CAMERAS.to_vec(),
            size: data.size,
        }
    }

    /// Makes something of the plan; a seed for which no motion is found gives way to another one far from all others.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn or_another<T>(&self, make: impl Fn(&Self) -> Result<T>) -> Result<T> {
        const FAR: u64 = 1 << 40;
        match make(self) {
            Err(Error::Synth(_)) => make(&Self {
                seed: self.seed + FAR,
                ..self.clone()
            }),
            result => result,
        }
    }

    /// The episode that the clip is cut from.
    pub(crate) fn episode(&self, data: &DataSettings) -> Result<Episode> {
        let config = SynthConfig {
            frames: EPISODE_FRAMES.max(data.clip_frames),
            resolution: Resolution {
                wrist: self.size,
                external: self.size,
            },
            calibration_noise: data.calibration_noise,
            anchor_frame: Some(self.first.0 + self.sources[0].0),
            world: data.world.clone(),
            ..SynthConfig::default()
        };
        Ok(generate_episode_with(&config, self.seed, &*props(data)?)?)
    }
}

/// Frames spread evenly from the first to the last.
fn spread(frames: u32, count: u32) -> Vec<FrameIndex> {
    if count < 2 {
        return vec![FrameIndex(0)];
    }
    let last = f64::from(frames - 1);
    (0..count)
        .map(|k| FrameIndex((f64::from(k) * last / f64::from(count - 1)).round() as u32))
        .collect()
}

/// Different frames, ascending.
fn choose(frames: u32, count: u32, random: &mut Pcg64) -> Vec<FrameIndex> {
    let mut all: Vec<FrameIndex> = FrameIndex::first(frames as usize).collect();
    for k in 0..count as usize {
        let other = k + (random.next_double() * (all.len() - k) as f64) as usize;
        all.swap(k, other.min(frames as usize - 1));
    }
    all.truncate(count as usize);
    all.sort_unstable();
    all
}
