//! What a clip gives to other methods of reconstruction: images, lenses, poses, masks, depth, points.
//!
//! [`nerfstudio`](write_nerfstudio) and [`colmap`](write_colmap) write it in their forms (`docs/exports.md`). The views that a
//! field is made from are there for training, every other one for testing.

mod colmap;
mod nerfstudio;

use std::collections::BTreeSet;

use rogs_field::Axes;
use rogs_geometry::{Base, Camera, Pinhole, Pose, PosedCamera, Recon, pixel_centre};
use rogs_schemas::records::clip::{CameraRole, Clip, SourceView, time_of_frame};
use rogs_schemas::records::robot::{NO_LINK, RobotMaps};
use rogs_schemas::{CameraIndex, FrameIndex};

use crate::error::{Error, Result};
use crate::splats::World;

pub use colmap::write_colmap;
pub use nerfstudio::write_nerfstudio;

/// Most points of a cloud to begin from.
const MOST_POINTS: usize = 100_000;

/// Which pixels a mask lets through.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Masks {
    /// There are no masks.
    #[default]
    None,
    /// All but the robot.
    Background,
    /// The robot alone.
    Robot,
}

/// What of a clip is wanted.
#[derive(Debug, Clone)]
pub struct Selection {
    /// The frame of poses and points.
    pub axes: Axes,
    /// Cameras, in the order in which views are listed.
    pub cameras: Vec<CameraIndex>,
    /// Clip frames.
    pub frames: Vec<FrameIndex>,
    /// Masks of source cameras; others have none, because robot maps do not cover them.
    pub masks: Masks,
}

/// An image and what belongs to it.
#[derive(Debug, Clone)]
pub struct View<'a> {
    /// Name without an ending: camera and frame.
    pub name: String,
    /// Index of the camera in the clip.
    pub camera: CameraIndex,
    /// Clip frame.
    pub frame: FrameIndex,
    /// Normalised time.
    pub time: f64,
    /// Lens, pixels, centres at + 0.5.
    pub lens: Pinhole,
    /// Pose, metres, OpenCV axes.
    pub world_from_camera: Pose<World, Camera>,
    /// Pixels. `[H, W, 3]`
    pub rgb: &'a [u8],
    /// Reference depth, camera z in metres, NaN where unknown. `[H, W]`
    pub depth_m: Option<&'a [f32]>,
    /// 255 where a pixel counts, 0 elsewhere. `[H, W]`
    pub mask: Option<Vec<u8>>,
    /// Whether the field is not made from it.
    pub held_out: bool,
}

/// A point to begin from, as a view saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Place, metres.
    pub position_m: [f64; 3],
    /// Colour.
    pub rgb: [u8; 3],
    /// Index of the view.
    pub view: usize,
    /// Where the view saw it, pixels, centres at + 0.5.
    pub pixel: [f64; 2],
}

/// The views of a clip.
#[derive(Debug, Clone)]
pub struct Dataset<'a> {
    /// Camera-major, in the order of the selection. Cameras without images have none.
    pub views: Vec<View<'a>>,
    /// From reference depth, else from the robot's mesh; of views to train with.
    pub points: Vec<Point>,
    /// Names of the clip's cameras.
    pub cameras: Vec<&'a str>,
    /// Image size (width, height), pixels.
    pub size: (u32, u32),
}

