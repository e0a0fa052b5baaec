//! One supposition about a camera, and how well the robot lies on the images under it.

use std::borrow::Cow;

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use rogs_geometry::{Base, Camera, Link, Pinhole, Pose, PosedCamera, rotation_about_axis};
use rogs_robot::raster::Renderer;
use rogs_robot::{MeshImage, RenderOptions};
use rogs_schemas::Intrinsics;

use super::footage::{Footage, Mount};
use super::states::Tables;
use crate::measure::{EdgeSample, Measurement, Settings, measure};
use crate::shift::{ImageShift, common_shift};
use crate::solve::solve;
use crate::view::{Surface, View};

/// Contour samples below which an overlay counts less.
const ENOUGH: f64 = 80.0;

/// What was done to an image before it was stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Picture {
    AsIs,
    Mirrored,
    UpsideDown,
    /// Radial distortion `1 + k1 r^2`, r in units of the focal length.
    Distorted(f64),
}

/// A camera as it might be.
#[derive(Debug, Clone)]
pub(super) struct Supposed {
    pub lens: Pinhole,
    pub mount: Mount,
    pub picture: Picture,
    /// Which link poses, an index into the tables of [`Trials`].
    pub states: usize,
    /// The states of frame f + delay belong to image f.
    pub delay: i64,
    /// The pose by which the camera has moved in its own frame at the last frame, evenly from none at the first.
    pub drift: Option<[DVec3; 2]>,
}

/// What trials share.
pub(super) struct Trials<'a> {
    pub footage: &'a Footage<'a>,
    /// Link poses to draw the robot with.
    pub tables: &'a Tables,
    /// Whether images and lenses are of half the size.
    pub half: bool,
}

/// A view of a trial, measured.
pub(super) struct Seen {
    pub measured: Measurement,
    pub shift: Option<ImageShift>,
    pub camera: PosedCamera<Base>,
}

impl Supposed {
    /// The same camera with images of half the size.
    pub(super) fn halved(&self) -> Self {
        Self {
            lens: halved(&self.lens),
            ..self.clone()
        }
    }
}

/// The lens of images of half the size.
pub(super) fn halved(lens: &Pinhole) -> Pinhole {
    let Intrinsics { fx, fy, cx, cy } = lens.intrinsics;
    Pinhole {
        intrinsics: Intrinsics {
            fx: 0.5 * fx,
            fy: 0.5 * fy,
            cx: 0.5 * cx,
            cy: 0.5 * cy,
        },
        width: lens.width / 2,
        height: lens.height / 2,
    }
}

/// A supposed camera at a frame, and the robot in it.
pub(super) struct Drawn<'a> {
    pub camera: PosedCamera<Base>,
    pub links: &'a [Pose<Base, Link>],
    pub image: MeshImage,
}

impl<'a> Trials<'a> {
    /// Trials of whole images.
    pub(super) fn of(footage: &'a Footage<'a>, tables: &'a Tables) -> Self {
        Self {
            footage,
            tables,
            half: false,
        }
    }

