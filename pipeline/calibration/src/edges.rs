//! Contours of the drawn robot and the edges of the images near them (`docs/spec/calibration.md` section 3).

use glam::{DVec2, DVec3};
use rayon::prelude::*;
use rogs_agreement::audit::Mount;
use rogs_agreement::{Settings, Surface, View, common_shift, measure};
use rogs_geometry::{Camera, Link, Pinhole, Pose, PosedCamera};
use rogs_robot::RenderOptions;
use rogs_robot::raster::Renderer;

use crate::Result;
use crate::correction::{Correction, FOCAL, LAG, PRINCIPAL, UNKNOWNS};
use crate::moment::{Moment, standing};
use crate::scaled::{shrunk, shrunk_lens};
use crate::solve::{Kind, Row};
use crate::take::Take;

/// Fewer pixels of the robot tell nothing.
const FEWEST_PIXELS: usize = 120;
/// Images with a smaller standard deviation of brightness are blank, grey values.
const BLANK: f64 = 2.0;

/// A camera's pose in its mount: the base frame for a fixed camera, its link for one on the hand.
pub(crate) fn mount_from_camera(mount: &Mount) -> Pose<Link, Camera> {
    match mount {
        Mount::Fixed(pose) => pose.relabelled(),
        Mount::Hand { link_from_camera, .. } => *link_from_camera,
        Mount::Path(poses) => poses.first().map_or(Pose::IDENTITY, Pose::relabelled),
    }
}

/// Images of some frames at one size.
pub(crate) struct Level<'a> {
    pub takes: &'a [Take<'a>],
    /// The given camera at this size.
    pub lens: Pinhole,
    pub mount_from_given: Pose<Link, Camera>,
    /// Clip, frame and pixels.
    pub images: Vec<(usize, usize, Vec<u8>)>,
    /// Whether a link is rigid to the base.
    pub standing: Vec<bool>,
}

/// A contour point that is tied to the robot, and where the image has its edge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    pub kind: Kind,
    /// In the frame of the mount, metres.
    pub point: DVec3,
    /// How it moves there, metres a frame.
    pub velocity: DVec3,
    /// Time lag at which it was taken, frames.
    pub lag: f64,
    /// Where the image has the edge, pixels.
    pub target: DVec2,
    /// Unit normal of the contour.
    pub normal: DVec2,
    pub sigma: f64,
    pub weight: f64,
    /// Share of the colours' variance that it explains; outlines only.
    pub explained: f64,
    /// Edges of one link have errors in common.
    pub group: u32,
}

/// What a look at all frames gave.
#[derive(Debug, Clone, Default)]
pub(crate) struct Look {
    pub edges: Vec<Edge>,
    /// Frames with an image and a state.
    pub frames: usize,
    /// Of these, frames in which the robot should be seen.
    pub visible: usize,
    /// Frames of one brightness.
    pub blank: usize,
    /// Mean overlay over the frames (`docs/spec/agreement.md` section 3).
    pub overlay: f64,
    /// Offsets of the edges with their weights, pixels.
    pub offsets: Vec<(f64, f64)>,
    /// Median depth of the contour, metres.
    pub depth_m: f64,
    /// Mean number of pixels of the robot.
    pub robot_pixels: f64,
}

