//! From a clip and a robot to robot maps.

use std::path::Path;

use rayon::prelude::*;
use rogs_geometry::{Base, Camera, Link, Pinhole, Pose, unit_factor};
use rogs_robot::limits::LimitTally;
use rogs_robot::raster::Renderer;
use rogs_robot::{JointState, MeshScene, RenderOptions, RobotModel};
use rogs_schemas::records::clip::{CameraMount, Clip, ClipCamera};
use rogs_schemas::records::robot::{RobotMap, RobotMaps};
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_worker::{Observer, StageError, StageResult};

use crate::params::Params;
use crate::support::valid_support;

/// A robot with its meshes, read once for many clips.
#[derive(Debug)]
pub struct Robot {
    model: RobotModel,
    scene: MeshScene,
    tool_link: usize,
}

impl Robot {
    /// Reads a URDF and the meshes that the parameters select.
    ///
    /// # Errors
    /// When the robot cannot be read, or a link or joint of the parameters does not exist.
    pub fn load(urdf: &Path, params: &Params) -> StageResult<Self> {
        let spec = &params.robot;
        let of_params = |what: String| {
            StageError::bad_params(format!("{what} (robot parameters, `{}`)", urdf.display())).with_hint(
                "name the robot's links and joints under [robot.spec] of the manifest (`rogs init FOLDER --robot URDF` \
                 writes them); `gripper_joint = \"\"` for a robot without gripper",
            )
        };
        let model = RobotModel::load(urdf).map_err(bad_input)?;
        // Every name that is missing at once: who describes another robot misses several.
        let asked = [
            ("base_link", model.link_id(&spec.base_link).map(drop)),
            ("tool_link", model.link_id(&spec.tool_link).map(drop)),
            (
                "gripper_joint",
                match spec.gripper_joint.as_str() {
                    "" => Ok(()),
                    joint => model.joint_index(joint).map(drop),
                },
            ),
        ];
        let missing = asked
            .into_iter()
            .filter_map(|(key, found)| Some(format!("`{key}`: {}", found.err()?.chain())));
        let missing: Vec<String> = missing.collect();
        if !missing.is_empty() {
            return Err(of_params(missing.join("; ")));
        }
        let of_name = |error: rogs_robot::Error| of_params(error.chain());
        let model = model.with_base_link(&spec.base_link).map_err(of_name)?;
        let tool_link = model.link_id(&spec.tool_link).map_err(of_name)?;
        let scene = MeshScene::of_robot(&model, spec).map_err(bad_input)?;
        Ok(Self {
            model,
            scene,
            tool_link,
        })
    }

    /// What the description and the meshes say that nothing here uses, or leave open.
    pub fn notes(&self) -> impl Iterator<Item = String> + '_ {
        let notes = self.model.notes.iter().chain(&self.scene.notes);
        notes.map(|note| format!("robot `{}`: {note}", self.model.name))
    }

    /// The kinematic model.
    #[must_use]
    pub fn model(&self) -> &RobotModel {
        &self.model
    }

    /// The anchor meshes.
    #[must_use]
    pub fn scene(&self) -> &MeshScene {
        &self.scene
    }
}

