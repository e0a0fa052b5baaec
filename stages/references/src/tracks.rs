//! Tracks of points on the robot's visible mesh: they are where they are seen at the anchor time, and move with their link.

use glam::{DVec2, DVec3};
use rogs_geometry::{Base, Link, Pose, PosedCamera};
use rogs_schemas::records::clip::{Clip, Tracks};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::robot::{RobotMap, RobotMaps};
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_worker::{StageError, StageResult};

use crate::params::{Params, TrackParams};

/// Tracks of the source cameras, where the parameters ask for them and the robot is seen.
pub(crate) fn make(
    clip: &Clip,
    robot: &RobotMaps,
    params: &Params,
    notes: &mut Vec<String>,
) -> StageResult<Option<Tracks>> {
    if !params.tracks.wants(clip.tracks.is_some()) {
        return Ok(None);
    }
    let mut tracks = Tracks {
        anchor_frame: clip.anchor_frame,
        camera: vec![],
        pixel: vec![],
        position_m: vec![],
        visible: vec![],
        origin: ReferenceOrigin::Kinematics,
    };
    let base_from_link = robot
        .base_from_link
        .iter()
        .map(|pose| Pose::from_rigid(pose).map_err(bad_pose))
        .collect::<StageResult<Vec<Pose<Base, Link>>>>()?;
    for camera in clip.source_cameras() {
        Points {
            clip,
            robot,
            base_from_link: &base_from_link,
            camera,
        }
        .track(&params.robot, &mut tracks)?;
    }
    if tracks.camera.is_empty() {
        notes.push(format!(
            "no robot tracks: no source camera sees the robot's mesh at the anchor frame {}",
            clip.anchor_frame
        ));
        return Ok(None);
    }
    Ok(Some(tracks))
}

/// The points of one source camera.
struct Points<'a> {
    clip: &'a Clip,
    robot: &'a RobotMaps,
    /// `[F, L]`, frame-major.
    base_from_link: &'a [Pose<Base, Link>],
    camera: CameraIndex,
}

impl Points<'_> {
    fn track(&self, params: &TrackParams, tracks: &mut Tracks) -> StageResult<()> {
        let anchor = self.clip.anchor_frame;
        let map = self.map(anchor)?;
        let seen = self.posed(anchor)?;
        let frames = FrameIndex::first(self.clip.frame_count());
        // Cameras and maps of all frames, once for all points.
        let views = frames
            .clone()
            .map(|frame| Ok((self.posed(frame)?, self.map(frame)?)))
            .collect::<StageResult<Vec<_>>>()?;
        for pixel in chosen(map, self.clip.width as usize, params) {
            let (column, row) = (pixel as u32 % self.clip.width, pixel as u32 / self.clip.width);
            let link = usize::from(map.link[pixel]);
            let in_camera = seen.lens.ray(column, row) * f64::from(map.depth_m[pixel]);
            let in_link = self
                .pose(anchor, link)?
                .inverse()
                .point(seen.world_from_camera.point(in_camera));
            tracks.camera.push(self.camera);
            tracks.pixel.extend([column as f32, row as f32]);
            for frame in frames.clone() {
                let position = self.pose(frame, link)?.point(in_link);
                tracks.position_m.extend(position.to_array().map(|value| value as f32));
                let (camera, map) = &views[frame.at()];
                let visible = frame == anchor || sees(camera, map, position, link, params.hidden_m);
                tracks.visible.push(u8::from(visible));
            }
        }
        Ok(())
    }

    fn pose(&self, frame: FrameIndex, link: usize) -> StageResult<&Pose<Base, Link>> {
        let links = self.robot.link_names.len();
        let pose = (link < links).then(|| self.base_from_link.get(frame.at() * links + link));
        pose.flatten()
            .ok_or_else(|| StageError::bad_input(format!("a map shows link {link}, the robot has {links} links")))
    }

    fn posed(&self, frame: FrameIndex) -> StageResult<PosedCamera<Base>> {
        PosedCamera::of_clip(self.clip, self.robot, self.camera, frame).map_err(bad_pose)
    }

    fn map(&self, frame: FrameIndex) -> StageResult<&RobotMap> {
        let mut maps = self.robot.maps.iter();
        let found = maps.find(|map| map.camera == self.camera && map.frame == frame);
        found.ok_or_else(|| {
            let id = &self.clip.cameras[self.camera.at()].id;
            StageError::bad_input(format!("the robot maps have no map of camera `{id}` at frame {frame}"))
        })
    }
}

/// Anchor pixels: on a grid whose spacing grows until few enough of its places lie on valid support.
fn chosen(map: &RobotMap, width: usize, params: &TrackParams) -> Vec<usize> {
    let height = map.support.len() / width;
    let mut spacing = params.spacing_px as usize;
    loop {
        let rows = (spacing / 2..height).step_by(spacing);
        let pixels = rows.flat_map(|row| {
            (spacing / 2..width)
                .step_by(spacing)
                .map(move |column| row * width + column)
        });
        let pixels: Vec<usize> = pixels.filter(|&pixel| map.support[pixel] == 1).collect();
        if pixels.len() <= params.most_per_camera as usize {
            return pixels;
        }
        spacing += 1;
    }
}

/// Whether a camera sees a point of a link: the nearest pixel shows that link at that depth.
fn sees(camera: &PosedCamera<Base>, map: &RobotMap, point: DVec3, link: usize, hidden_m: f32) -> bool {
    let in_camera = camera.world_from_camera.inverse().point(point);
    let Some((DVec2 { x, y }, depth)) = camera.lens.project(in_camera) else {
        return false;
    };
    let (width, height) = (f64::from(camera.lens.width), f64::from(camera.lens.height));
    if !((0.0..width).contains(&x) && (0.0..height).contains(&y)) {
        return false;
    }
    let pixel = y as usize * camera.lens.width as usize + x as usize;
    usize::from(map.link[pixel]) == link && (f64::from(map.depth_m[pixel]) - depth).abs() <= f64::from(hidden_m)
}

fn bad_pose(error: rogs_geometry::Error) -> StageError {
    StageError::bad_input(error.to_string())
}
