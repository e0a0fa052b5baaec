//! Synth: procedural robot episodes with exact references.
//!
//! An arm with Panda kinematics and shells made here stands at a table with 3 to 12 objects in a room, all drawn from a
//! seed; it reaches, grasps, carries or pushes for 33 frames at 15 Hz, seen by a wrist camera and two external stereo pairs
//! with DROID's geometry. What is drawn is what is written (URDF and glTF of the robot included), so depth, ids, tracks and
//! calibration are exact.
//!
//! ```no_run
//! use rogs_synth::{SynthConfig, generate_episode, write_dataset};
//! # fn main() -> rogs_synth::Result<()> {
//! let episode = generate_episode(&SynthConfig::default(), 7)?;
//! for frame in episode.frames() {
//!     let wrist = &frame.views[0]; // rgb, depth_m, id
//!     # let _ = wrist;
//! }
//! write_dataset("data".as_ref(), 8, 100, &SynthConfig::default())?; // robot/, episodes/synth-00000100/, ...
//! # Ok(())
//! # }
//! ```
//!
//! Frames, units and conventions are those of `docs/conventions.md`. The same settings and seed give the same bytes for any
//! number of threads.

mod cameras;
mod config;
mod droid;
mod episode;
mod error;
mod frame;
mod hdf5;
mod math;
mod mesh;
mod motion;
mod pointworld;
mod raycast;
mod render;
mod robot;
mod rollout;
mod scene;
mod setting;
mod sidecars;
mod tracks;
mod world;
mod write;

pub use cameras::{
    CAMERA_NAMES, CAMERAS, EpisodeCamera, HAND_EYE_MEAN, HAND_EYE_STD, HAND_EYE_TILT_DEG, Mount, Resolution,
    ZED_MINI_BASELINE, ZED2_BASELINE, nominal_hand_eye,
};
pub use config::SynthConfig;
pub use droid::{
    DROID_CALIBRATION_FOLDER, DROID_FOLDER, DroidEpisode, Peculiar, droid_config, droid_robot, write_droid,
};
pub use episode::{Episode, Frame, GuestStates, generate_episode, generate_episode_with};
pub use error::{Error, Result};
pub use frame::BodyFrame;
pub use hdf5::{Hdf5Group, Hdf5Kind};
pub use mesh::TriMesh;
pub use motion::Action;
pub use pointworld::{POINTWORLD_FOLDERS, write_pointworld, write_pointworld_shard};
pub use render::{Photo, View};
pub use robot::{
    ARM_JOINT_NAMES, ARM_JOINTS, ARM_LIMITS, FINGER_CLOSED, FLANGE_LINK, ROBOT_SPEC_FILE, ROBOT_URDF_FILE, Robot,
    RobotState, TOOL_Z, gripper_for_gap, pad_gap, write_robot,
};
pub use rollout::{Distortions, write_rollout};
pub use scene::{FIRST_OBJECT_ID, FIRST_SCENERY_ID};
pub use sidecars::{EstimatorErrors, write_sidecars};
pub use tracks::EpisodeTracks;
pub use world::{
    CalibrationRanges, GuestArm, GuestMesh, Kinematics, Layouts, MOST_LINKS, Model, Props, SensorRanges, Sky, World,
};
pub use write::{
    DATASET_FILE, DatasetSummary, EPISODES_FOLDER, ROBOT_FOLDER, write_dataset, write_dataset_with, write_episode,
};
