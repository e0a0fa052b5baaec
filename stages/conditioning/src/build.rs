//! From a clip and its robot maps to the conditioning record.

use rayon::prelude::*;
use rogs_geometry::{Base, Link, Pose, PosedCamera, Recon};
use rogs_schemas::FrameIndex;
use rogs_schemas::records::clip::{Clip, SourceView};
use rogs_schemas::records::conditioning::{Conditioning, GripperPrior, ViewConditioning};
use rogs_schemas::records::robot::{RobotMap, RobotMaps};
use rogs_worker::{StageError, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::fk_maps::{LinkDisplacement, SourcePoints, link_displacement};

/// Parameters of `conditioning`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Params {
    /// Standard deviation of the gripper-neighbourhood prior, metres in the image plane at the tool's depth.
    pub prior_sigma_m: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { prior_sigma_m: 0.10 }
    }
}

/// Makes the conditioning of all source views of a clip for its field frames.
///
/// # Errors
/// When clip and robot maps do not belong together.
pub fn build(clip: &Clip, robot: &RobotMaps, params: &Params) -> StageResult<Conditioning> {
    let frames = clip.frame_count();
    let scene = Scene::new(clip, robot)?;
    let query_frames = clip.field_frames();
    if let Some(frame) = query_frames.iter().find(|frame| frame.at() >= frames) {
        return Err(StageError::bad_input(format!(
            "query frame {frame} is not in the clip's {frames} frames"
        )));
    }
    let views = clip.source_views();
    let view_maps = views
        .par_iter()
        .map(|view| scene.view(view, &query_frames, params))
        .collect::<StageResult<Vec<_>>>()?;
    Ok(Conditioning {
        clip_id: clip.clip_id.clone(),
        height: clip.height,
        width: clip.width,
        views,
        query_frames,
        view_maps,
    })
}

/// A clip and its robot maps, with checked poses in the reconstruction frame.
struct Scene<'a> {
    clip: &'a Clip,
    robot: &'a RobotMaps,
    recon_from_base: Pose<Recon, Base>,
    /// `[F, L]`, frame-major.
    recon_from_link: Vec<Pose<Recon, Link>>,
}

impl<'a> Scene<'a> {
    fn new(clip: &'a Clip, robot: &'a RobotMaps) -> StageResult<Self> {
        if robot.clip_id != clip.clip_id {
            return Err(StageError::bad_input(format!(
                "the robot maps are of clip `{}`, not of `{}`",
                robot.clip_id, clip.clip_id
            )));
        }
        let frames = clip.frame_count();
        let sizes = [
            (
                robot.base_from_link.len(),
                frames * robot.link_names.len(),
                "link poses",
            ),
            (
                robot.base_from_camera.len(),
                frames * clip.cameras.len(),
                "camera poses",
            ),
            (robot.tool_m.len(), frames * 3, "tool coordinates"),
            (robot.height as usize, clip.height as usize, "rows"),
            (robot.width as usize, clip.width as usize, "columns"),
        ];
        if let Some((found, expected, what)) = sizes.iter().find(|(found, expected, _)| found != expected) {
            return Err(StageError::bad_input(format!(
                "the robot maps have {found} {what}, the clip asks for {expected}"
            )));
        }
        let recon_from_base = Pose::from_rigid(&robot.recon_from_base).map_err(bad_pose)?;
        let to_recon = |pose| {
            Pose::<Base, Link>::from_rigid(pose)
                .map(|pose| recon_from_base * pose)
                .map_err(bad_pose)
        };
        let recon_from_link = robot
            .base_from_link
            .iter()
            .map(to_recon)
            .collect::<StageResult<Vec<_>>>()?;
        Ok(Self {
            clip,
            robot,
            recon_from_base,
            recon_from_link,
        })
    }

    fn view(&self, view: &SourceView, query_frames: &[FrameIndex], params: &Params) -> StageResult<ViewConditioning> {
        let map = self.map(view)?;
        let camera = PosedCamera::of_clip(self.clip, self.robot, view.camera, view.frame).map_err(bad_pose)?;
        let in_recon = camera.in_frame(&self.recon_from_base);
        let points = SourcePoints::new(&in_recon, &map.depth_m, &map.link, &map.support);
        let links = self.robot.link_names.len();
        if let Some(link) = points.link.iter().find(|&&link| usize::from(link) >= links) {
            return Err(StageError::bad_input(format!(
                "a map shows link {link}, the robot has {links} links"
            )));
        }
        let mut displacement_iu = vec![0.0f32; query_frames.len() * points.pixels.len() * 3];
        if !points.pixels.is_empty() {
            for (&query, out) in query_frames
                .iter()
                .zip(displacement_iu.chunks_exact_mut(points.pixels.len() * 3))
            {
                points.displace(&self.displacements(view.frame, query), out);
            }
        }
        let prior = self.prior(&camera, view.frame, params);
        let SourcePoints {
            pixels, link, depth_m, ..
        } = points;
        // Robot maps hold joint states and meshes for all frames of the clip.
        Ok(ViewConditioning {
            pixels,
            link,
            depth_m,
            displacement_iu,
            available: vec![1; query_frames.len()],
            prior,
        })
    }

    fn map(&self, view: &SourceView) -> StageResult<&'a RobotMap> {
        let area = self.clip.height as usize * self.clip.width as usize;
        let found = self
            .robot
            .maps
            .iter()
            .find(|map| map.camera == view.camera && map.frame == view.frame);
        let whole = |map: &&RobotMap| [map.depth_m.len(), map.link.len(), map.support.len()] == [area; 3];
        found.filter(whole).ok_or_else(|| {
            StageError::bad_input(format!(
                "the robot maps have no whole map of camera {} at frame {}",
                view.camera, view.frame
            ))
        })
    }

    fn displacements(&self, source: FrameIndex, query: FrameIndex) -> Vec<LinkDisplacement> {
        let links = self.robot.link_names.len();
        let at = |frame: FrameIndex| &self.recon_from_link[frame.at() * links..(frame.at() + 1) * links];
        at(source)
            .iter()
            .zip(at(query))
            .map(|(source, query)| link_displacement(source, query))
            .collect()
    }

    fn prior(&self, camera: &PosedCamera<Base>, frame: FrameIndex, params: &Params) -> GripperPrior {
        let start = frame.at() * 3;
        let tool = glam::DVec3::from_slice(&self.robot.tool_m[start..start + 3]);
        let in_camera = camera.world_from_camera.inverse().point(tool);
        let centre = camera
            .lens
            .project(in_camera)
            .map_or([0.0, 0.0], |(pixel, _)| pixel.to_array());
        GripperPrior {
            centre_px: centre,
            depth_m: in_camera.z,
            focal_px: [camera.lens.intrinsics.fx, camera.lens.intrinsics.fy],
            sigma_m: params.prior_sigma_m,
        }
    }
}

fn bad_pose(error: rogs_geometry::Error) -> StageError {
    StageError::bad_input(error.to_string())
}
