//! A camera and where it stands.

use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, FrameIndex};

use crate::error::{Error, Result};
use crate::pinhole::Pinhole;
use crate::pose::{Base, Camera, Frame, Pose};

/// A pinhole camera that stands in frame `W`. The rasteriser and the networks make their own form of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosedCamera<W: Frame> {
    /// Focal lengths, principal point and image size, pixels.
    pub lens: Pinhole,
    /// Where it stands, metres.
    pub world_from_camera: Pose<W, Camera>,
}

impl<W: Frame> PosedCamera<W> {
    /// A camera at a pose in metres.
    #[must_use]
    pub const fn new(lens: Pinhole, world_from_camera: Pose<W, Camera>) -> Self {
        Self {
            lens,
            world_from_camera,
        }
    }

    /// The same camera in a frame in which its own one stands at `v_from_w`, metres.
    #[must_use]
    pub fn in_frame<V: Frame>(&self, v_from_w: &Pose<V, W>) -> PosedCamera<V> {
        PosedCamera::new(self.lens, *v_from_w * self.world_from_camera)
    }
}

impl PosedCamera<Base> {
    /// A camera of a clip at a clip frame, in the frame of the robot's base.
    ///
    /// # Errors
    /// When the clip has no such camera, the robot maps have no pose of it at this frame, or the pose is not rigid.
    pub fn of_clip(clip: &Clip, robot: &RobotMaps, camera: CameraIndex, frame: FrameIndex) -> Result<Self> {
        let frames = clip.frame_count();
        let view = clip.cameras.get(camera.at());
        let name = || view.map_or_else(|| camera.to_string(), |view| view.id.clone());
        let stored = robot
            .base_from_camera
            .get(camera.at() * frames + frame.at())
            .filter(|_| frame.at() < frames);
        let (Some(view), Some(stored)) = (view, stored) else {
            return Err(Error::NoPose { camera: name(), frame });
        };
        let pose = Pose::from_rigid(stored).map_err(|error| match error {
            Error::NotRigid { what } => Error::NotRigid {
                what: format!("camera `{}`, frame {frame}: {what}", view.id),
            },
            other => other,
        })?;
        Ok(Self::new(Pinhole::of_clip(clip, view), pose))
    }
}