impl<'a> Level<'a> {
    /// Images of the chosen frames, `factor` times smaller.
    pub(crate) fn new(takes: &'a [Take<'a>], frames: &[(usize, usize)], factor: u32) -> Self {
        let lens = shrunk_lens(&takes[0].filmed().lens, factor);
        let given = takes[0].filmed().lens;
        let (width, height) = (given.width as usize, given.height as usize);
        let images = frames
            .par_iter()
            .map(|&(clip, frame)| {
                (
                    clip,
                    frame,
                    shrunk(takes[clip].filmed().images[frame], width, height, factor as usize),
                )
            })
            .collect();
        Self {
            takes,
            lens,
            mount_from_given: mount_from_camera(&takes[0].filmed().mount),
            images,
            standing: standing(takes[0].footage.model),
        }
    }

    /// Searches the edges of all frames under a correction. In a range above 8 pixels, edges that agree with the shift of
    /// their whole image count more.
    pub(crate) fn look(&self, correction: &Correction, settings: &Settings) -> Result<Look> {
        let looks: Vec<Result<Look>> = self
            .images
            .par_iter()
            .map_init(
                || Renderer::new(self.takes[0].footage.scene),
                |renderer, image| self.look_at(renderer, image, correction, settings),
            )
            .collect();
        let mut all = Look::default();
        let mut depths = Vec::new();
        for look in looks {
            let look = look?;
            all.edges.extend(look.edges);
            all.offsets.extend(look.offsets);
            all.frames += look.frames;
            all.visible += look.visible;
            all.blank += look.blank;
            all.overlay += look.overlay;
            all.robot_pixels += look.robot_pixels;
            if look.depth_m > 0.0 {
                depths.push((look.depth_m, 1.0));
            }
        }
        let frames = all.frames.max(1) as f64;
        all.overlay /= frames;
        all.robot_pixels /= frames;
        all.depth_m = crate::solve::weighted_median(&mut depths);
        Ok(all)
    }

    fn look_at(
        &self,
        renderer: &mut Renderer<'_>,
        (clip, frame, rgb): &(usize, usize, Vec<u8>),
        correction: &Correction,
        settings: &Settings,
    ) -> Result<Look> {
        let take = &self.takes[*clip];
        let Some(moment) = Moment::new(take, *frame, &self.mount_from_given, correction)? else {
            return Ok(Look::default());
        };
        let lens = correction.lens(&self.lens);
        let drawn = renderer.render(&lens, &moment.camera_from_link(), &RenderOptions::default(), 1)?;
        let view = View {
            rgb,
            camera: PosedCamera::new(lens, moment.base_from_camera),
            surface: Surface::from(&drawn),
            base_from_link: &moment.links,
            sensor_depth_m: None,
        };
        let measured = measure(&view, settings)?;
        let visible = measured.robot_pixels >= FEWEST_PIXELS;
        let blank = measured.contrast < BLANK;
        let mut look = Look {
            frames: 1,
            visible: usize::from(visible),
            blank: usize::from(blank),
            robot_pixels: measured.robot_pixels as f64,
            ..Look::default()
        };
        if !visible || blank {
            return Ok(look);
        }
        look.overlay = measured.overlay(settings).unwrap_or(0.0) * (measured.samples.len() as f64 / 60.0).min(1.0);
        let shift = common_shift(&measured.samples, settings.range_px).filter(|_| settings.range_px > 8.0);
        let mut depths = Vec::with_capacity(measured.samples.len());
        for sample in &measured.samples {
            depths.push((sample.depth_m, 1.0));
            look.offsets.push((sample.offset_px.abs(), sample.weight));
            let mut weight = sample.weight;
            if let Some(shift) = &shift {
                let off = (sample.offset_px - sample.normal.dot(shift.px)) / 3.0;
                weight /= (1.0 + off * off) * (1.0 + off * off);
            }
            if weight < 0.05 {
                continue;
            }
            let [point, velocity] = moment.tied(sample.base_point, usize::from(sample.link));
            look.edges.push(Edge {
                kind: Kind::Edge,
                point,
                velocity,
                lag: correction.lag_frames,
                target: sample.pixel + sample.normal * sample.offset_px,
                normal: sample.normal,
                sigma: sample.sigma_px,
                weight,
                explained: 0.0,
                group: u32::from(sample.link),
            });
        }
        look.depth_m = crate::solve::weighted_median(&mut depths);
        Ok(look)
    }

    /// Residuals of edges under a correction; `None` when a point lies behind the camera. `share` of their weight counts.
    pub(crate) fn rows(&self, edges: &[Edge], correction: &Correction, share: f64) -> Option<Vec<Row>> {
        let lens = correction.lens(&self.lens);
        let camera_from_mount = (self.mount_from_given * correction.moved).inverse();
        edges
            .iter()
            .map(|edge| edge.row(&lens, &camera_from_mount, correction.lag_frames, share))
            .collect()
    }
}

impl Edge {
    fn row(&self, lens: &Pinhole, camera_from_mount: &Pose<Camera, Link>, lag: f64, share: f64) -> Option<Row> {
        let point = camera_from_mount.point(self.point + self.velocity * (lag - self.lag));
        let (pixel, z) = lens.project(point).filter(|(_, z)| *z > 1e-3)?;
        let (fx, fy) = (lens.intrinsics.fx, lens.intrinsics.fy);
        let normal = self.normal;
        // n . d(pixel) / d(point)
        let along = DVec3::new(
            normal.x * fx / z,
            normal.y * fy / z,
            -(normal.x * fx * point.x + normal.y * fy * point.y) / (z * z),
        );
        // A camera that turns by w and goes by v moves the point by -w x p - v in its frame.
        let turn = along.cross(point);
        let mut gradient = [0.0; UNKNOWNS];
        gradient[..3].copy_from_slice(&turn.to_array());
        gradient[3..6].copy_from_slice(&(-along).to_array());
        gradient[FOCAL] = normal.x * fx * point.x / z + normal.y * fy * point.y / z;
        gradient[PRINCIPAL] = normal.x * f64::from(lens.width);
        gradient[PRINCIPAL + 1] = normal.y * f64::from(lens.height);
        gradient[LAG] = along.dot(camera_from_mount.direction(self.velocity));
        Some(Row {
            kind: self.kind,
            residual: normal.dot(pixel - self.target),
            gradient,
            sigma: self.sigma,
            weight: self.weight * share,
            group: self.group,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_finite_differences() {
        let lens = Pinhole::centred(120.0, 280, 154);
        let given: Pose<Link, Camera> = Pose::from_xyz_euler([0.1, -0.2, -1.0], [0.1, 0.05, -0.2]);
        let edge = Edge {
            kind: Kind::Edge,
            point: DVec3::new(0.2, -0.1, 0.3),
            velocity: DVec3::new(0.01, 0.02, -0.015),
            lag: 0.3,
            target: DVec2::new(150.0, 70.0),
            normal: DVec2::from_angle(0.7),
            sigma: 0.5,
            weight: 1.0,
            explained: 0.0,
            group: 0,
        };
        let correction = Correction::NONE.stepped(&[0.02, 0.01, -0.03, 0.04, -0.02, 0.03, 0.05, 0.01, 0.02, 0.4]);
        let row = |correction: &Correction| {
            let camera_from_mount = (given * correction.moved).inverse();
            edge.row(&correction.lens(&lens), &camera_from_mount, correction.lag_frames, 1.0)
                .unwrap()
        };
        let here = row(&correction);
        for i in 0..UNKNOWNS {
            let mut step = [0.0; UNKNOWNS];
            step[i] = 1e-6;
            let difference =
                row(&correction.stepped(&step)).residual - row(&correction.stepped(&step.map(|value| -value))).residual;
            let expected = difference / 2e-6;
            assert!(
                (here.gradient[i] - expected).abs() < 1e-4 * (1.0 + expected.abs()),
                "{i}: {} is not {expected}",
                here.gradient[i]
            );
        }
    }
}
