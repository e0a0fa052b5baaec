//! Parameters of the stage; the defaults are the schedule that the paper compares with.

use rogs_worker::{StageError, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Most epochs and updates that may be asked for.
const MOST_UPDATES: u32 = 1_000_000;
/// Most points of a camera.
const MOST_POINTS: u32 = 10_000_000;
/// Largest batch, number of clusters and width of a mask's band.
const MOST_SMALL: u32 = 256;

/// What determines a field besides its inputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LiftSomParams {
    /// Pixels by which the projected robot mesh is eroded to the foreground.
    pub erode_px: u32,
    /// Pixels by which it is dilated before what is outside of it is background.
    pub dilate_px: u32,
    /// Tracks that the foreground begins with, at most.
    pub tracks: u32,
    /// Background Gaussians to begin with, at most.
    pub background: u32,
    /// Clusters of tracks; each becomes a rigid motion.
    pub clusters: u32,
    /// A cluster needs more points than this.
    pub smallest_cluster: u32,
    /// Updates of motion and centres alone, against the tracks, before images are rendered.
    pub track_updates: u32,
    /// Epochs; each takes as many samples as the clip has frames, in batches.
    pub epochs: u32,
    /// Samples of a batch; a batch is one update.
    pub batch: u32,
    /// Seed of every draw.
    pub seed: u64,
}

impl Default for LiftSomParams {
    fn default() -> Self {
        Self {
            erode_px: 3,
            dilate_px: 6,
            tracks: 40_000,
            background: 100_000,
            clusters: 10,
            smallest_cluster: 100,
            track_updates: 1000,
            epochs: 500,
            batch: 8,
            seed: 42,
        }
    }
}

impl LiftSomParams {
    /// Checks the values.
    ///
    /// # Errors
    /// The first that is not possible.
    pub fn validate(&self) -> StageResult<()> {
        for (name, value, least, most) in [
            ("erode_px", self.erode_px, 0, MOST_SMALL),
            ("dilate_px", self.dilate_px, 0, MOST_SMALL),
            ("tracks", self.tracks, 1, MOST_POINTS),
            ("background", self.background, 1, MOST_POINTS),
            ("clusters", self.clusters, 1, MOST_SMALL),
            ("smallest_cluster", self.smallest_cluster, 0, MOST_POINTS),
            ("track_updates", self.track_updates, 0, MOST_UPDATES),
            ("epochs", self.epochs, 0, MOST_UPDATES),
            ("batch", self.batch, 1, MOST_SMALL),
        ] {
            if !(least..=most).contains(&value) {
                return Err(StageError::bad_params(format!(
                    "invalid `{name}` {value}: expected {least} to {most}"
                )));
            }
        }
        Ok(())
    }

    /// Updates of an epoch over so many frames.
    #[must_use]
    pub fn batches(&self, frames: usize) -> u32 {
        (frames as u32).div_ceil(self.batch)
    }

    /// Updates in all: 1,500 with the defaults and 17 frames.
    #[must_use]
    pub fn updates(&self, frames: usize) -> u32 {
        self.epochs.saturating_mul(self.batches(frames))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_schedule_is_that_of_the_paper() {
        assert_eq!(LiftSomParams::default().updates(17), 1500);
        let wrong = LiftSomParams {
            batch: 0,
            ..LiftSomParams::default()
        };
        let error = wrong.validate().unwrap_err();
        assert_eq!(error.message, "invalid `batch` 0: expected 1 to 256");
    }
}
