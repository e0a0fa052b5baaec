//! Settings of the generator.

use serde::{Deserialize, Serialize};

use crate::cameras::Resolution;
use crate::error::{Error, Result};
use crate::motion::Action;
use crate::world::World;

/// Settings of the generator; two episodes of equal settings and seed are equal to the byte.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SynthConfig {
    /// Frames of an episode.
    pub frames: u32,
    /// Frames per second.
    pub fps: f64,
    /// Image sizes.
    pub resolution: Resolution,
    /// Fewest and most objects on the table.
    pub objects: [u32; 2],
    /// What happens; `None` draws it.
    pub action: Option<Action>,
    /// Errors of the recorded extrinsics: standard deviations in metres and radians. `None`: exact.
    pub calibration_noise: Option<[f64; 2]>,
    /// Whether images have sensor noise and vignetting.
    pub sensor_noise: bool,
    /// Frame in which the tracks are anchored. `None`: 7, the first frame of the paper's interval, or 0 in episodes of
    /// fewer than 24 frames.
    pub anchor_frame: Option<u32>,
    /// Most tracks that start in each of the three source cameras on the robot, and on objects.
    pub tracks_per_camera: [u32; 2],
    /// How wide the worlds of episodes are; without it, all are plain robot cells.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub world: Option<World>,
}

impl Default for SynthConfig {
    fn default() -> Self {
        Self {
            frames: 33,
            fps: 15.0,
            resolution: Resolution::EVALUATION,
            objects: [3, 12],
            action: None,
            calibration_noise: None,
            sensor_noise: true,
            anchor_frame: None,
            tracks_per_camera: [192, 64],
            world: None,
        }
    }
}

impl SynthConfig {
    /// The frame in which tracks are anchored.
    #[must_use]
    pub fn anchor(&self) -> u32 {
        self.anchor_frame.unwrap_or(if self.frames >= 24 { 7 } else { 0 })
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// [`Error::Config`] that names the setting and its range.
    pub fn check(&self) -> Result<()> {
        let wrong = |what, value: String, rule| Err(Error::Config { what, value, rule });
        if !(1..=2000).contains(&self.frames) {
            return wrong("frames", self.frames.to_string(), "from 1 to 2000");
        }
        if !(1.0..=1000.0).contains(&self.fps) {
            return wrong("fps", self.fps.to_string(), "from 1 to 1000");
        }
        for [height, width] in [self.resolution.wrist, self.resolution.external] {
            if !(8..=2160).contains(&height) || !(8..=3840).contains(&width) {
                return wrong(
                    "resolution",
                    format!("{height}x{width}"),
                    "height from 8 to 2160, width from 8 to 3840",
                );
            }
        }
        if let Some(world) = &self.world {
            world.check()?;
        }
        let [fewest, most] = self.objects;
        if fewest < 1 || fewest > most || most > 40 {
            return wrong(
                "objects",
                format!("{fewest} to {most}"),
                "at least 1, ascending, at most 40",
            );
        }
        if let Some([metres, radians]) = self.calibration_noise
            && (!(0.0..=0.1).contains(&metres) || !(0.0..=0.2).contains(&radians))
        {
            return wrong(
                "calibration_noise",
                format!("{metres}, {radians}"),
                "at most 0.1 m and 0.2 rad",
            );
        }
        if self.anchor() >= self.frames {
            return wrong("anchor_frame", self.anchor().to_string(), "below the number of frames");
        }
        if self.tracks_per_camera.iter().any(|&n| n > 100_000) {
            return wrong(
                "tracks_per_camera",
                format!("{:?}", self.tracks_per_camera),
                "at most 100000",
            );
        }
        Ok(())
    }
}
