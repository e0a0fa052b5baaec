//! `episode.json`: the description of an episode folder in our own layout (`docs/episode-format.md`).
//!
//! `ingest` reads these types and `synth` writes them. All paths are relative to the episode folder.

use serde::{Deserialize, Serialize};

use crate::index::EpisodeFrame;
use crate::pose::Intrinsics;
use crate::records::origin::ReferenceOrigin;
use crate::written_pose::WrittenPose;

/// Value of [`Episode::format`].
pub const EPISODE_FORMAT: &str = "rogs-episode 1";

/// Name of the description inside an episode folder.
pub const EPISODE_FILE: &str = "episode.json";

/// Column of the states table that holds the gripper state.
pub const GRIPPER_COLUMN: &str = "gripper";

/// Column of the states table that may hold seconds; it is checked to ascend and otherwise not used.
pub const TIME_COLUMN: &str = "time";

/// One episode: what was recorded, with what cameras, of what robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Episode {
    /// Always [`EPISODE_FORMAT`].
    pub format: String,
    /// Id of the episode in its dataset; query plans are seeded by it.
    pub episode_id: String,
    /// Frames per second of images and states, which are in step.
    pub fps: f64,
    /// Number of frames; every image sequence, table and array has this many.
    pub frame_count: u32,
    /// Language instruction.
    #[serde(default)]
    pub task: String,
    /// Where the calibration comes from and how far to trust it, in words for the report.
    #[serde(default)]
    pub calibration_note: String,
    /// The robot and its states.
    pub robot: EpisodeRobot,
    /// Cameras; sources first (wrist first), then evaluation cameras.
    pub cameras: Vec<EpisodeCamera>,
    /// 3D tracks, where there are any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tracks: Option<EpisodeTracks>,
}

/// The robot of an episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EpisodeRobot {
    /// Driven arm joints, named as in the URDF.
    pub joint_names: Vec<String>,
    /// CSV file: a header with the joint names and `gripper` (and perhaps `time`), then one row a frame. Radians
    /// (metres for prismatic joints); gripper 0 open, 1 closed.
    pub states: String,
    /// URDF of the robot, where the episode brings its own. A hint for whoever writes a manifest; ingest does not read it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
}

/// One camera of an episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EpisodeCamera {
    /// Name: `wrist`, `ext1`, `ext2`, and for right eyes `wrist_right`, `ext1_right`, `ext2_right`.
    pub id: String,
    /// Input or held out.
    pub role: EpisodeCameraRole,
    /// For an evaluation camera: id of the source camera whose stereo partner it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub partner: Option<String>,
    /// A folder of PNG files `000000.png`, `000001.png`, ... or a video file. `None` where nothing was recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub images: Option<String>,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Pinhole intrinsics, pixels of the recorded images.
    pub intrinsics: Intrinsics,
    /// Where pixel centres lie in the coordinates of `intrinsics` (and of track pixels in this camera).
    #[serde(default)]
    pub pixel_centres: PixelCentres,
    /// How the camera is mounted.
    pub mount: EpisodeMount,
    /// Reference depth, where there is any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<EpisodeDepth>,
}

/// What a camera is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EpisodeCameraRole {
    /// A reconstruction input.
    Source,
    /// Held out for scoring.
    Evaluation,
}

/// Where the centre of pixel (column j, row i) lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PixelCentres {
    /// At (j + 0.5, i + 0.5).
    #[default]
    Half,
    /// At (j, i).
    Integer,
}

/// How a camera is mounted. Camera axes are OpenCV: x right, y down, z forward.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum EpisodeMount {
    /// It never moves.
    Fixed {
        /// Camera-to-base, metres.
        base_from_camera: WrittenPose,
    },
    /// Its pose is known at every frame.
    Trajectory {
        /// `.npy` file of camera-to-base poses, metres, floats `[F, 4, 4]`, `[F, 3, 4]` or `[F, 6]`.
        base_from_camera: String,
    },
    /// It is rigid to a link of the robot.
    HandEye {
        /// Name of the URDF link.
        link: String,
        /// Camera-to-link, metres.
        link_from_camera: WrittenPose,
    },
}

/// Reference depth of a camera: camera z in metres, not ray length.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EpisodeDepth {
    /// One `.npy` file `[F, H, W]`, or a folder of `000000.npy` `[H, W]`, `000000.exr` or `000000.png` (16 bit). Floats are
    /// metres and PNG values millimetres unless `unit_m` says otherwise. NaN and values that are not above 0 mean unknown.
    pub path: String,
    /// Metres that one step of the numbers stands for, for example 0.0002 for PNG with 5000 steps a metre. Integers in
    /// `.npy` files need it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit_m: Option<f64>,
    /// Depths outside this open interval are not scored, metres.
    #[serde(default = "default_range")]
    pub range_m: [f32; 2],
    /// What made it; tables name it.
    #[serde(default)]
    pub origin: ReferenceOrigin,
}

fn default_range() -> [f32; 2] {
    [0.1, 5.0]
}

/// 3D tracks in the base frame. All files are `.npy`, little endian.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EpisodeTracks {
    /// Frame of the episode in which the anchor pixels lie.
    pub anchor_frame: EpisodeFrame,
    /// Index into `cameras` of each track's anchor pixel, u32 `[K]`.
    pub camera: String,
    /// Anchor pixels (x, y) of the recorded image in the camera's `pixel_centres` convention, f32 `[K, 2]`.
    pub pixel: String,
    /// Positions in the base frame, metres, NaN where undefined, f32 `[K, F, 3]`.
    pub position_m: String,
    /// 1 where the point is visible in its anchor camera, u8 `[K, F]`.
    pub visible: String,
    /// What made them; tables name it.
    #[serde(default)]
    pub origin: ReferenceOrigin,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mount_reads_as_the_documentation_shows_it() {
        let text = r#"{"hand_eye": {"link": "panda_link8", "link_from_camera":
            [[1,0,0,0.1],[0,1,0,0.2],[0,0,1,0.3],[0,0,0,1]]}}"#;
        let mount: EpisodeMount = serde_json::from_str(text).unwrap();
        let EpisodeMount::HandEye { link, link_from_camera } = mount else {
            panic!("a hand-eye mount")
        };
        assert_eq!(link, "panda_link8");
        let WrittenPose::Matrix([[.., x], [.., y], [.., z], _]) = link_from_camera else {
            panic!("a matrix")
        };
        assert_eq!([x, y, z], [0.1, 0.2, 0.3]);
    }
}
