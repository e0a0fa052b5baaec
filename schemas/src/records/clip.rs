//! The clip: one fixed interval of one episode, with its cameras, robot states and references.
//!
//! A clip tells what is reconstructed ([`Clip::observation`]) from what a reconstruction is compared with
//! ([`Clip::target`], reference depth, tracks). In a recorded clip both are the recorded images; in a rollout
//! ([`Clip::rollout`]) observations are frames of a world model, while targets and references stay the recorded ones.

use serde::{Deserialize, Serialize};

use super::check::{Check, area, ascending_frames, binary, count, ensure, finite, pose, product};
use crate::ids::ClipId;
use crate::index::{CameraIndex, EpisodeFrame, FrameIndex};
use crate::pose::{Intrinsics, RigidPose};
use crate::records::origin::{ReferenceKind, ReferenceOrigin, ReferenceUse};

/// One clip, written by `ingest`. Frames are counted inside the clip: `0..frame_count()`.
#[derive(Debug, Clone, PartialEq)]
pub struct Clip {
    /// Name of the clip, unique in a run.
    pub clip_id: ClipId,
    /// Episode id of the dataset (a DROID uuid where there is one).
    pub episode_id: String,
    /// Which importer read it: `rogs-episode`, `droid-raw`, `droid-ctrlworld`, `lerobot-v2.1`, `lerobot-v3.0`,
    /// `agibot`.
    pub layout: String,
    /// Language instruction; may be empty.
    pub task: String,
    /// Where the calibration comes from and how far to trust it, in words for the report.
    pub calibration_note: String,
    /// Frames per second of the clip.
    pub fps: f64,
    /// Index in the episode of every clip frame. `[F]`
    pub episode_frames: Vec<EpisodeFrame>,
    /// Source times as clip frames, ascending (default 0, 4, 8, 12, 16).
    pub source_frames: Vec<FrameIndex>,
    /// Distinct query times as clip frames, ascending (`docs/spec/scoring.md` section 3).
    pub query_frames: Vec<FrameIndex>,
    /// Anchor time of displacement scores, a clip frame.
    pub anchor_frame: FrameIndex,
    /// Image height of every camera, pixels.
    pub height: u32,
    /// Image width of every camera, pixels.
    pub width: u32,
    /// Source cameras first (wrist, ext1, ext2), then evaluation cameras.
    pub cameras: Vec<ClipCamera>,
    /// Robot states at every frame.
    pub robot: RobotStates,
    /// 3D tracks, where the episode has them.
    pub tracks: Option<Tracks>,
    /// The world model whose frames are the observations of this clip; `None`: the recorded images are.
    pub rollout: Option<Rollout>,
}

/// Where the observations of a rollout come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rollout {
    /// The model, in words; empty where nobody named it.
    pub model: String,
    /// How its frames lay on disk: `composite`, `views`, `ctrl-world`.
    pub layout: String,
    /// Frames of the files that are clip frames 0 and 1, as a start and a step.
    pub frames: [u32; 2],
    /// How far the first generated frame is the first recorded one, by camera of the clip: PSNR over the clip's pixels,
    /// dB; none where there is no recorded or no generated image. `[C]`
    pub first_frame_psnr_db: Vec<Option<f64>>,
}

/// What a camera is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum CameraRole {
    /// Its images are reconstruction inputs (left eyes).
    Source,
    /// Held out: renders are compared with it, it is never an input (right eyes).
    Evaluation,
}

/// How the pose of a camera is known. All poses are camera-to-something, OpenCV camera axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum CameraMount {
    /// One pose for the whole clip.
    Fixed {
        /// Camera-to-base.
        base_from_camera: RigidPose,
    },
    /// A supplied pose for every clip frame.
    Trajectory {
        /// Camera-to-base. `[F]`
        base_from_camera: Vec<RigidPose>,
    },
    /// Rigid to a robot link; the pose follows from forward kinematics (`robot-maps` resolves it).
    HandEye {
        /// Name of the URDF link.
        link: String,
        /// Camera-to-link.
        link_from_camera: RigidPose,
    },
}

