//! A clip's cameras and robot, to be drawn anew: renders of fields and silhouettes of the mesh, whole or in a window.

use glam::DVec3;
use image::imageops::{self, FilterType};
use image::{ImageBuffer, Rgb};
use rogs_geometry::{Base, Link, Pinhole, Pose, PosedCamera, Recon};
use rogs_robot::{MeshScene, RenderOptions};
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::{Gaussians, RasterCamera, RasterConfig, render};

use super::picture::Picture;
use crate::scenes::RobotMesh;

/// Width of pictures of smaller clips, pixels: a contour of two pixels then hides little.
const LEAST_WIDTH: u32 = 480;
/// Least share of an image that a crop shows, along each side.
const LEAST_SHARE: f64 = 0.36;
/// Share of an image that a crop shows around what it is about.
const MARGIN: f64 = 0.28;

/// What the pictures of a clip are drawn with.
pub(super) struct Studio<'a> {
    clip: &'a Clip,
    robot: &'a RobotMaps,
    mesh: MeshScene,
}

/// A part of an image that is shown, pixels of the clip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Window {
    left: u32,
    top: u32,
    width: u32,
    height: u32,
}

/// A view of a figure.
pub(super) struct View {
    /// What it is called.
    pub(super) name: String,
    /// The camera at the clip's size.
    pub(super) posed: PosedCamera<Base>,
    /// The clip frame that is shown.
    pub(super) frame: FrameIndex,
    /// What of its image is shown.
    window: Window,
    /// Of the picture, pixels.
    lens: Pinhole,
}

impl View {
    /// Width and height of its pictures, pixels.
    fn size(&self) -> (u32, u32) {
        (self.lens.width, self.lens.height)
    }

    /// What it shows of an image of its camera.
    pub(super) fn of(&self, picture: &Picture) -> Picture {
        self.window.of(picture, self.size())
    }
}

impl Window {
    /// This part of an image, at another size.
    fn of(self, picture: &Picture, (width, height): (u32, u32)) -> Picture {
        let own = (picture.width as u32, picture.height as u32);
        let Some(whole) = ImageBuffer::<Rgb<u8>, _>::from_raw(own.0, own.1, picture.rgb.clone()) else {
            return picture.clone();
        };
        let part = imageops::crop_imm(&whole, self.left, self.top, self.width, self.height).to_image();
        Picture {
            width: width as usize,
            height: height as usize,
            rgb: imageops::resize(&part, width, height, FilterType::Triangle).into_raw(),
        }
    }

    /// The part of an image that shows these points, which lie in it; its middle where there are none.
    fn around((width, height): (u32, u32), points: &[[f64; 2]]) -> Self {
        let size = [f64::from(width), f64::from(height)];
        let bounds = |axis: usize| {
            let places = points.iter().map(|point| point[axis] / size[axis]);
            let (low, high) = places.fold((f64::MAX, f64::MIN), |(low, high), at| (low.min(at), high.max(at)));
            if points.is_empty() { (0.5, 0.5) } else { (low, high) }
        };
        let (across, down) = (bounds(0), bounds(1));
        let share = MARGIN + (across.1 - across.0).max(down.1 - down.0);
        let share = share.clamp(LEAST_SHARE, 1.0);
        let side = |axis: usize, (low, high): (f64, f64)| {
            let length = (share * size[axis]).round().clamp(1.0, size[axis]);
            let first = ((low + high) / 2.0 * size[axis] - length / 2.0).round();
            (first.clamp(0.0, size[axis] - length) as u32, length as u32)
        };
        let ((left, width), (top, height)) = (side(0, across), side(1, down));
        Self {
            left,
            top,
            width,
            height,
        }
    }
}

impl<'a> Studio<'a> {
    pub(super) fn new(clip: &'a Clip, robot: &'a RobotMaps, mesh: Option<&RobotMesh>) -> Self {
        Self {
            clip,
            robot,
            mesh: mesh.map(|mesh| mesh.scene(&robot.link_names)).unwrap_or_default(),
        }
    }

    /// Whether there is a robot to be drawn.
    pub(super) fn has_mesh(&self) -> bool {
        self.mesh.triangle_count() > 0
    }

    /// Source cameras with their names.
    pub(super) fn sources(&self) -> Vec<(CameraIndex, &'a str)> {
        let named = |camera: CameraIndex| Some((camera, &*self.clip.cameras.get(camera.at())?.id));
        self.clip.source_cameras().into_iter().filter_map(named).collect()
    }

    /// A camera of the clip at a frame.
    pub(super) fn posed(&self, camera: CameraIndex, frame: FrameIndex) -> Option<PosedCamera<Base>> {
        PosedCamera::of_clip(self.clip, self.robot, camera, frame).ok()
    }

    /// Tool centre at a frame, metres, base frame.
    pub(super) fn tool(&self, frame: FrameIndex) -> Option<DVec3> {
        let tool = self.robot.tool_m.get(3 * frame.at()..3 * frame.at() + 3)?;
        Some(DVec3::from_slice(tool))
    }

