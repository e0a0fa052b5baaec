//! An episode as every layout delivers it: described and checked, nothing decoded yet.

use std::path::PathBuf;

use rogs_schemas::records::clip::CameraRole;
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::{EpisodeFrame, Intrinsics, RigidPose};

use crate::images::FrameSource;

/// An episode. All sequences count episode frames `0..frame_count`.
#[derive(Debug)]
pub(crate) struct Source {
    /// Id in the dataset.
    pub(crate) episode_id: String,
    /// Name of the layout, as the clip keeps it.
    pub(crate) layout: &'static str,
    /// Language instruction.
    pub(crate) task: String,
    /// Where the calibration comes from.
    pub(crate) calibration_note: String,
    /// Frames per second.
    pub(crate) fps: f64,
    /// Frames.
    pub(crate) frame_count: u32,
    /// Cameras, sources first.
    pub(crate) cameras: Vec<SourceCamera>,
    /// Joints and gripper.
    pub(crate) states: States,
    /// Tracks, where there are any.
    pub(crate) tracks: Option<SourceTracks>,
    /// The layout has applied the choice of cameras of the parameters.
    pub(crate) cameras_chosen: bool,
    /// What a person should know.
    pub(crate) warnings: Vec<String>,
}

/// A camera.
#[derive(Debug)]
pub(crate) struct SourceCamera {
    pub(crate) id: String,
    /// Serial number of the device, where the layout knows one.
    pub(crate) serial: Option<String>,
    pub(crate) role: CameraRole,
    /// Id of the source camera it is the partner of.
    pub(crate) partner: Option<String>,
    /// Size of the recorded images.
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Pixels of the recorded images, pixel centres at + 0.5.
    pub(crate) intrinsics: Intrinsics,
    /// Added to track pixels to get pixel centres at + 0.5.
    pub(crate) pixel_shift: f64,
    pub(crate) mount: SourceMount,
    pub(crate) images: Option<FrameSource>,
    /// When each image was taken, milliseconds of any clock. `[F]`
    pub(crate) times_ms: Option<Vec<f64>>,
    pub(crate) depth: Option<SourceDepth>,
}

/// How a camera is mounted. Poses are checked to be rigid.
#[derive(Debug, Clone)]
pub(crate) enum SourceMount {
    Fixed(RigidPose),
    /// One pose per episode frame.
    Trajectory(Vec<RigidPose>),
    HandEye {
        link: String,
        link_from_camera: RigidPose,
    },
}

/// Reference depth.
#[derive(Debug)]
pub(crate) struct SourceDepth {
    /// `.npy` file or folder.
    pub(crate) path: PathBuf,
    /// Metres of one step, where the episode says it.
    pub(crate) unit_m: Option<f64>,
    pub(crate) range_m: [f32; 2],
    pub(crate) origin: ReferenceOrigin,
    /// Where it is in a cache, when the path is one.
    pub(crate) cached: Option<CachedDepth>,
}

/// Depth maps of one camera in a cache.
#[derive(Debug, Clone)]
pub(crate) struct CachedDepth {
    /// Group of the camera.
    pub(crate) group: String,
    /// Entry for every episode frame, where there is one. `[F]`
    pub(crate) rows: Vec<Option<usize>>,
    /// Size of the maps, `(width, height)`; they show what the images show.
    pub(crate) size: (u32, u32),
}

/// An episode in words.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct EpisodeOutline {
    /// Cameras that reconstruct, as the data calls them.
    pub cameras: Vec<String>,
    /// Arm joints as the URDF should call them; empty where the data leaves that open.
    pub joints: Vec<String>,
    /// Entries of the state, where joints and gripper have to be picked out of them.
    pub state_entries: Vec<String>,
    /// The robot, as the data calls it.
    pub robot: Option<String>,
    /// URDF that the episode brings along, relative to the listed root.
    pub model: Option<String>,
    /// Where its cameras are comes with it, or lies beside it.
    pub calibrated: bool,
}

/// Joints and gripper at every frame.
#[derive(Debug, Clone)]
pub(crate) struct States {
    pub(crate) joint_names: Vec<String>,
    /// `[F, J]`
    pub(crate) positions: Vec<f64>,
    /// `[F]`
    pub(crate) gripper: Vec<f64>,
}

/// Tracks with anchor pixels of the recorded images, as stored.
#[derive(Debug)]
pub(crate) struct SourceTracks {
    /// Episode frame.
    pub(crate) anchor_frame: EpisodeFrame,
    /// Index into the episode's cameras. `[K]`
    pub(crate) camera: Vec<u32>,
    /// `[K, 2]`
    pub(crate) pixel: Vec<f32>,
    /// `[K, F, 3]`
    pub(crate) position_m: Vec<f32>,
    /// `[K, F]`
    pub(crate) visible: Vec<u8>,
    pub(crate) origin: ReferenceOrigin,
}