impl<'a> Dataset<'a> {
    /// Takes views from a clip and its robot maps.
    ///
    /// # Errors
    /// When clip and maps do not belong together, nothing is selected, or a camera has no pose.
    pub fn new(clip: &'a Clip, robot: &'a RobotMaps, selection: &Selection) -> Result<Self> {
        if clip.clip_id != robot.clip_id || (clip.width, clip.height) != (robot.width, robot.height) {
            return Err(Error::Unfit {
                what: format!(
                    "the robot maps are of clip `{}`, not of `{}`",
                    robot.clip_id, clip.clip_id
                ),
            });
        }
        let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&robot.recon_from_base)?;
        let world_from_base: Pose<World, Base> = match selection.axes {
            Axes::Base => Pose::IDENTITY,
            Axes::Recon => recon_from_base.relabelled(),
        };
        let sources: BTreeSet<(CameraIndex, FrameIndex)> = (clip.source_views().iter())
            .map(|view| (view.camera, view.frame))
            .collect();
        let mut views = Vec::new();
        for &camera in &selection.cameras {
            for &frame in &selection.frames {
                let Some(rgb) = image(clip, camera, frame) else {
                    continue;
                };
                let posed = PosedCamera::of_clip(clip, robot, camera, frame)?;
                let own = &clip.cameras[camera.at()];
                views.push(View {
                    name: format!("{}_{:06}", own.id, frame.0),
                    camera,
                    frame,
                    time: time_of_frame(frame, clip.frame_count()),
                    lens: posed.lens,
                    world_from_camera: world_from_base * posed.world_from_camera,
                    rgb,
                    depth_m: depth(clip, camera, frame),
                    mask: mask(robot, camera, frame, selection.masks),
                    held_out: !sources.contains(&(camera, frame)),
                });
            }
        }
        if views.is_empty() {
            return Err(Error::Unfit {
                what: format!("no image of clip `{}` is selected", clip.clip_id),
            });
        }
        let points = points(clip, robot, &views);
        Ok(Self {
            views,
            points,
            cameras: clip.cameras.iter().map(|camera| camera.id.as_str()).collect(),
            size: (clip.width, clip.height),
        })
    }
}

/// What a method is given or compared with: observations of source cameras, recorded images of the others.
fn image(clip: &Clip, camera: CameraIndex, frame: FrameIndex) -> Option<&[u8]> {
    match clip.cameras.get(camera.at())?.role {
        CameraRole::Source => Some(clip.observation(SourceView { camera, frame })?.rgb()),
        CameraRole::Evaluation => Some(clip.target(camera, frame)?.rgb()),
    }
}

fn depth(clip: &Clip, camera: CameraIndex, frame: FrameIndex) -> Option<&[f32]> {
    let area = clip.width as usize * clip.height as usize;
    let depth = clip.cameras.get(camera.at())?.depth.as_ref()?;
    depth.depth_m.get(area * frame.at()..area * (frame.at() + 1))
}

fn mask(robot: &RobotMaps, camera: CameraIndex, frame: FrameIndex, masks: Masks) -> Option<Vec<u8>> {
    let of = |link: &u8| {
        let on_robot = *link != NO_LINK;
        if on_robot == (masks == Masks::Robot) { 255 } else { 0 }
    };
    if masks == Masks::None {
        return None;
    }
    let map = robot
        .maps
        .iter()
        .find(|map| map.camera == camera && map.frame == frame)?;
    Some(map.link.iter().map(of).collect())
}

/// Points on a regular grid of pixels of the training views: at the reference depth, or where the robot's mesh is.
fn points(clip: &Clip, robot: &RobotMaps, views: &[View<'_>]) -> Vec<Point> {
    let area = clip.width as usize * clip.height as usize;
    let training: Vec<usize> = (0..views.len()).filter(|view| !views[*view].held_out).collect();
    let mut stride = 1;
    while training.len() * area / (stride * stride) > MOST_POINTS {
        stride += 1;
    }
    let referenced = training.iter().any(|view| views[*view].depth_m.is_some());
    let mut points = Vec::new();
    for index in training {
        let view = &views[index];
        let range = clip.cameras[view.camera.at()].depth.as_ref().map(|depth| depth.range_m);
        let meshes = || {
            robot
                .maps
                .iter()
                .find(|map| (map.camera, map.frame) == (view.camera, view.frame))
        };
        let (depth, [near, far]) = if referenced {
            let Some(depth) = view.depth_m.zip(range) else {
                continue;
            };
            depth
        } else {
            let Some(map) = meshes() else {
                continue;
            };
            (&map.depth_m[..], [0.0, f32::INFINITY])
        };
        for row in (stride / 2..clip.height as usize).step_by(stride) {
            for column in (stride / 2..clip.width as usize).step_by(stride) {
                let pixel = row * clip.width as usize + column;
                let here = depth[pixel];
                if !(here > near && here < far) {
                    continue;
                }
                let centre = pixel_centre(column as u32, row as u32);
                let seen = view.lens.unproject(centre, here.into());
                points.push(Point {
                    position_m: view.world_from_camera.point(seen).to_array(),
                    rgb: std::array::from_fn(|k| view.rgb[3 * pixel + k]),
                    view: index,
                    pixel: centre.to_array(),
                });
            }
        }
    }
    points
}

#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) use tests::clip as test_clip;