/// One camera of a clip with its images and references, all at the clip's resolution.
#[derive(Debug, Clone, PartialEq)]
pub struct ClipCamera {
    /// Name: `wrist`, `ext1`, `ext2`, and for right eyes `wrist_right`, `ext1_right`, `ext2_right`.
    pub id: String,
    /// Input or held out.
    pub role: CameraRole,
    /// For an evaluation camera: index of the source camera whose stereo partner it is.
    pub partner: Option<CameraIndex>,
    /// Intrinsics at the clip's resolution.
    pub intrinsics: Intrinsics,
    /// Pose.
    pub mount: CameraMount,
    /// Recorded RGB, 8 bit. `[F, H, W, 3]`; `None` when the episode has no images of this camera (nothing to compare
    /// with). Stages read [`Clip::observation`] and [`Clip::target`].
    pub recorded: Option<Vec<u8>>,
    /// RGB that a world model made, 8 bit. `[F, H, W, 3]`; of every source camera of a rollout, and of no other.
    pub generated: Option<Vec<u8>>,
    /// Reference depth, where there is any.
    pub depth: Option<DepthReference>,
}

/// Reference depth of one camera (stereo estimate or exact): camera z in metres.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthReference {
    /// Camera-z depth, metres, NaN where unknown. `[F, H, W]`
    pub depth_m: Vec<f32>,
    /// Depths outside this open interval are not scored, metres (default 0.1 to 5).
    pub range_m: [f32; 2],
    /// What made it.
    pub origin: ReferenceOrigin,
}

/// Joint and gripper states at every clip frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotStates {
    /// Names of the driven arm joints, as in the URDF. `[J]`
    pub joint_names: Vec<String>,
    /// Joint positions, radians (metres for prismatic joints). `[F, J]`
    pub positions: Vec<f64>,
    /// Normalised gripper state in [0, 1]: 0 open, 1 closed. `[F]`
    pub gripper: Vec<f64>,
}

/// 3D point tracks in the robot base frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracks {
    /// Clip frame in which the anchor pixels lie.
    pub anchor_frame: FrameIndex,
    /// Index of the (source) camera of each track's anchor pixel. `[K]`
    pub camera: Vec<CameraIndex>,
    /// Anchor pixel `(x, y)` with INTEGER pixel centres: pixel (column j, row i) has its centre at (j, i), as the
    /// scorer's nearest-pixel rule `floor(x + 0.5)` expects. `[K, 2]`
    pub pixel: Vec<f32>,
    /// Positions in the base frame, metres, NaN where undefined. `[K, F, 3]`
    pub position_m: Vec<f32>,
    /// 1 where the point is visible in its anchor camera at that frame. `[K, F]`
    pub visible: Vec<u8>,
    /// What made them.
    pub origin: ReferenceOrigin,
}

/// How [`Clip::calibration_note`] begins for episodes of the procedural generator.
pub const PROCEDURAL_NOTE: &str = "procedural:";

/// An image that a reconstruction may be made from, 8 bit. `[H, W, 3]`
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Observation<'a>(&'a [u8]);

/// An image that a reconstruction is compared with, 8 bit. `[H, W, 3]`
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Target<'a>(&'a [u8]);

impl<'a> Observation<'a> {
    /// Its pixels.
    #[must_use]
    pub fn rgb(self) -> &'a [u8] {
        self.0
    }
}

impl<'a> Target<'a> {
    /// Its pixels.
    #[must_use]
    pub fn rgb(self) -> &'a [u8] {
        self.0
    }
}

/// The setting of a clip whose observations are recorded.
pub const RECORDED: &str = "recorded";
/// The setting of a clip whose observations a world model made.
pub const ROLLOUT: &str = "rollout";

