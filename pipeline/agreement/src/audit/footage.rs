//! What is audited: the images of a clip with cameras and robot states as its files say they are.

use rogs_geometry::{Base, Camera, Link, Pinhole, Pose};
use rogs_robot::{MeshScene, RobotModel};
use rogs_schemas::records::clip::CameraMount;
use rogs_schemas::records::robot::RobotSpec;

use crate::{Error, Result};

/// How the pose of a camera is known.
#[derive(Debug, Clone, PartialEq)]
pub enum Mount {
    /// One camera-to-base pose.
    Fixed(Pose<Base, Camera>),
    /// A camera-to-base pose for every frame.
    Path(Vec<Pose<Base, Camera>>),
    /// Rigid to a link.
    Hand {
        /// Id of the link.
        link: usize,
        /// Camera-to-link.
        link_from_camera: Pose<Link, Camera>,
    },
}

impl Mount {
    /// The mount of a camera as its clip has it.
    ///
    /// # Errors
    /// When a pose is not rigid, or the robot lacks the link.
    pub fn of_clip(mount: &CameraMount, model: &RobotModel) -> Result<Self> {
        let wrong = |error: rogs_geometry::Error| Error {
            what: error.to_string(),
        };
        Ok(match mount {
            CameraMount::Fixed { base_from_camera } => Self::Fixed(Pose::from_rigid(base_from_camera).map_err(wrong)?),
            CameraMount::Trajectory { base_from_camera } => {
                let poses = base_from_camera.iter().map(Pose::from_rigid);
                Self::Path(poses.collect::<std::result::Result<_, _>>().map_err(wrong)?)
            }
            CameraMount::HandEye { link, link_from_camera } => Self::Hand {
                link: model.link_id(link).map_err(|error| Error { what: error.chain() })?,
                link_from_camera: Pose::from_rigid(link_from_camera).map_err(wrong)?,
            },
        })
    }

    /// The same camera moved in its own frame.
    #[must_use]
    pub fn moved(&self, by: Pose<Camera, Camera>) -> Self {
        match self {
            Self::Fixed(pose) => Self::Fixed(*pose * by),
            Self::Path(poses) => Self::Path(poses.iter().map(|&pose| pose * by).collect()),
            Self::Hand { link, link_from_camera } => Self::Hand {
                link: *link,
                link_from_camera: *link_from_camera * by,
            },
        }
    }
}

/// A camera and what it filmed.
#[derive(Debug, Clone)]
pub struct Filmed<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its intrinsics at the size of the images.
    pub lens: Pinhole,
    /// Its pose.
    pub mount: Mount,
    /// RGB, 8 bit. `[F][H, W, 3]`
    pub images: Vec<&'a [u8]>,
}

/// A clip to audit.
#[derive(Debug, Clone)]
pub struct Footage<'a> {
    /// Kinematics.
    pub model: &'a RobotModel,
    /// Meshes.
    pub scene: &'a MeshScene,
    /// Gripper joint and its range.
    pub spec: &'a RobotSpec,
    /// Driven joints.
    pub joint_names: &'a [String],
    /// Their values, radians or metres. `[F, J]`
    pub positions: &'a [f64],
    /// 0 open, 1 closed. `[F]`
    pub gripper: &'a [f64],
    /// The cameras.
    pub cameras: Vec<Filmed<'a>>,
}

impl Footage<'_> {
    /// Number of frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.gripper.len()
    }

    /// Link-to-base poses at every frame of given joint values and gripper states.
    ///
    /// # Errors
    /// When the joints do not fit the robot.
    pub(super) fn kinematics(&self, positions: &[f64], gripper: &[f64]) -> Result<Vec<Vec<Pose<Base, Link>>>> {
        let joints = self.joint_names.len();
        let poses = |frame: usize| {
            let values = positions.get(frame * joints..(frame + 1) * joints).unwrap_or_default();
            let state = self
                .model
                .robot_state(self.spec, self.joint_names, values, gripper[frame]);
            let state = state.map_err(|error| Error {
                what: format!("frame {frame}: {}", error.chain()),
            })?;
            Ok(self.model.fk(&state))
        };
        (0..gripper.len()).map(poses).collect()
    }

    /// Whether the arrays fit together.
    ///
    /// # Errors
    /// What does not fit.
    pub fn check(&self) -> Result<()> {
        let wrong = |what: String| Err(Error { what });
        let (frames, joints) = (self.frames(), self.joint_names.len());
        if frames == 0 || self.positions.len() != frames * joints {
            let found = self.positions.len();
            return wrong(format!("{found} joint values for {frames} frames of {joints} joints"));
        }
        for camera in &self.cameras {
            let name = camera.name;
            let bytes = 3 * camera.lens.width as usize * camera.lens.height as usize;
            if !camera.lens.is_valid() {
                return wrong(format!("camera `{name}`: {:?} is no camera", camera.lens));
            }
            if camera.images.len() != frames || camera.images.iter().any(|image| image.len() != bytes) {
                let (width, height) = (camera.lens.width, camera.lens.height);
                return wrong(format!(
                    "camera `{name}`: expected {frames} images of {width}x{height} pixels"
                ));
            }
            match &camera.mount {
                Mount::Path(poses) if poses.len() != frames => {
                    return wrong(format!("camera `{name}`: {} poses for {frames} frames", poses.len()));
                }
                Mount::Hand { link, .. } if *link >= self.model.links.len() => {
                    return wrong(format!("camera `{name}`: the robot has no link {link}"));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// `count` frames, evenly from the first to the last.
pub(super) fn evenly(frames: usize, count: usize) -> Vec<usize> {
    let count = count.clamp(1, frames.max(1));
    let mut chosen: Vec<usize> = (0..count)
        .map(|i| i * (frames.saturating_sub(1)) / (count - 1).max(1))
        .collect();
    chosen.dedup();
    chosen
}
