//! Robot maps: where the robot and the cameras are at every frame of a clip.

use serde::{Deserialize, Serialize};

use super::check::{Check, area, binary, count, ensure, finite, pose};
use crate::ids::ClipId;
use crate::index::{CameraIndex, FrameIndex};
use crate::pose::RigidPose;

/// Written by `robot-maps`: link transforms, resolved camera poses, mesh depth and link ids.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotMaps {
    /// The clip this belongs to.
    pub clip_id: ClipId,
    /// Names of all URDF links; a link id is an index into this list. `[L]`
    pub link_names: Vec<String>,
    /// Link-to-base transforms, metres. `[F, L]`, frame-major
    pub base_from_link: Vec<RigidPose>,
    /// Camera-to-base pose of every camera of the clip at every frame. `[C, F]`, camera-major
    pub base_from_camera: Vec<RigidPose>,
    /// H, base-to-reconstruction: the inverse of the first source camera's pose at the first source frame.
    pub recon_from_base: RigidPose,
    /// Tool centre in the base frame, metres, per frame (`docs/spec/stage1.md` section 11). `[F, 3]`
    pub tool_m: Vec<f64>,
    /// Map height, pixels.
    pub height: u32,
    /// Map width, pixels.
    pub width: u32,
    /// One map per (source camera, frame), camera-major, frames ascending.
    pub maps: Vec<RobotMap>,
}

/// Value of [`RobotMap::link`] where no robot surface covers the pixel centre.
pub const NO_LINK: u8 = 255;

/// What the articulated mesh looks like in one camera at one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotMap {
    /// Index into the clip's cameras.
    pub camera: CameraIndex,
    /// Clip frame.
    pub frame: FrameIndex,
    /// Camera-z depth of the mesh at the pixel centre, metres; 0 where nothing is hit. `[H, W]`
    pub depth_m: Vec<f32>,
    /// Link id, [`NO_LINK`] where nothing is hit. `[H, W]`
    pub link: Vec<u8>,
    /// 1 on valid robot support: hit, depth in range, eroded at boundaries (`docs/spec/stage1.md` section 10). `[H, W]`
    pub support: Vec<u8>,
}

/// How a robot model is turned into maps: which joints, which meshes, which tool. Part of the stage's parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RobotSpec {
    /// Name of the root link all poses refer to.
    pub base_link: String,
    /// Joint driven by the gripper state.
    pub gripper_joint: String,
    /// Joint value at gripper state 1 (closed), radians or metres.
    pub gripper_closed: f64,
    /// Joint value at gripper state 0 (open), radians or metres.
    pub gripper_open: f64,
    /// Link whose frame carries the tool centre.
    pub tool_link: String,
    /// Tool centre in the tool link's frame, metres.
    pub tool_offset_m: [f64; 3],
    /// Links (exact names, or with a trailing or leading `*`) that are not part of the anchor mesh.
    pub exclude_links: Vec<String>,
    /// Links (same patterns) whose collision geometry is the anchor mesh; all others use visual geometry.
    pub collision_links: Vec<String>,
    /// Axes of mesh files: as robot viewers take them, or as the standards of the formats say.
    pub mesh_axes: MeshAxes,
}

/// Whose rule says which way is up in a mesh file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MeshAxes {
    /// That of robot viewers: numbers are in the link's frame, whatever axis COLLADA or glTF call up.
    #[default]
    Viewers,
    /// That of the formats: the axis that COLLADA names, or y in glTF, becomes the link's z.
    Standard,
}

impl Default for RobotSpec {
    /// Panda with the Robotiq 2F-85 as in the paper: collision meshes of the arm, visual meshes of the gripper.
    fn default() -> Self {
        Self {
            base_link: "panda_link0".into(),
            gripper_joint: "finger_joint".into(),
            gripper_closed: 0.725,
            gripper_open: 0.0,
            tool_link: "robotiq_85_base_link".into(),
            tool_offset_m: [0.0, 0.0, 0.12],
            exclude_links: vec!["*_sc".into(), "camera_mount_link".into()],
            collision_links: vec!["panda_link*".into()],
            mesh_axes: MeshAxes::Viewers,
        }
    }
}

impl RobotMaps {
    /// The arrays agree with the counts, and every number is possible.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        let area = area(self.height, self.width)?;
        let links = self.link_names.len();
        ensure((1..=usize::from(NO_LINK)).contains(&links), || format!("{links} links"))?;
        let frames = self.base_from_link.len() / links;
        ensure(frames > 0, || "there are no link poses".into())?;
        count("link poses", self.base_from_link.len(), frames * links)?;
        ensure(self.base_from_camera.len().is_multiple_of(frames), || {
            format!("{} camera poses for {frames} frames", self.base_from_camera.len())
        })?;
        let cameras = self.base_from_camera.len() / frames;
        self.base_from_link
            .iter()
            .try_for_each(|item| pose("a link pose", item))?;
        self.base_from_camera
            .iter()
            .try_for_each(|item| pose("a camera pose", item))?;
        pose("recon_from_base", &self.recon_from_base)?;
        count("tool positions", self.tool_m.len(), 3 * frames)?;
        finite("a tool position", &self.tool_m)?;
        let ascending = self.maps.is_sorted_by(|a, b| (a.camera, a.frame) < (b.camera, b.frame));
        ensure(ascending, || "maps are not in camera-major order".into())?;
        for map in &self.maps {
            let RobotMap {
                camera,
                frame,
                depth_m,
                link,
                support,
            } = map;
            let here = |what: String| format!("map of camera {camera}, frame {frame}: {what}");
            ensure(camera.at() < cameras && frame.at() < frames, || {
                here(format!("there are {cameras} cameras and {frames} frames"))
            })?;
            for (what, length) in [
                ("depth", depth_m.len()),
                ("link", link.len()),
                ("support", support.len()),
            ] {
                count(what, length, area).map_err(here)?;
            }
            binary("support", support).map_err(here)?;
            ensure(
                link.iter().all(|&link| link == NO_LINK || usize::from(link) < links),
                || here(format!("a link id is not among the {links} links")),
            )?;
            ensure(depth_m.iter().all(|depth| depth.is_finite() && *depth >= 0.0), || {
                here("a depth is negative or not finite".into())
            })?;
        }
        Ok(())
    }
}