impl Clip {
    /// What a source camera shows of a clip frame to whoever reconstructs it: the recorded image, or in a rollout the
    /// generated one. `None` for cameras that are held out, and where there is no image.
    #[must_use]
    pub fn observation(&self, view: SourceView) -> Option<Observation<'_>> {
        let camera = self.cameras.get(view.camera.at())?;
        let images = match (&self.rollout, camera.role) {
            (_, CameraRole::Evaluation) => return None,
            (None, CameraRole::Source) => camera.recorded.as_deref()?,
            (Some(_), CameraRole::Source) => camera.generated.as_deref()?,
        };
        self.image(images, view.frame).map(Observation)
    }

    /// The recorded image of a camera at a clip frame, which renders are compared with; `None` where there is none.
    #[must_use]
    pub fn target(&self, camera: CameraIndex, frame: FrameIndex) -> Option<Target<'_>> {
        let images = self.cameras.get(camera.at())?.recorded.as_deref()?;
        self.image(images, frame).map(Target)
    }

    fn image<'a>(&self, images: &'a [u8], frame: FrameIndex) -> Option<&'a [u8]> {
        let size = self.height as usize * self.width as usize * 3;
        let start = frame.at().checked_mul(size)?;
        images.get(start..start.checked_add(size)?)
    }

    /// What score tables call the observations: [`RECORDED`] or [`ROLLOUT`].
    #[must_use]
    pub fn setting(&self) -> &'static str {
        match self.rollout {
            None => RECORDED,
            Some(_) => ROLLOUT,
        }
    }

    /// Whether the clip comes from the procedural generator and not from a camera or a video model.
    #[must_use]
    pub fn is_procedural(&self) -> bool {
        self.calibration_note.starts_with(PROCEDURAL_NOTE)
    }

    /// Number of frames of the clip (17 by default).
    #[must_use]
    pub fn frame_count(&self) -> usize {
        self.episode_frames.len()
    }

    /// Indices of the source cameras, in order.
    #[must_use]
    pub fn source_cameras(&self) -> Vec<CameraIndex> {
        let cameras = CameraIndex::first(self.cameras.len()).zip(&self.cameras);
        cameras
            .filter_map(|(index, camera)| (camera.role == CameraRole::Source).then_some(index))
            .collect()
    }

    /// The times at which a field must be known to score this clip: source, query and anchor frames, ascending.
    #[must_use]
    pub fn field_frames(&self) -> Vec<FrameIndex> {
        let mut frames: Vec<FrameIndex> = self.source_frames.iter().chain(&self.query_frames).copied().collect();
        frames.push(self.anchor_frame);
        frames.sort_unstable();
        frames.dedup();
        frames
    }

    /// What the clip can be scored against: depth by camera, then tracks.
    #[must_use]
    pub fn references(&self) -> Vec<ReferenceUse> {
        let depth = self.cameras.iter().filter_map(|camera| {
            Some(ReferenceUse {
                kind: ReferenceKind::Depth,
                camera: camera.id.clone(),
                origin: camera.depth.as_ref()?.origin,
            })
        });
        let tracks = self.tracks.as_ref().map(|tracks| ReferenceUse {
            kind: ReferenceKind::Tracks,
            camera: String::new(),
            origin: tracks.origin,
        });
        depth.chain(tracks).collect()
    }

    /// Source views in the order of the Stage-1 tokens: camera-major, source cameras in order, times ascending.
    #[must_use]
    pub fn source_views(&self) -> Vec<SourceView> {
        let frames = &self.source_frames;
        self.source_cameras()
            .iter()
            .flat_map(|&camera| frames.iter().map(move |&frame| SourceView { camera, frame }))
            .collect()
    }
}

/// One source image: a camera of the clip at a clip frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct SourceView {
    /// Index into the clip's cameras.
    pub camera: CameraIndex,
    /// Clip frame.
    pub frame: FrameIndex,
}

/// Normalised time in [0, 1] of a clip frame: frame / (frame count - 1), so that 17 frames give k/16 exactly.
#[must_use]
pub fn time_of_frame(frame: FrameIndex, frame_count: usize) -> f64 {
    if frame_count <= 1 {
        0.0
    } else {
        f64::from(frame.0) / (frame_count - 1) as f64
    }
}