    /// A camera of the clip turned by an angle (radians) about the vertical through the tool.
    pub(super) fn turned(&self, camera: CameraIndex, frame: FrameIndex, angle: f64) -> Option<PosedCamera<Base>> {
        let posed = self.posed(camera, frame)?;
        let pose = posed.world_from_camera.turned_about(self.tool(frame)?, DVec3::Z, angle);
        Some(PosedCamera::new(posed.lens, pose))
    }

    /// All that a camera sees.
    pub(super) fn whole(&self, posed: PosedCamera<Base>, frame: FrameIndex, name: String) -> View {
        let Pinhole { width, height, .. } = posed.lens;
        let window = Window {
            left: 0,
            top: 0,
            width,
            height,
        };
        Self::view(posed, frame, window, name)
    }

    /// What a camera sees about the tool at these frames.
    pub(super) fn crop(&self, posed: PosedCamera<Base>, frame: FrameIndex, about: &[FrameIndex], name: String) -> View {
        let Pinhole { width, height, .. } = posed.lens;
        let camera_from_base = posed.world_from_camera.inverse();
        let seen = |frame: &FrameIndex| {
            let (at, _) = posed.lens.project(camera_from_base.point(self.tool(*frame)?))?;
            let inside = (0.0..f64::from(width)).contains(&at.x) && (0.0..f64::from(height)).contains(&at.y);
            inside.then_some([at.x, at.y])
        };
        let points: Vec<[f64; 2]> = about.iter().filter_map(seen).collect();
        Self::view(posed, frame, Window::around((width, height), &points), name)
    }

    /// Both, named after the view.
    pub(super) fn whole_and_crop(
        &self,
        posed: PosedCamera<Base>,
        frame: FrameIndex,
        about: &[FrameIndex],
        name: &str,
    ) -> [View; 2] {
        let whole = self.whole(posed, frame, format!("{name}, frame {frame}"));
        [whole, self.crop(posed, frame, about, "crop".to_owned())]
    }

    fn view(posed: PosedCamera<Base>, frame: FrameIndex, window: Window, name: String) -> View {
        let Pinhole { width, height, .. } = posed.lens;
        let factor = LEAST_WIDTH.div_ceil(width.max(1)).max(1);
        let cropped = posed
            .lens
            .cropped(window.left as i32, window.top as i32, window.width, window.height);
        View {
            name,
            posed,
            frame,
            window,
            lens: cropped.resized(width * factor, height * factor),
        }
    }

    /// The Gaussians as a camera sees them at the clip's size: a field has no finer detail, and at another size the filter of
    /// the rasteriser, which is as wide as a pixel, would leave gaps between them.
    pub(super) fn render(
        &self,
        gaussians: &Gaussians,
        posed: PosedCamera<Base>,
        recon_from_base: &Pose<Recon, Base>,
    ) -> Option<Picture> {
        let camera = RasterCamera::new(&posed.in_frame(recon_from_base), LengthUnit::Internal);
        let render = render(gaussians, &camera, &RasterConfig::default()).ok()?;
        Picture::from_rgb(camera.width, camera.height, &render.rgb_bytes())
    }

    /// Link ids of the robot's mesh at a frame as a view shows it. `[H, W]`
    pub(super) fn silhouette(&self, view: &View, frame: FrameIndex) -> Option<Vec<u8>> {
        let count = self.robot.link_names.len();
        let poses = self
            .robot
            .base_from_link
            .get(frame.at() * count..(frame.at() + 1) * count)?;
        let camera_from_base = view.posed.world_from_camera.inverse();
        let poses = poses
            .iter()
            .map(|pose| Some(camera_from_base * Pose::<Base, Link>::from_rigid(pose).ok()?));
        let poses: Vec<_> = poses.collect::<Option<_>>()?;
        let image = self.mesh.render(&view.lens, &poses, &RenderOptions::default()).ok()?;
        Some(image.link)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_hold_their_points_and_stay_in_the_image() {
        let about = |points: &[[f64; 2]]| Window::around((200, 100), points);
        let of = |left, top, width, height| Window {
            left,
            top,
            width,
            height,
        };
        assert_eq!(about(&[]), of(64, 32, 72, 36), "the middle");
        assert_eq!(about(&[[0.0, 99.0]]), of(0, 64, 72, 36));
        assert_eq!(about(&[[50.0, 50.0], [90.0, 60.0]]), of(22, 31, 96, 48));
        assert_eq!(about(&[[0.0, 0.0], [199.0, 99.0]]), of(0, 0, 200, 100));
    }

    #[test]
    fn a_window_of_a_picture_is_that_part_of_it() {
        let mut picture = Picture::new(4, 2, 0);
        picture.rgb[3 * 6..3 * 7].fill(200);
        let part = Window {
            left: 2,
            top: 1,
            width: 1,
            height: 1,
        }
        .of(&picture, (3, 2));
        assert_eq!((part.width, part.height, &part.rgb), (3, 2, &vec![200; 18]));
    }
}
