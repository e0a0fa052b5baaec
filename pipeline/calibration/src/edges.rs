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
use crate::scaled::{enlarged, shrunk, shrunk_lens};
use crate::solve::{BLOCKS, Kind, Row};
use crate::take::Take;

/// Fewer pixels of the robot tell nothing.
const FEWEST_PIXELS: usize = 120;
/// Images with a smaller standard deviation of brightness are blank, grey values.
const BLANK: f64 = 2.0;
/// Part of a frame over which the speed of the robot is taken.
const HALF_STEP: f64 = 0.5;

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
    takes: &'a [Take<'a>],
    /// The given camera at this size.
    pub lens: Pinhole,
    mount_from_given: Pose<Link, Camera>,
    /// Clip, frame and pixels.
    images: Vec<(usize, usize, Vec<u8>)>,
}

/// A contour point that is tied to the robot, and where the image has its edge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    /// In the frame of the mount, metres.
    point: DVec3,
    /// How it moves there, metres a frame.
    velocity: DVec3,
    /// Time lag at which it was taken, frames.
    lag: f64,
    /// Where the image has the edge, pixels.
    target: DVec2,
    /// Unit normal of the contour.
    normal: DVec2,
    sigma: f64,
    weight: f64,
    /// Block of images.
    block: usize,
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
        Self::of(takes, frames, lens, |rgb, width, height| {
            shrunk(rgb, width, height, factor as usize)
        })
    }

    /// Images of the chosen frames, `factor` times larger: contours are cut by discs of a few pixels, which moves those of
    /// round parts inwards; the larger the images, the less.
    pub(crate) fn enlarged(takes: &'a [Take<'a>], frames: &[(usize, usize)], factor: u32) -> Self {
        let given = takes[0].filmed().lens;
        let lens = given.resized(given.width * factor, given.height * factor);
        Self::of(takes, frames, lens, |rgb, width, height| {
            enlarged(rgb, width, height, factor as usize)
        })
    }

    /// Images of the chosen frames, resized to those of `lens`.
    fn of(
        takes: &'a [Take<'a>],
        frames: &[(usize, usize)],
        lens: Pinhole,
        resized: impl Fn(&[u8], usize, usize) -> Vec<u8> + Sync,
    ) -> Self {
        let given = takes[0].filmed().lens;
        let (width, height) = (given.width as usize, given.height as usize);
        let images = frames
            .par_iter()
            .map(|&(clip, frame)| (clip, frame, resized(takes[clip].filmed().images[frame], width, height)))
            .collect();
        Self {
            takes,
            lens,
            mount_from_given: mount_from_camera(&takes[0].filmed().mount),
            images,
        }
    }

    /// Searches the edges of all frames under a correction. In a range above 8 pixels, edges that agree with the shift of
    /// their whole image count more.
    pub(crate) fn look(&self, correction: &Correction, settings: &Settings) -> Result<Look> {
        let looks: Vec<Result<Look>> = self
            .images
            .par_iter()
            .enumerate()
            .map_init(
                || Renderer::new(self.takes[0].footage.scene),
                |renderer, (number, image)| {
                    let mut look = self.look_at(renderer, image, correction, settings)?;
                    let block = number * BLOCKS / self.images.len();
                    look.edges.iter_mut().for_each(|edge| edge.block = block);
                    Ok(look)
                },
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
        let time = *frame as f64 + correction.lag_frames;
        let Some(links) = take.links(time)? else {
            return Ok(Look::default());
        };
        let base_from_mount = take.base_from_mount(&links);
        let base_from_camera = base_from_mount * self.mount_from_given * correction.moved;
        let lens = correction.lens(&self.lens);
        let camera_from_base = base_from_camera.inverse();
        let camera_from_link: Vec<Pose<Camera, Link>> = links.iter().map(|&link| camera_from_base * link).collect();
        let drawn = renderer.render(&lens, &camera_from_link, &RenderOptions::default(), 1)?;
        let view = View {
            rgb,
            camera: PosedCamera::new(lens, base_from_camera),
            surface: Surface::from(&drawn),
            base_from_link: &links,
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
        // The robot half a frame earlier and later, for its speed.
        let around = [
            take.links(time - HALF_STEP)?.unwrap_or_else(|| links.clone()),
            take.links(time + HALF_STEP)?.unwrap_or_else(|| links.clone()),
        ];
        let span = f64::max(
            0.5,
            2.0 * HALF_STEP
                - [time - HALF_STEP, time + HALF_STEP]
                    .iter()
                    .filter(|time| !(-0.01..=take.footage.frames() as f64 - 0.99).contains(*time))
                    .count() as f64
                    * HALF_STEP,
        );
        let mounts = around.each_ref().map(|links| take.base_from_mount(links).inverse());
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
            let link = usize::from(sample.link);
            let at = |side: usize| (mounts[side] * around[side][link]).point(sample.link_point);
            look.edges.push(Edge {
                point: base_from_mount.inverse().point(sample.base_point),
                velocity: (at(1) - at(0)) / span,
                lag: correction.lag_frames,
                target: sample.pixel + sample.normal * sample.offset_px,
                normal: sample.normal,
                sigma: sample.sigma_px,
                weight,
                block: 0,
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
            kind: Kind::Edge,
            residual: normal.dot(pixel - self.target),
            gradient,
            sigma: self.sigma,
            weight: self.weight * share,
            block: self.block,
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
            point: DVec3::new(0.2, -0.1, 0.3),
            velocity: DVec3::new(0.01, 0.02, -0.015),
            lag: 0.3,
            target: DVec2::new(150.0, 70.0),
            normal: DVec2::from_angle(0.7),
            sigma: 0.5,
            weight: 1.0,
            block: 0,
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