    /// Draws the robot for a supposed camera at a frame; `None` when the states lack this frame.
    pub(super) fn draw(&self, renderer: &mut Renderer<'_>, supposed: &Supposed, frame: usize) -> Option<Drawn<'a>> {
        let last = self.footage.frames().saturating_sub(1);
        let state = usize::try_from(frame as i64 + supposed.delay)
            .ok()
            .filter(|state| *state <= last)?;
        let links = &self.tables[supposed.states][state];
        let mut base_from_camera = match &supposed.mount {
            Mount::Fixed(pose) => *pose,
            Mount::Path(poses) => poses[frame],
            Mount::Hand { link, link_from_camera } => links[*link] * *link_from_camera,
        };
        if let Some([turn, step]) = supposed.drift {
            let part = frame as f64 / last.max(1) as f64;
            base_from_camera = base_from_camera * moved(turn * part, step * part);
        }
        let camera_from_base = base_from_camera.inverse();
        let camera_from_link: Vec<Pose<Camera, Link>> = links.iter().map(|&link| camera_from_base * link).collect();
        let image = renderer
            .render(&supposed.lens, &camera_from_link, &RenderOptions::default(), 1)
            .ok()?;
        Some(Drawn {
            camera: PosedCamera::new(supposed.lens, base_from_camera),
            links,
            image,
        })
    }

    /// Measures a supposed camera at a frame; `None` when the states lack this frame.
    pub(super) fn look(
        &self,
        renderer: &mut Renderer<'_>,
        camera: usize,
        supposed: &Supposed,
        frame: usize,
        settings: &Settings,
    ) -> Option<Seen> {
        let drawn = self.draw(renderer, supposed, frame)?;
        let rgb = straight(
            self.footage.cameras[camera].images[frame],
            &supposed.lens,
            supposed.picture,
        );
        let view = View {
            rgb: &rgb,
            camera: drawn.camera,
            surface: Surface::from(&drawn.image),
            base_from_link: drawn.links,
            sensor_depth_m: None,
        };
        let measured = measure(&view, settings).ok()?;
        let shift = common_shift(&measured.samples, settings.range_px);
        Some(Seen {
            measured,
            shift,
            camera: drawn.camera,
        })
    }

    /// Mean overlay of a supposed camera over some frames: 0 where it sees no robot. `links` restricts it to some links.
    pub(super) fn overlay(&self, camera: usize, supposed: &Supposed, frames: &[usize], links: Option<&[bool]>) -> f64 {
        self.overlay_and_length(camera, supposed, frames, links)[0]
    }

    /// The same, and the mean number of contour points drawn.
    pub(super) fn overlay_and_length(
        &self,
        camera: usize,
        supposed: &Supposed,
        frames: &[usize],
        links: Option<&[bool]>,
    ) -> [f64; 2] {
        let mut settings = Settings {
            most_samples: 250,
            inner: links.is_some(),
            ..Settings::default()
        };
        let mut enough = ENOUGH;
        let half = self.half.then(|| supposed.halved());
        let supposed = half.as_ref().unwrap_or(supposed);
        if self.half {
            settings.range_px *= 0.5;
            settings.most_samples /= 2;
            enough *= 0.5;
        }
        let mut renderer = Renderer::new(self.footage.scene);
        let (mut overlay, mut length, mut count) = (0.0, 0.0, 0.0);
        for &frame in frames {
            let Some(mut seen) = self.look(&mut renderer, camera, supposed, frame, &settings) else {
                continue;
            };
            if let Some(links) = links {
                seen.measured.samples.retain(|sample| links[usize::from(sample.link)]);
            }
            let share = (seen.measured.samples.len() as f64 / enough).min(1.0);
            overlay += seen.measured.overlay(&settings).unwrap_or(0.0) * share;
            length += seen.measured.contour_points as f64;
            count += 1.0;
        }
        [overlay, length].map(|sum| sum / f64::max(count, 1.0))
    }

    /// Mean number of contour points that the cameras draw as the files say.
    pub(super) fn lengths(&self, given: &[Supposed], frames: &[usize]) -> Vec<f64> {
        (given.par_iter().enumerate())
            .map(|(camera, given)| self.overlay_and_length(camera, given, frames, None)[1])
            .collect()
    }

    /// Overlays of many suppositions, in their order. Other states must draw as much of the robot as the given ones
    /// (`lengths`, by camera), else the overlay counts for less: an arm that leaves the view is not one that fits.
    pub(super) fn overlays(&self, suppositions: &[(usize, Supposed)], lengths: &[f64], frames: &[usize]) -> Vec<f64> {
        let rated = |(camera, supposed): &(usize, Supposed)| {
            let [overlay, length] = self.overlay_and_length(*camera, supposed, frames, None);
            let drawn = if supposed.states == 0 {
                1.0
            } else {
                (length / lengths[*camera].max(1.0)).min(1.0)
            };
            overlay * drawn
        };
        suppositions.par_iter().map(rated).collect()
    }

    /// Moves a supposed camera in its own frame until the edges of some frames fit: from a wide search to a narrow one.
    /// Gives the camera and how far it has turned (rotation vector, radians) and gone (metres).
    pub(super) fn refine(&self, camera: usize, supposed: &Supposed, frames: &[usize]) -> (Supposed, [DVec3; 2]) {
        let mut best = supposed.clone();
        let mut total: Pose<Camera, Camera> = Pose::IDENTITY;
        for range in [32.0, 32.0, 20.0, 12.0, 8.0, 6.0, 4.0] {
            let settings = Settings {
                most_samples: 200,
                ..Settings::of_range(range)
            };
            let seen: Vec<Seen> = frames
                .par_iter()
                .map_init(
                    || Renderer::new(self.footage.scene),
                    |renderer, &frame| self.look(renderer, camera, &best, frame, &settings),
                )
                .flatten()
                .collect();
            let Some(step) = twist(&seen, range) else { break };
            let step = moved(step[0], step[1]);
            total = total * step;
            best.mount = best.mount.moved(step);
        }
        let quaternion = total.quaternion();
        (best, [quaternion.to_scaled_axis(), total.translation])
    }
}

/// A small motion of a camera in its own frame.
pub(super) fn moved(turn: DVec3, step: DVec3) -> Pose<Camera, Camera> {
    let angle = turn.length();
    let rotation = if angle < 1e-12 {
        DMat3::IDENTITY
    } else {
        rotation_about_axis(turn / angle, angle)
    };
    Pose::new(rotation, step)
}

/// The motion of the camera in its own frame that carries the drawn contours to the edges: one robust Gauss-Newton step
/// with a weak prior (0.15 rad, 0.1 m).
pub(super) fn twist(seen: &[Seen], range: f64) -> Option<[DVec3; 2]> {
    let mut matrix = [[0.0; 6]; 6];
    let mut right = [0.0; 6];
    let mut used = 0;
    for view in seen {
        let expected = view.shift.filter(|_| range > 8.0).map(|shift| shift.px);
        let scale = if range > 8.0 { 3.0 } else { (range / 3.0).max(1.0) };
        let camera_from_base = view.camera.world_from_camera.inverse();
        for sample in view.measured.samples.iter().filter(|sample| sample.weight > 0.05) {
            // A wide search believes the edges that agree with the others.
            let off = expected.map_or(sample.offset_px, |px| sample.offset_px - sample.normal.dot(px));
            let robust = 1.0 / (1.0 + (off / scale) * (off / scale));
            let weight = sample.weight * robust * robust / (sample.sigma_px * sample.sigma_px + 0.25);
            let row = jacobian(sample, camera_from_base.point(sample.base_point), &view.camera.lens);
            for i in 0..6 {
                for j in 0..6 {
                    matrix[i][j] += weight * row[i] * row[j];
                }
                right[i] += weight * row[i] * sample.offset_px;
            }
            used += 1;
        }
    }
    if used < 30 {
        return None;
    }
    for i in 0..6 {
        matrix[i][i] += 4.0 / if i < 3 { 0.15 * 0.15 } else { 0.1 * 0.1 };
    }
    let [a, b, c, d, e, f] = solve(matrix, right)?;
    // A step beyond what a search of this range can see is none.
    Some([
        DVec3::new(a, b, c).clamp_length_max(0.15),
        DVec3::new(d, e, f).clamp_length_max(0.1),
    ])
}

/// Change of a point's place along the normal with a turn and a step of the camera in its own frame.
fn jacobian(sample: &EdgeSample, point: DVec3, lens: &Pinhole) -> [f64; 6] {
    let (fx, fy) = (lens.intrinsics.fx, lens.intrinsics.fy);
    let z = point.z.max(1e-6);
    // n . d(pixel)/d(point)
    let along = DVec3::new(
        sample.normal.x * fx / z,
        sample.normal.y * fy / z,
        -(sample.normal.x * fx * point.x + sample.normal.y * fy * point.y) / (z * z),
    );
    // A camera that turns by w and goes by v moves the point by -w x p - v in its frame.
    let turn = along.cross(point);
    let step = -along;
    [turn.x, turn.y, turn.z, step.x, step.y, step.z]
}

/// The image as a camera without the mistake would have stored it.
fn straight<'a>(rgb: &'a [u8], lens: &Pinhole, picture: Picture) -> Cow<'a, [u8]> {
    let (width, height) = (lens.width as usize, lens.height as usize);
    let from = |place: &dyn Fn(usize, usize) -> (usize, usize)| {
        let mut out = Vec::with_capacity(rgb.len());
        for row in 0..height {
            for column in 0..width {
                let (x, y) = place(column, row);
                out.extend_from_slice(&rgb[3 * (y * width + x)..][..3]);
            }
        }
        Cow::Owned(out)
    };
    match picture {
        Picture::AsIs => Cow::Borrowed(rgb),
        Picture::Mirrored => from(&|column, row| (width - 1 - column, row)),
        Picture::UpsideDown => from(&|column, row| (width - 1 - column, height - 1 - row)),
        Picture::Distorted(k1) => from(&|column, row| {
            let ray = lens.ray(column as u32, row as u32);
            let factor = 1.0 + k1 * (ray.x * ray.x + ray.y * ray.y);
            let x = lens.intrinsics.fx * ray.x * factor + lens.intrinsics.cx;
            let y = lens.intrinsics.fy * ray.y * factor + lens.intrinsics.cy;
            let inside = |value: f64, count: usize| (value.max(0.0) as usize).min(count - 1);
            (inside(x, width), inside(y, height))
        }),
    }
}
