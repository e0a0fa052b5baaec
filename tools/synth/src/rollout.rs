//! Procedural rollouts: what a world model might have made of an episode, wrong by known amounts.
//!
//! The first frame is the recorded one. From there the pictures are drawn anew: of a robot (and what it moves) that lags
//! behind its recorded states, from an external camera that drifts, and blurred more and more. Without distortions they are
//! the recorded pictures to the byte.

use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;
use rogs_files::Draft;
use rogs_geometry::{Camera, Pose};

use crate::cameras::CAMERA_NAMES;
use crate::episode::Episode;
use crate::error::{Error, Result};
use crate::render::{View, blurred};
use crate::write::png;

/// Source cameras of an episode; held-out ones are no part of a rollout.
const SOURCES: [usize; 3] = [0, 1, 2];
/// The camera that drifts.
const DRIFTING: usize = 1;

/// How a rollout departs from the recording.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distortions {
    /// Standard deviation of a Gaussian blur at the last frame, pixels; it grows evenly from 0 at the first.
    pub blur_px: f64,
    /// How far the first external camera has moved along its own x at the last frame, metres; evenly from 0.
    pub drift_m: f64,
    /// Frames by which the robot, and what it moves, lag behind; never before the first frame.
    pub lag_frames: u32,
}

impl Distortions {
    fn check(&self) -> Result<()> {
        let wrong = |what, value: f64, rule| {
            Err(Error::Config {
                what,
                value: value.to_string(),
                rule,
            })
        };
        if !(0.0..=50.0).contains(&self.blur_px) {
            return wrong("blur_px", self.blur_px, "from 0 to 50");
        }
        if !(-1.0..=1.0).contains(&self.drift_m) {
            return wrong("drift_m", self.drift_m, "from -1 to 1");
        }
        Ok(())
    }
}

impl Episode {
    /// The source cameras at a frame of a rollout that starts at episode frame `first` and has `count` frames; `number` is
    /// counted from there. Frames beyond the episode are its last one.
    #[must_use]
    pub fn render_rollout(&self, first: usize, number: usize, count: usize, distortions: &Distortions) -> Vec<View> {
        let last = self.frame_count().saturating_sub(1);
        let frame = (first + number).min(last);
        let shown = frame
            .saturating_sub(distortions.lag_frames as usize)
            .max(first.min(last));
        let share = if count > 1 {
            number as f64 / (count - 1) as f64
        } else {
            0.0
        };
        let drift: Pose<Camera, Camera> = Pose::from_translation(DVec3::X * (distortions.drift_m * share));
        let moved = |camera: usize| if camera == DRIFTING { drift } else { Pose::IDENTITY };
        let mut views = self.render_moved(shown, frame, &SOURCES, &moved);
        for (view, camera) in views.iter_mut().zip(SOURCES) {
            let lens = &self.cameras[camera].lens;
            view.rgb = blurred(
                &view.rgb,
                lens.width as usize,
                lens.height as usize,
                [distortions.blur_px * share; 2],
            );
        }
        views
    }
}

/// Writes a rollout of `count` frames from episode frame `first` on: a folder of PNG files a source camera, as
/// `docs/rollouts.md` describes. One that is there is kept as it is.
///
/// # Errors
/// When the distortions are out of range, or a file cannot be written.
pub fn write_rollout(
    place: &Path,
    episode: &Episode,
    first: usize,
    count: usize,
    distortions: &Distortions,
) -> Result<()> {
    distortions.check()?;
    if place.exists() {
        return Ok(());
    }
    if let Some(folder) = place.parent() {
        std::fs::create_dir_all(folder).map_err(|source| Error::io(folder, source))?;
    }
    let draft = Draft::begin(place)?;
    (0..count).into_par_iter().try_for_each(|number| -> Result<()> {
        let views = episode.render_rollout(first, number, count, distortions);
        for (view, camera) in views.iter().zip(SOURCES) {
            let lens = &episode.cameras[camera].lens;
            let name = format!("{}/{number:06}.png", CAMERA_NAMES[camera]);
            draft.write(name, &png(&view.rgb, lens.width, lens.height)?)?;
        }
        Ok(())
    })?;
    Ok(draft.publish()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cameras::Resolution;
    use crate::config::SynthConfig;
    use crate::episode::generate_episode;

    fn episode() -> Episode {
        let config = SynthConfig {
            frames: 24,
            resolution: Resolution {
                wrist: [28, 42],
                external: [28, 42],
            },
            ..SynthConfig::default()
        };
        generate_episode(&config, 3).unwrap()
    }

    fn difference(a: &View, b: &View) -> u64 {
        a.rgb.iter().zip(&b.rgb).map(|(a, b)| u64::from(a.abs_diff(*b))).sum()
    }

    #[test]
    fn without_distortions_a_rollout_is_the_recording() {
        let episode = episode();
        for number in [0, 9, 16] {
            let recorded = episode.render_cameras(7 + number, &SOURCES);
            assert_eq!(episode.render_rollout(7, number, 17, &Distortions::default()), recorded);
        }
    }

    #[test]
    fn every_rollout_begins_as_the_recording_and_departs_from_it_by_what_is_asked() {
        let episode = episode();
        let none = Distortions::default();
        let kinds = [
            ("blur", Distortions { blur_px: 2.0, ..none }, [true, true, true]),
            ("drift", Distortions { drift_m: 0.05, ..none }, [false, true, false]),
            ("lag", Distortions { lag_frames: 2, ..none }, [true, true, true]),
        ];
        for (name, distortions, departs) in kinds {
            assert_eq!(
                episode.render_rollout(7, 0, 17, &distortions),
                episode.render_cameras(7, &SOURCES),
                "{name}"
            );
            // At some frame: a robot that rests for a moment does not show its lag.
            let mut found = [false; 3];
            for number in [4, 8, 12, 16] {
                let recorded = episode.render_cameras(7 + number, &SOURCES);
                let made = episode.render_rollout(7, number, 17, &distortions);
                for ((made, recorded), found) in made.iter().zip(&recorded).zip(&mut found) {
                    *found |= difference(made, recorded) > 0;
                }
            }
            assert_eq!(found, departs, "{name}");
        }
    }

    #[test]
    fn a_lagging_robot_shows_what_was_two_frames_before() {
        let episode = episode();
        let lag = Distortions {
            lag_frames: 2,
            ..Distortions::default()
        };
        // The noise is that of the frame, the scene that of two before; depth has no noise.
        let mut moved = false;
        for number in [6, 10, 16] {
            let lagging = episode.render_rollout(7, number, 17, &lag);
            let [before, now] = [5, 7].map(|frame| episode.render_cameras(frame + number, &SOURCES));
            assert!(lagging[1].depth_m == before[1].depth_m, "frame {number}");
            moved |= lagging[1].depth_m != now[1].depth_m;
        }
        assert!(moved, "the robot moves");
    }

    #[test]
    fn impossible_distortions_are_named() {
        let folder = std::env::temp_dir().join("rogs-synth-no-rollout");
        let wrong = Distortions {
            drift_m: f64::NAN,
            ..Distortions::default()
        };
        let error = write_rollout(&folder, &episode(), 7, 17, &wrong)
            .unwrap_err()
            .to_string();
        assert!(error.starts_with("drift_m: `NaN`"), "{error}");
    }
}