/// Makes the robot maps of a clip; `observer` hears the warnings.
///
/// # Errors
/// When joints, poses or cameras of the clip do not fit the robot.
pub fn build(clip: &Clip, robot: &Robot, params: &Params, observer: &mut dyn Observer) -> StageResult<RobotMaps> {
    robot.notes().for_each(|note| observer.warn(note));
    let states = joint_states(clip, robot, params)?;
    let mut tally = LimitTally::new(&robot.model);
    states.iter().for_each(|state| tally.add(state));
    for warning in tally.warnings("frames", "unit = \"degrees\" under [ingest.states]") {
        observer.warn(warning);
    }
    let base_from_link: Vec<Vec<Pose<Base, Link>>> = states.iter().map(|state| robot.model.fk(state)).collect();
    let mut base_from_camera = Vec::new();
    for camera in &clip.cameras {
        base_from_camera.push(camera_poses(camera, &robot.model, &base_from_link)?);
    }
    misplaced_cameras(clip)
        .into_iter()
        .for_each(|warning| observer.warn(warning));
    let source_cameras = clip.source_cameras();
    let first_camera = *source_cameras
        .first()
        .ok_or_else(|| StageError::bad_input("the clip has no source camera"))?;
    let first_frame = *clip
        .source_frames
        .first()
        .ok_or_else(|| StageError::bad_input("the clip has no source frame"))?;
    let first_pose = base_from_camera[first_camera.at()].get(first_frame.at());
    let first_pose =
        first_pose.ok_or_else(|| StageError::bad_input(format!("source frame {first_frame} is not in the clip")))?;
    let tool_offset = params.robot.tool_offset_m.into();
    let tool = base_from_link
        .iter()
        .flat_map(|links| links[robot.tool_link].point(tool_offset).to_array());
    let maps = draw(clip, robot, params, &source_cameras, &base_from_camera, &base_from_link)?;
    depth_warnings(clip, &maps)
        .into_iter()
        .for_each(|warning| observer.warn(warning));
    Ok(RobotMaps {
        clip_id: clip.clip_id.clone(),
        link_names: robot.model.link_names(),
        base_from_link: base_from_link.iter().flatten().map(Pose::to_rigid).collect(),
        base_from_camera: base_from_camera.iter().flatten().map(Pose::to_rigid).collect(),
        recon_from_base: first_pose.inverse().to_rigid(),
        tool_m: tool.collect(),
        height: clip.height,
        width: clip.width,
        maps,
    })
}

fn joint_states(clip: &Clip, robot: &Robot, params: &Params) -> StageResult<Vec<JointState>> {
    let joints = clip.robot.joint_names.len();
    let state = |frame: usize| {
        let positions = &clip.robot.positions[frame * joints..(frame + 1) * joints];
        let state = robot.model.robot_state(
            &params.robot,
            &clip.robot.joint_names,
            positions,
            clip.robot.gripper[frame],
        );
        state.map_err(|error| {
            StageError::bad_input(format!("clip `{}`, frame {frame}: {}", clip.clip_id, error.chain()))
        })
    };
    (0..clip.frame_count()).map(state).collect()
}

/// The pose of a camera at every frame.
fn camera_poses(
    camera: &ClipCamera,
    model: &RobotModel,
    base_from_link: &[Vec<Pose<Base, Link>>],
) -> StageResult<Vec<Pose<Base, Camera>>> {
    let frames = base_from_link.len();
    let wrong = |error: &dyn std::error::Error| StageError::bad_input(format!("camera `{}`: {error}", camera.id));
    let bad_pose = |error: rogs_geometry::Error| wrong(&error);
    match &camera.mount {
        CameraMount::Fixed { base_from_camera } => {
            Ok(vec![Pose::from_rigid(base_from_camera).map_err(bad_pose)?; frames])
        }
        CameraMount::Trajectory { base_from_camera } => {
            if base_from_camera.len() != frames {
                let count = base_from_camera.len();
                return Err(StageError::bad_input(format!(
                    "camera `{}` has {count} poses for {frames} frames",
                    camera.id
                )));
            }
            base_from_camera
                .iter()
                .map(|pose| Pose::from_rigid(pose).map_err(bad_pose))
                .collect()
        }
        CameraMount::HandEye { link, link_from_camera } => {
            let link = model.link_id(link).map_err(|error| wrong(&error))?;
            let link_from_camera: Pose<Link, Camera> = Pose::from_rigid(link_from_camera).map_err(bad_pose)?;
            Ok(base_from_link
                .iter()
                .map(|links| links[link] * link_from_camera)
                .collect())
        }
    }
}