impl Clip {
    /// The arrays agree with the counts, and every number is possible.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        let area = area(self.height, self.width)?;
        let frames = self.frame_count();
        ensure((1..=65_536).contains(&frames), || format!("{frames} frames"))?;
        ensure(self.fps.is_finite() && self.fps > 0.0, || {
            format!("{} frames per second", self.fps)
        })?;
        ascending_frames("source frames", &self.source_frames, frames)?;
        ascending_frames("query frames", &self.query_frames, frames)?;
        ensure(!self.source_frames.is_empty(), || "there is no source frame".into())?;
        ensure(self.anchor_frame.at() < frames, || {
            format!("anchor frame {} of {frames}", self.anchor_frame)
        })?;
        ensure((1..=255).contains(&self.cameras.len()), || {
            format!("{} cameras", self.cameras.len())
        })?;
        for camera in &self.cameras {
            self.check_camera(camera, frames, area)
                .map_err(|what| format!("camera `{}`: {what}", camera.id))?;
        }
        let RobotStates {
            joint_names,
            positions,
            gripper,
        } = &self.robot;
        count(
            "joint positions",
            positions.len(),
            product("joints", &[frames, joint_names.len()])?,
        )?;
        finite("a joint position", positions)?;
        count("gripper states", gripper.len(), frames)?;
        finite("a gripper state", gripper)?;
        if let Some(rollout) = &self.rollout {
            count(
                "first-frame figures",
                rollout.first_frame_psnr_db.len(),
                self.cameras.len(),
            )?;
            let mut figures = rollout.first_frame_psnr_db.iter().flatten();
            ensure(!figures.any(|figure| figure.is_nan()), || {
                "a first-frame figure is NaN".into()
            })?;
        }
        match &self.tracks {
            None => Ok(()),
            Some(tracks) => tracks.check(self.cameras.len(), frames),
        }
    }

    fn check_camera(&self, camera: &ClipCamera, frames: usize, area: usize) -> Check {
        let Intrinsics { fx, fy, cx, cy } = camera.intrinsics;
        finite("an intrinsic", &[fx, fy, cx, cy])?;
        ensure(fx > 0.0 && fy > 0.0, || {
            format!("focal lengths {fx} and {fy} are not above 0")
        })?;
        if let Some(partner) = camera.partner {
            let other = self.cameras.get(partner.at());
            ensure(other.is_some_and(|other| other.role == CameraRole::Source), || {
                format!("its partner {partner} is not a source camera")
            })?;
        }
        match &camera.mount {
            CameraMount::Fixed { base_from_camera } => pose("its pose", base_from_camera)?,
            CameraMount::HandEye { link_from_camera, .. } => pose("its pose", link_from_camera)?,
            CameraMount::Trajectory { base_from_camera } => {
                count("its trajectory", base_from_camera.len(), frames)?;
                base_from_camera
                    .iter()
                    .try_for_each(|item| pose("a pose of its trajectory", item))?;
            }
        }
        for (what, rgb) in [("rgb", &camera.recorded), ("generated rgb", &camera.generated)] {
            if let Some(rgb) = rgb {
                count(what, rgb.len(), product(what, &[frames, area, 3])?)?;
            }
        }
        let generated = self.rollout.is_some() && camera.role == CameraRole::Source;
        ensure(camera.generated.is_some() == generated, || {
            "source cameras of a rollout, and they alone, have generated images".into()
        })?;
        if let Some(depth) = &camera.depth {
            count("depth", depth.depth_m.len(), product("depth", &[frames, area])?)?;
            let [near, far] = depth.range_m;
            ensure(near.is_finite() && far.is_finite() && near < far, || {
                format!("its depth range is {near} to {far}")
            })?;
        }
        Ok(())
    }
}

impl Tracks {
    /// The arrays agree with the counts, and every track lies in one of so many cameras.
    pub(crate) fn check(&self, cameras: usize, frames: usize) -> Check {
        let points = self.camera.len();
        ensure(self.anchor_frame.at() < frames, || {
            format!("track anchor {} of {frames}", self.anchor_frame)
        })?;
        count("track pixels", self.pixel.len(), product("tracks", &[points, 2])?)?;
        count(
            "track positions",
            self.position_m.len(),
            product("tracks", &[points, frames, 3])?,
        )?;
        count(
            "track visibility",
            self.visible.len(),
            product("tracks", &[points, frames])?,
        )?;
        binary("track visibility", &self.visible)?;
        ensure(self.camera.iter().all(|camera| camera.at() < cameras), || {
            format!("a track lies in a camera that is not among the {cameras}")
        })
    }
}
