//! Where training clips come from beside the generator's own robot and rooms, as settings name it.

use std::path::PathBuf;

use rogs_schemas::records::robot::RobotSpec;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// A robot that takes the place of the generator's own in a share of wide worlds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSettings {
    /// Its URDF file.
    pub urdf: PathBuf,
    /// Base, gripper joint, tool link with the place between the fingers, and which geometry counts, as `[robot]` of a
    /// manifest has them. Without it, those of a Panda with the Robotiq 2F-85.
    #[serde(default)]
    pub spec: RobotSpec,
}

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
    /// Takes the robot's mesh as reference depth of its pixels where a clip has no other: real clips with calibrated cameras
    /// and joint states, but no depth.
    #[serde(default)]
    pub mesh_depth: bool,
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
pub(crate) fn check(recorded: &[RecordedSettings], frames: &[FramesSettings]) -> Result<()> {
    let wrong = |what, value: String, rule| Err(Error::Setting { what, value, rule });
    let mut sum = 0.0;
    let of_runs = recorded.iter().map(|own| ("data.recorded", own.share, own.held_out));
    let of_rooms = frames.iter().map(|own| ("data.frames", own.share, own.held_out));
    for (what, share, held_out) in of_runs.chain(of_rooms) {
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
    for own in frames {
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