/// Rasterises every source camera at every frame, camera-major.
fn draw(
    clip: &Clip,
    robot: &Robot,
    params: &Params,
    source_cameras: &[CameraIndex],
    base_from_camera: &[Vec<Pose<Base, Camera>>],
    base_from_link: &[Vec<Pose<Base, Link>>],
) -> StageResult<Vec<RobotMap>> {
    let views: Vec<(CameraIndex, FrameIndex)> = source_cameras
        .iter()
        .flat_map(|&camera| FrameIndex::first(clip.frame_count()).map(move |frame| (camera, frame)))
        .collect();
    let draw_view = |renderer: &mut Renderer<'_>, &(camera, frame): &(CameraIndex, FrameIndex)| {
        let lens = Pinhole::of_clip(clip, &clip.cameras[camera.at()]);
        let camera_from_base = base_from_camera[camera.at()][frame.at()].inverse();
        let camera_from_link: Vec<Pose<Camera, Link>> = base_from_link[frame.at()]
            .iter()
            .map(|&pose| camera_from_base * pose)
            .collect();
        // Views are drawn in parallel, each with one thread.
        let image = renderer
            .render(&lens, &camera_from_link, &RenderOptions::default(), 1)
            .map_err(bad_input)?;
        let support = valid_support(&image.depth_m, &image.link, clip.width, clip.height, &params.support);
        Ok(RobotMap {
            camera,
            frame,
            depth_m: image.depth_m,
            link: image.link,
            support,
        })
    };
    views
        .par_iter()
        .map_init(|| Renderer::new(&robot.scene), draw_view)
        .collect()
}

/// Fixed cameras that stand inside the robot's base: their poses were never filled in, or have another unit.
fn misplaced_cameras(clip: &Clip) -> Vec<String> {
    /// No camera fits into the axis of the first joint, metres.
    const INSIDE: f64 = 0.02;
    let warning = |camera: &ClipCamera| {
        let CameraMount::Fixed { base_from_camera } = &camera.mount else {
            return None;
        };
        let [x, y, z] = base_from_camera.translation;
        let distance = (x * x + y * y + z * z).sqrt();
        let why = if distance == 0.0 {
            "was its pose never filled in"
        } else {
            "was its pose in metres divided by 1000 or 100 once too often"
        };
        (distance < INSIDE).then(|| {
            format!(
                "camera `{}` stands {distance:.4} m from the robot's base: {why}?",
                camera.id
            )
        })
    };
    clip.cameras.iter().filter_map(warning).collect()
}

/// Cameras whose reference depth of the robot is some usual factor off its mesh depth: the depth has another unit.
fn depth_warnings(clip: &Clip, maps: &[RobotMap]) -> Vec<String> {
    /// Fewer pixels tell nothing.
    const ENOUGH: usize = 20;
    /// No calibration that draws the robot at all is off by this ratio of depths.
    const BEYOND: f64 = 1.5;
    let pixels = clip.height as usize * clip.width as usize;
    let warning = |index: CameraIndex| {
        let camera = &clip.cameras[index.at()];
        let reference = camera.depth.as_ref()?;
        let of_camera = maps.iter().filter(|map| map.camera == index);
        let mut ratios: Vec<f64> = of_camera
            .flat_map(|map| {
                let depth_m = reference.depth_m.get(map.frame.at() * pixels..).unwrap_or_default();
                let supported = map.support.iter().zip(&map.depth_m).zip(depth_m);
                supported
                    .filter(|((support, mesh), depth)| **support == 1 && **mesh > 0.0 && depth.is_finite())
                    .map(|((_, mesh), depth)| f64::from(*depth) / f64::from(*mesh))
            })
            .collect();
        if ratios.len() < ENOUGH {
            return None;
        }
        let middle = ratios.len() / 2;
        let (_, &mut median, _) = ratios.select_nth_unstable_by(middle, f64::total_cmp);
        // What hides the robot is nearer than it; beyond its surface the camera cannot see it.
        let known = unit_factor(median).map(|found| found.meaning);
        let meaning = known.or((median > BEYOND).then_some("is their unit another, or the camera's pose wrong"))?;
        Some(format!(
            "camera `{}`: its reference depth of the robot is {median:.4} times that of the robot's mesh (median of {} \
             pixels): {}? `unit_m` beside the depth's `path` states its unit",
            camera.id,
            ratios.len(),
            meaning
        ))
    };
    clip.source_cameras().into_iter().filter_map(warning).collect()
}

fn bad_input(error: rogs_robot::Error) -> StageError {
    let hint = match &error {
        rogs_robot::Error::Mesh { .. } => "export the mesh again, e.g. as binary STL or as glTF without compression",
        rogs_robot::Error::Reference { .. } => "docs/episode-format.md says where meshes of a robot are looked for",
        rogs_robot::Error::Urdf { .. } => "docs/episode-format.md says what is read of a URDF",
        _ => return StageError::bad_input(error.chain()),
    };
    StageError::bad_input(error.chain()).with_hint(hint)
}
